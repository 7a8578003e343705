// Ellipses of discs: cv::findContours and cv::fitEllipse against the library, on the same rendered images.
//   opencv_discs DIR    reads DIR/discs.txt and DIR/discs_K.f32 (format in examples/export_problem/discs.rs)
//
// The table gives the root mean square error over the Cramer-Rao bound: 1 is the best that any unbiased method can do. OpenCV is given
// the ideal threshold (half-way between the true levels); ellipses of findContours run through pixel centres inside the
// disc and come out too small, so axes are scored without their mean error.

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <functional>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

namespace {

using Ellipse = std::array<double, 4>;  // u, v, a, b

struct Case {
  std::string name;
  int size = 0, trials = 0;
  double low = 0, high = 0;
  Ellipse bound;
  std::vector<Ellipse> truth, library;
  std::vector<float> pixels;
};

std::vector<Case> read(const std::string& dir) {
  std::ifstream in(dir + "/discs.txt");
  std::string word;
  int n = 0;
  in >> word >> n;
  const auto ellipse = [&] {
    Ellipse e;
    for (double& x : e) in >> word, x = std::stod(word);
    return e;
  };
  std::vector<Case> out(n);
  for (int k = 0; k < n; ++k) {
    Case& c = out[k];
    in >> c.name >> c.size >> c.trials >> c.low >> c.high;
    c.bound = ellipse();
    for (int t = 0; t < c.trials; ++t) {
      c.truth.push_back(ellipse());
      c.library.push_back(ellipse());
    }
    c.pixels.resize(size_t(c.trials) * c.size * c.size);
    std::ifstream raw(dir + "/discs_" + std::to_string(k) + ".f32", std::ios::binary);
    raw.read(reinterpret_cast<char*>(c.pixels.data()), c.pixels.size() * sizeof(float));
    if (!raw) throw std::runtime_error("discs_" + std::to_string(k) + ".f32: too short");
  }
  return out;
}

using Fit = std::function<cv::RotatedRect(const std::vector<cv::Point>&)>;

// The largest contour at the threshold, and its ellipse.
Ellipse by_opencv(const Case& c, int trial, const Fit& fit) {
  const size_t area = size_t(c.size) * c.size;
  const cv::Mat image(c.size, c.size, CV_32F, const_cast<float*>(c.pixels.data() + trial * area));
  cv::Mat bright, mask;
  cv::threshold(image, bright, 0.5 * (c.low + c.high), 255, c.high > c.low ? cv::THRESH_BINARY : cv::THRESH_BINARY_INV);
  bright.convertTo(mask, CV_8U);
  std::vector<std::vector<cv::Point>> contours;
  cv::findContours(mask, contours, cv::RETR_EXTERNAL, cv::CHAIN_APPROX_NONE);
  size_t best = 0;
  for (size_t i = 1; i < contours.size(); ++i)
    if (contours[i].size() > contours[best].size()) best = i;
  const cv::RotatedRect r = fit(contours.at(best));
  const double a = 0.5 * std::max(r.size.width, r.size.height), b = 0.5 * std::min(r.size.width, r.size.height);
  return {r.center.x, r.center.y, a, b};
}

struct Score {
  double center = 0, axes = 0;
};

// Root mean square over the bound; axes with their mean error taken out (to every method's benefit).
Score score(const Case& c, const std::vector<Ellipse>& found) {
  Score s;
  for (int k = 0; k < 4; ++k) {
    double square = 0, mean = 0;
    for (int t = 0; t < c.trials; ++t) {
      const double e = found[t][k] - c.truth[t][k];
      square += e * e / c.trials;
      mean += e / c.trials;
    }
    const double ratio = std::sqrt(k < 2 ? square : square - mean * mean) / c.bound[k];
    (k < 2 ? s.center : s.axes) += 0.5 * ratio;
  }
  return s;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return std::fprintf(stderr, "opencv_discs DIR\n"), 2;
  const std::vector<std::pair<const char*, Fit>> fits = {
      {"fitEllipse", [](const auto& p) { return cv::fitEllipse(p); }},
      {"fitEllipseAMS", [](const auto& p) { return cv::fitEllipseAMS(p); }},
      {"fitEllipseDirect", [](const auto& p) { return cv::fitEllipseDirect(p); }}};
  std::printf("error over the Cramer-Rao bound: centre / axes\n%-36s %13s", "condition", "spivcal");
  for (const auto& f : fits) std::printf(" %17s", f.first);
  std::printf("\n");
  const auto cases = read(argv[1]);
  bool good = !cases.empty();
  for (const Case& c : cases) {
    const Score own = score(c, c.library);
    std::printf("%-36s %6.2f %6.2f", c.name.c_str(), own.center, own.axes);
    // The bound is the bound: a score well below one would be an error of the comparison itself.
    good &= own.center > 0.8 && own.center < 1.3 && own.axes < 1.3;
    for (const auto& f : fits) {
      std::vector<Ellipse> found;
      for (int t = 0; t < c.trials; ++t) found.push_back(by_opencv(c, t, f.second));
      const Score s = score(c, found);
      std::printf("   %7.2f %7.2f", s.center, s.axes);
      good &= s.center > own.center;
    }
    std::printf("\n");
  }
  return good ? 0 : 1;
}
