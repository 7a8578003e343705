// cv::calibrateCamera (CALIB_TILTED_MODEL) on the data of a calibration of the library: one camera, a grid of discs of known
// pitch, axis point held, f, tilts and k1 free.
//   opencv_calibrate FILE.problem
//
// Four runs of OpenCV, all from the library's start:
//   projected   discs' centres through the library's optimum: OpenCV has to come back to that optimum
//   measured    centres of ellipses fitted to the contours, as everyone does it
//   bias        centres of ellipses fitted to the noise-free contours of the library's optimum: the centre of the ellipse is
//               not the image of the circle's centre
//   corrected   measured minus that bias
// and Ceres on OpenCV's cost (every coordinate of every centre with the same weight), written in the library's parameters.
//
// OpenCV's minimum is not the library's: it keeps the centres of the ellipses only, which say less than their contours. Of two
// unbiased estimates, one of them efficient, the difference has the variance of the one minus that of the other (Hausman).

#include <ceres/ceres.h>
#include <ceres/covariance.h>

#include <cmath>
#include <cstdio>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "camera.hpp"
#include "problem.hpp"

namespace {

using Intrinsics = std::array<double, 10>;
using Centres = std::vector<std::vector<cv::Point2d>>;

constexpr int kFree[4] = {0, 4, 5, 6};
const char* const kNames[4] = {"f_px", "alpha_rad", "beta_rad", "k1"};

Pose<double> pose_of(const Motion& m) {
  const auto p = [](const Eigen::Vector3d& c) { return Point<double>{c.x(), c.y(), c.z()}; };
  return {p(m.r.col(0)), p(m.r.col(1)), p(m.r.col(2)), p(m.t)};
}

cv::Point2d image(const Intrinsics& i, const Motion& m, double x, double y) {
  double q[2];
  Camera<double>::of(i.data(), false, Wrong::none).project(pose_of(m)({x, y, 0.0}), q);
  return {q[0], q[1]};
}

// Centre of the ellipse through contour points; cv::fitEllipse takes them as floats, so they are put near zero first.
cv::Point2d ellipse_centre(const std::vector<cv::Point2d>& points) {
  cv::Point2d mean(0, 0);
  for (const auto& p : points) mean += p * (1.0 / points.size());
  std::vector<cv::Point2f> near;
  for (const auto& p : points) near.emplace_back(p - mean);
  const cv::RotatedRect r = cv::fitEllipseDirect(near);
  return mean + cv::Point2d(r.center);
}

struct Data {
  const Problem& problem;
  std::vector<std::vector<cv::Point3f>> object;

  explicit Data(const Problem& p) : problem(p) {
    for (const Image& seen : p.images) {
      object.emplace_back();
      for (const Disc& d : seen.discs) {
        const auto& n = p.nodes[d.disc];
        object.back().emplace_back(n[0] * p.optimum.shape[0], n[1] * p.optimum.shape[0], 0.0);
      }
    }
  }

  // A centre for every disc of every image.
  template <class F>
  Centres centres(F of) const {
    Centres out;
    for (size_t k = 0; k < object.size(); ++k) {
      const Motion& pose = problem.optimum.rig_from_target[problem.images[k].view];
      out.emplace_back();
      for (size_t j = 0; j < object[k].size(); ++j)
        out.back().push_back(of(problem.images[k].discs[j], object[k][j], pose));
    }
    return out;
  }
  Centres projected() const {
    const Intrinsics& i = problem.optimum.intrinsics[0];
    return centres([&](const Disc&, const cv::Point3f& p, const Motion& m) { return image(i, m, p.x, p.y); });
  }
  Centres measured() const {
    return centres([](const Disc& d, const cv::Point3f&, const Motion&) {
      std::vector<cv::Point2d> edge;
      for (const auto& e : d.edge) edge.emplace_back(e[0], e[1]);
      return ellipse_centre(edge);
    });
  }
  Centres biased() const {
    const Intrinsics& i = problem.optimum.intrinsics[0];
    const double r = problem.optimum.shape[1];
    return centres([&](const Disc&, const cv::Point3f& p, const Motion& m) {
      std::vector<cv::Point2d> edge;
      for (int k = 0; k < 72; ++k)
        edge.push_back(image(i, m, p.x + r * std::cos(k * M_PI / 36), p.y + r * std::sin(k * M_PI / 36)));
      return ellipse_centre(edge);
    });
  }
};

struct Calibrated {
  Intrinsics intrinsics;
  std::vector<Motion> poses;
  double rms;
  std::array<double, 4> sigmas;  // of the free parameters; from Ceres only
};

// Method section 2: beta = -asin(sin ty cos tx), alpha = atan2(sin tx, cos ty cos tx), and the roll of the camera frame.
struct Tilts {
  double alpha, beta, roll;
};

Tilts tilts_of(double tx, double ty) {
  const double beta = -std::asin(std::sin(ty) * std::cos(tx));
  const double alpha = std::atan2(std::sin(tx), std::cos(ty) * std::cos(tx));
  const double roll = std::atan2(-std::sin(alpha) * std::sin(ty),
                                 std::cos(beta) * std::cos(ty) - std::sin(beta) * std::cos(alpha) * std::sin(ty));
  return {alpha, beta, roll};
}

Calibrated by_opencv(const Data& data, const Centres& centres) {
  const Intrinsics& start = data.problem.start.intrinsics[0];
  cv::Mat k = cv::Mat::eye(3, 3, CV_64F), d = cv::Mat::zeros(1, 14, CV_64F);
  k.at<double>(0, 0) = start[0], k.at<double>(1, 1) = start[0] * start[1];
  k.at<double>(0, 2) = start[2], k.at<double>(1, 2) = start[3];
  d.at<double>(0) = start[6];
  d.at<double>(12) = std::asin(std::sin(start[4]) * std::cos(start[5]));
  d.at<double>(13) = std::atan2(-std::sin(start[5]), std::cos(start[4]) * std::cos(start[5]));
  const int flags = cv::CALIB_USE_INTRINSIC_GUESS | cv::CALIB_TILTED_MODEL | cv::CALIB_FIX_PRINCIPAL_POINT |
                    cv::CALIB_FIX_ASPECT_RATIO | cv::CALIB_ZERO_TANGENT_DIST | cv::CALIB_FIX_K2 | cv::CALIB_FIX_K3 |
                    cv::CALIB_FIX_S1_S2_S3_S4;
  std::vector<std::vector<cv::Point2f>> pixels;
  for (const auto& list : centres) pixels.emplace_back(list.begin(), list.end());
  std::vector<cv::Mat> rvecs, tvecs;
  const cv::TermCriteria enough(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 1000, 1e-14);
  Calibrated out;
  out.rms = cv::calibrateCamera(data.object, pixels, cv::Size(1024, 768), k, d, rvecs, tvecs, flags, enough);
  const Tilts tilts = tilts_of(d.at<double>(12), d.at<double>(13));
  out.intrinsics = start;
  out.intrinsics[0] = k.at<double>(0, 0);
  out.intrinsics[4] = tilts.alpha, out.intrinsics[5] = tilts.beta, out.intrinsics[6] = d.at<double>(0);
  for (size_t v = 0; v < rvecs.size(); ++v) {
    const Eigen::Vector3d w(rvecs[v].at<double>(0), rvecs[v].at<double>(1), rvecs[v].at<double>(2));
    const Eigen::Vector3d t(tvecs[v].at<double>(0), tvecs[v].at<double>(1), tvecs[v].at<double>(2));
    const Eigen::Matrix3d turn = Eigen::AngleAxisd(tilts.roll, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    out.poses.push_back({turn * Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix(), turn * t});
  }
  return out;
}

struct CentreResidual {
  cv::Point3f at;
  cv::Point2f seen;
  template <class T>
  bool operator()(const T* intrinsics, const T* pose, T* r) const {
    T q[2];
    const Point<T> p{T(at.x), T(at.y), T(at.z)};
    Camera<T>::of(intrinsics, false, Wrong::none).project(Pose<T>::of(pose)(p), q);
    r[0] = q[0] - double(seen.x), r[1] = q[1] - double(seen.y);
    return true;
  }
};

// Ceres on OpenCV's cost, from where OpenCV started; `rms_there` is the rms at `found`.
Calibrated by_ceres(const Data& data, const Centres& centres, const Calibrated& found, double* rms_there) {
  Calibrated out;
  std::vector<std::array<double, 7>> poses;
  const auto packed = [](const Motion& m) {
    const Eigen::Quaterniond q(m.r);
    return std::array<double, 7>{q.w(), q.x(), q.y(), q.z(), m.t.x(), m.t.y(), m.t.z()};
  };
  for (const Motion& m : found.poses) poses.push_back(packed(m));
  out.intrinsics = found.intrinsics;
  ceres::Problem problem;
  int n = 0;
  for (size_t k = 0; k < centres.size(); ++k) {
    for (size_t j = 0; j < centres[k].size(); ++j, ++n)
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<CentreResidual, 2, 10, 7>(
              new CentreResidual{data.object[k][j], cv::Point2f(centres[k][j])}),
          nullptr, out.intrinsics.data(), poses[k].data());
    problem.SetManifold(poses[k].data(), new ceres::ProductManifold<ceres::QuaternionManifold, ceres::EuclideanManifold<3>>(
                                             ceres::QuaternionManifold(), ceres::EuclideanManifold<3>()));
  }
  problem.SetManifold(out.intrinsics.data(), new ceres::SubsetManifold(10, {1, 2, 3, 7, 8, 9}));
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.max_num_iterations = 500;
  options.function_tolerance = 0.0;
  options.gradient_tolerance = 0.0;
  options.parameter_tolerance = 1e-14;
  options.logging_type = ceres::SILENT;
  double cost = 0.0;
  problem.Evaluate({}, &cost, nullptr, nullptr, nullptr);
  *rms_there = std::sqrt(2.0 * cost / n);
  out.intrinsics = data.problem.start.intrinsics[0];
  for (size_t k = 0; k < poses.size(); ++k)
    poses[k] = packed(data.problem.start.rig_from_target[data.problem.images[k].view]);
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  out.rms = std::sqrt(2.0 * summary.final_cost / n);
  ceres::Covariance::Options how;
  how.algorithm_type = ceres::DENSE_SVD;
  how.min_reciprocal_condition_number = 1e-20;
  ceres::Covariance covariance(how);
  const double* block = out.intrinsics.data();
  Eigen::Matrix4d c;
  const std::vector<const double*> wanted = {block};
  if (!covariance.Compute(wanted, &problem) ||
      !covariance.GetCovarianceBlockInTangentSpace(block, block, c.data()))
    throw std::runtime_error("Ceres finds no covariance");
  const double unknowns = 4.0 + 6.0 * centres.size(), variance = 2.0 * summary.final_cost / (2.0 * n - unknowns);
  for (int k = 0; k < 4; ++k) out.sigmas[k] = std::sqrt(variance * c(k, k));
  return out;
}

struct Row {
  std::array<double, 4> z;  // relative to the library's optimum, in its sigmas
};

double library_sigma(const Problem& p, int k) {
  size_t at = 0;
  while (p.names.at(at) != p.camera_names[0] + "." + kNames[k]) ++at;
  return std::sqrt(p.covariance(at, at));
}

Row print(const char* what, const Problem& p, const Calibrated& c) {
  Row row;
  std::printf("%-26s rms %.5f px", what, c.rms);
  for (int k = 0; k < 4; ++k) {
    const int i = kFree[k];
    row.z[k] = (c.intrinsics[i] - p.optimum.intrinsics[0][i]) / library_sigma(p, k);
    std::printf("  %s %.6g (%+.3g s)", kNames[k], c.intrinsics[i], row.z[k]);
  }
  std::printf("\n");
  return row;
}

double largest(const Row& a, const Row& b = {}) {
  double m = 0;
  for (int k = 0; k < 4; ++k) m = std::fmax(m, std::fabs(a.z[k] - b.z[k]));
  return m;
}

bool expect(bool good, const char* claim, double number) {
  std::printf("%s: %s (%.3g)\n", good ? "holds" : "FAILS", claim, number);
  return good;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return std::fprintf(stderr, "opencv_calibrate FILE.problem\n"), 2;
  const Problem problem = Problem::read(argv[1]);
  const Data data(problem);
  std::printf("departure from the library's optimum, in the library's sigmas\n");
  const Centres projected = data.projected(), measured = data.measured(), biased = data.biased();
  Centres corrected = measured;
  double bias = 0.0;
  for (size_t k = 0; k < measured.size(); ++k)
    for (size_t j = 0; j < measured[k].size(); ++j) {
      const cv::Point2d d = biased[k][j] - projected[k][j];
      bias = std::fmax(bias, cv::norm(d));
      corrected[k][j] = measured[k][j] - d;
    }
  const Row a = print("OpenCV, projected", problem, by_opencv(data, projected));
  const Calibrated found = by_opencv(data, measured);
  const Row b = print("OpenCV, measured", problem, found);
  double rms_there = 0.0;
  const Calibrated bottom = by_ceres(data, measured, found, &rms_there);
  const Row c = print("Ceres, OpenCV's cost", problem, bottom);
  const Row d = print("OpenCV, bias alone", problem, by_opencv(data, biased));
  const Row e = print("OpenCV, corrected", problem, by_opencv(data, corrected));
  double least = INFINITY, hausman = 0.0;
  for (int k = 0; k < 4; ++k) {
    const double ratio = bottom.sigmas[k] / library_sigma(problem, k);
    std::printf("%s: sigma of OpenCV's estimate %.4g, of the library's %.4g, ratio %.2f\n", kNames[k], bottom.sigmas[k],
                library_sigma(problem, k), ratio);
    least = std::fmin(least, ratio);
    hausman = std::fmax(hausman, std::fabs(e.z[k]) / std::sqrt(std::fmax(ratio * ratio - 1.0, 1e-2)));
  }
  std::printf("largest distance between an ellipse's centre and the image of the circle's centre: %.3f px\n", bias);

  bool good = true;
  good &= expect(largest(a) < 0.05, "on projected centres OpenCV has the library's optimum", largest(a));
  good &= expect(std::fabs(rms_there / found.rms - 1.0) < 1e-6, "OpenCV's rms is that of the library's camera at OpenCV's result",
                 rms_there / found.rms - 1.0);
  good &= expect(largest(b, c) < 0.05 && std::fabs(bottom.rms / rms_there - 1.0) < 1e-6, "OpenCV's result is the minimum of its cost", largest(b, c));
  good &= expect(bias > 0.05 && largest(d) < 0.1, "the bias of ellipse centres is taken up by the poses", largest(d));
  good &= expect(least > 1.0, "centres alone say less than contours: least ratio of the sigmas", least);
  good &= expect(hausman < 4.0, "what sets the estimates apart is the noise that this leaves, sigmas", hausman);
  return good ? 0 : 1;
}
