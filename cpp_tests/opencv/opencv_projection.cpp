// The library's projection against cv::projectPoints with CALIB_TILTED_MODEL, and back through cv::undistortPoints.
//   opencv_projection DIR    reads DIR/projection.txt (format in examples/export_problem/projection.rs)

#include <cmath>
#include <cstdio>
#include <fstream>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <string>

namespace {

constexpr double kPixel = 1e-9;  // px
constexpr double kBack = 1e-9;   // px, after the round trip

double number(std::istream& in) {
  std::string word;
  in >> word;
  return std::stod(word);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return std::fprintf(stderr, "opencv_projection DIR\n"), 2;
  std::ifstream in(std::string(argv[1]) + "/projection.txt");
  std::string word;
  int cameras = 0, points = 0;
  in >> word >> cameras;
  double worst = 0.0, back = 0.0, without_roll = 0.0;
  for (int c = 0; c < cameras; ++c) {
    for (int k = 0; k < 9; ++k) number(in);
    cv::Matx33d k = cv::Matx33d::eye(), r;
    k(0, 0) = number(in), k(1, 1) = number(in), k(0, 2) = number(in), k(1, 2) = number(in);
    cv::Mat distortion(1, 14, CV_64F);
    for (int i = 0; i < 14; ++i) distortion.at<double>(i) = number(in);
    for (int i = 0; i < 9; ++i) r.val[i] = number(in);
    const int n = static_cast<int>(number(in));
    std::vector<cv::Point3d> in_opencv, in_cam;
    std::vector<cv::Point2d> pixels, got, unrolled, ideal, again;
    for (int i = 0; i < n; ++i) {
      cv::Vec3d p;
      for (int j = 0; j < 3; ++j) p[j] = number(in);
      in_cam.emplace_back(p);
      in_opencv.emplace_back(r.t() * p);
      const double u = number(in), v = number(in);
      pixels.emplace_back(u, v);
    }
    const cv::Vec3d zero(0, 0, 0);
    cv::projectPoints(in_opencv, zero, zero, k, distortion, got);
    cv::projectPoints(in_cam, zero, zero, k, distortion, unrolled);
    // OpenCV inverts its polynomial by fixed-point iteration: as many rounds as it takes.
    const cv::TermCriteria enough(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 1000, 1e-16);
    cv::undistortPoints(pixels, ideal, k, distortion, cv::noArray(), cv::noArray(), enough);
    for (int i = 0; i < n; ++i) {
      worst = std::fmax(worst, cv::norm(got[i] - pixels[i]));
      without_roll = std::fmax(without_roll, cv::norm(unrolled[i] - pixels[i]));
      const cv::Point3d& p = in_opencv[i];
      back = std::fmax(back, k(0, 0) * cv::norm(ideal[i] - cv::Point2d(p.x / p.z, p.y / p.z)));
    }
    points += n;
  }
  std::printf("%d cameras, %d points: projection %.1e px, undistortion %.1e px (without the roll: %.0f px)\n", cameras,
              points, worst, back, without_roll);
  // The last number shows that the comparison can fail: the roll of the camera frame is no formality.
  const bool good = in && points > 1000 && worst < kPixel && back < kBack && without_roll > 1.0;
  return good ? 0 : 1;
}
