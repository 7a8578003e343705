// Maps, dewarping and three components: the library beside OpenCV and numpy, millions per second, medians of rounds that take turns.
//   bench_bulk LIBRARY_PROGRAM NUMPY_SCRIPT [THREADS]     LIBRARY_PROGRAM: release build of examples/bulk_speed
//
// With one thread the processor's time counts, which other work on the machine does not lengthen; with more the elapsed one.
// OpenCV is given what helps it: positions for remap are computed beforehand, undistortPoints stops after its usual five steps and leaves the
// plane out, projectPoints gives no derivatives.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

constexpr int kRounds = 7, kPoints = 4096, kSize = 2048;
constexpr double kSeconds = 0.3;
// Else the C library gives numpy's larger temporaries back to the system in every call, which takes three quarters of the time.
constexpr const char* kKept = "MALLOC_TRIM_THRESHOLD_=1000000000 MALLOC_TOP_PAD_=100000000 ";

bool alone = true;

double rate(double count, const std::function<void()>& call) {
  using Clock = std::chrono::steady_clock;
  call();
  const auto begin = Clock::now();
  const auto own = std::clock();
  double calls = 0, elapsed = 0;
  while ((elapsed = std::chrono::duration<double>(Clock::now() - begin).count()) < kSeconds) call(), ++calls;
  const double busy = static_cast<double>(std::clock() - own) / CLOCKS_PER_SEC;
  return 1e-6 * calls * count / (alone ? busy : elapsed);
}

double median(std::vector<double> x) {
  std::sort(x.begin(), x.end());
  return x[x.size() / 2];
}

double by_program(const std::string& command) {
  FILE* pipe = popen(command.c_str(), "r");
  double out[2] = {0, 0};
  const int read = pipe ? std::fscanf(pipe, "%lf %lf", &out[0], &out[1]) : 0;
  if (!pipe || pclose(pipe) != 0 || read != 2) throw std::runtime_error(command + ": failed");
  return out[alone ? 1 : 0];
}

// k1 and the tilts of CALIB_TILTED_MODEL.
const cv::Mat& distortion() {
  static const cv::Mat d = (cv::Mat_<double>(1, 14) << -0.15, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0.0101, -0.1107);
  return d;
}

cv::Matx33d matrix() {
  const double c = (kSize - 1) / 2.0;
  return {8888.9, 0, c, 0, 8888.9, c, 0, 0, 1};
}

double project() {
  std::vector<cv::Point3d> points;
  for (int i = 0; i < kPoints; ++i) points.emplace_back(40 * std::sin(0.37 * i), 40 * std::sin(0.61 * i), 0);
  std::vector<cv::Point2d> images;
  const cv::Vec3d turn(2.9, 0.0, -1.2), shift(0, 0, 500);
  return rate(kPoints, [&] { cv::projectPoints(points, turn, shift, matrix(), distortion(), images); });
}

double unproject() {
  std::vector<cv::Point2d> pixels, ideal;
  for (int i = 0; i < kPoints; ++i) pixels.emplace_back(1024 + 1000 * std::sin(0.37 * i), 1024 + 1000 * std::sin(0.61 * i));
  return rate(kPoints, [&] { cv::undistortPoints(pixels, ideal, matrix(), distortion()); });
}

double remap(int kernel) {
  cv::Mat image(kSize, kSize, CV_32F), u(2000, 1600, CV_32F), v(2000, 1600, CV_32F), out;
  for (int i = 0; i < kSize * kSize; ++i) image.ptr<float>()[i] = std::sin(0.013f * static_cast<float>(i));
  // Positions like those of the oblique sheet.
  for (int j = 0; j < u.rows; ++j)
    for (int i = 0; i < u.cols; ++i) {
      u.at<float>(j, i) = static_cast<float>(1024 + (i - 800) * (0.63 + 1e-5 * i));
      v.at<float>(j, i) = static_cast<float>(1024 + (j - 1000) * (0.87 + 1e-5 * i));
    }
  return rate(1600.0 * 2000.0, [&] { cv::remap(image, out, u, v, kernel, cv::BORDER_REFLECT_101); });
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) return std::fprintf(stderr, "bench_bulk LIBRARY_PROGRAM NUMPY_SCRIPT [THREADS]\n"), 2;
  const std::string threads = argc > 3 ? argv[3] : "1";
  alone = threads == "1";
  cv::setNumThreads(std::atoi(threads.c_str()));
  const auto numpy = [&](const char* count) { return by_program(kKept + std::string("python3 ") + argv[2] + " " + count); };
  const struct {
    const char *name, *other;
    std::function<double()> run;
  } all[] = {
      {"plane-to-pixel", "cv::projectPoints", project},
      {"pixel-to-plane", "cv::undistortPoints", unproject},
      {"linear", "cv::remap", [] { return remap(cv::INTER_LINEAR); }},
      {"cubic", "cv::remap", [] { return remap(cv::INTER_CUBIC); }},
      {"lanczos", "cv::remap LANCZOS4", [] { return remap(cv::INTER_LANCZOS4); }},
      {"components", "numpy, closed form", [&] { return numpy("4096"); }},
      {"components-5000", "numpy, closed form", [&] { return numpy("5000"); }},
      {"components-5000", "numpy.linalg.solve", [&] { return numpy("5000 solve"); }},
  };
  std::printf("OpenCV %s, %s thread(s); millions per second\n%-16s %-20s %10s %10s %7s\n", CV_VERSION, threads.c_str(), "work", "other", "other", "spivcal", "ratio");
  for (const auto& one : all) {
    std::vector<double> theirs, ours, ratio;
    for (int round = 0; round < kRounds; ++round) {
      theirs.push_back(one.run());
      ours.push_back(by_program(std::string(argv[1]) + " " + one.name + " " + threads + " " + std::to_string(kSeconds)));
      ratio.push_back(ours.back() / theirs.back());
    }
    std::printf("%-16s %-20s %10.1f %10.1f %7.1f\n", one.name, one.other, median(theirs), median(ours), median(ratio));
  }
  return 0;
}
