// Finding 910 dots in five megapixels: the library through its C interface beside OpenCV, medians of rounds that take turns.
//   bench_detect [ROUNDS]
//
// OpenCV is given what helps it: one threshold for the whole image, half-way between disc and ground, no candidates to turn down, no sigmas. Errors are
// those of the centres against the truth. The scene is that of benches/scenes: dots of 13 x 11 px, uneven light, noise of 2 grey levels.
//
// Processors that share a core, a cache or a clock are not worth two. What they are worth at most is measured in the same rounds: two images at once,
// each by a program of one thread that waits for nobody. Times are for an image.

#include <spivcal.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <opencv2/imgproc.hpp>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace {

constexpr int kWidth = 2592, kHeight = 1944, kPitch = 74;
constexpr double kMajor = 13, kMinor = 11;

using Centres = std::vector<cv::Point2d>;

cv::Point2d nearest_dot(double u, double v) {
  return {std::floor(u / kPitch) * kPitch + 37, std::floor(v / kPitch) * kPitch + 37};
}

cv::Mat picture() {
  cv::Mat image(kHeight, kWidth, CV_8U);
  cv::RNG random(1);
  for (int v = 0; v < kHeight; ++v)
    for (int u = 0; u < kWidth; ++u) {
      const cv::Point2d c = nearest_dot(u, v);
      const double x = (u - c.x) / kMajor, y = (v - c.y) / kMinor;
      const double q = std::max(std::hypot(x, y), 1e-6);
      const double d = (q - 1) * q / std::max(std::hypot(x / kMajor, y / kMinor), 1e-6);
      const double inside = 0.5 * std::erfc(d / std::sqrt(2.0));
      const double light = 170 + 40.0 * u / kWidth;
      image.at<uchar>(v, u) = cv::saturate_cast<uchar>(light * (1 - 0.75 * inside) + random.gaussian(2));
    }
  return image;
}

Centres by_opencv(const cv::Mat& image) {
  cv::Mat mask;
  cv::threshold(image, mask, 118, 255, cv::THRESH_BINARY_INV);
  std::vector<std::vector<cv::Point>> contours;
  cv::findContours(mask, contours, cv::RETR_EXTERNAL, cv::CHAIN_APPROX_NONE);
  Centres out;
  for (const auto& contour : contours)
    if (contour.size() >= 20) out.push_back(cv::fitEllipse(contour).center);
  return out;
}

class Library {
 public:
  Library(const cv::Mat& image, int threads)
      : context_(threads), image_(context_.image(image.data, kWidth, kHeight)), detection_(context_.new_detection()) {}

  Centres find() {
    detection_.run(image_);
    const std::vector<double> u = detection_.array(SPIVCAL_DISC_U_PX), v = detection_.array(SPIVCAL_DISC_V_PX);
    Centres out;
    for (size_t i = 0; i < u.size(); ++i) out.emplace_back(u[i], v[i]);
    return out;
  }

 private:
  spivcal::Context context_;
  spivcal::Image image_;
  spivcal::Detection detection_;
};

struct Way {
  std::string name;
  int images;
  std::function<Centres()> find;
  std::vector<double> elapsed_ms, busy_ms;
};

// What `own` finds while another thread is busy with `other`.
Centres at_once(const std::function<Centres()>& own, const std::function<Centres()>& other) {
  std::thread beside([&] { other(); });
  Centres out = own();
  beside.join();
  return out;
}

void run(Way& way) {
  const auto begin = std::chrono::steady_clock::now();
  const std::clock_t own = std::clock();
  way.find();
  way.busy_ms.push_back(1e3 * static_cast<double>(std::clock() - own) / CLOCKS_PER_SEC / way.images);
  way.elapsed_ms.push_back(1e3 * std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count() / way.images);
}

double median(std::vector<double> x) {
  std::nth_element(x.begin(), x.begin() + x.size() / 2, x.end());
  return x[x.size() / 2];
}

double error_px(const Centres& found) {
  double sum = 0;
  for (const cv::Point2d& p : found) {
    const cv::Point2d d = p - nearest_dot(p.x, p.y);
    sum += d.dot(d);
  }
  return std::sqrt(sum / (2 * found.size()));
}

}  // namespace

int main(int argc, char** argv) try {
  const int rounds = argc > 1 ? std::atoi(argv[1]) : 21;
  const cv::Mat image = picture();
  Library one(image, 1), another(image, 1), two(image, 2);
  const auto opencv = [&] { return by_opencv(image); };
  std::vector<Way> ways = {{"threshold, findContours, fitEllipse", 1, opencv, {}, {}},
                           {"spivcal, one thread", 1, [&] { return one.find(); }, {}, {}},
                           {"spivcal, two threads", 1, [&] { return two.find(); }, {}, {}},
                           {"two at once: OpenCV, OpenCV", 2, [&] { return at_once(opencv, opencv); }, {}, {}},
                           {"two at once: spivcal, spivcal", 2,
                            [&] { return at_once([&] { return one.find(); }, [&] { return another.find(); }); }, {}, {}}};
  cv::setNumThreads(1);
  std::vector<Centres> found;
  for (Way& way : ways) found.push_back(way.find());
  for (int k = 0; k < rounds; ++k)
    for (Way& way : ways) run(way);
  std::printf("%-38s %8s %12s %14s %10s\n", "way", "dots", "elapsed, ms", "processors, ms", "error, px");
  const size_t wanted = found[1].size();
  for (size_t k = 0; k < ways.size(); ++k) {
    const double elapsed = median(ways[k].elapsed_ms), busy = median(ways[k].busy_ms);
    std::printf("%-38s %8zu %12.1f %14.1f %10.5f\n", ways[k].name.c_str(), found[k].size(), elapsed, busy, error_px(found[k]));
    if (found[k].size() != wanted) throw std::runtime_error("not the same dots");
  }
  return wanted == 910 ? 0 : 1;
} catch (const std::exception& e) {
  std::fprintf(stderr, "%s\n", e.what());
  return 1;
}
