// The library against Ceres: the same cost written anew, from the same start to the same minimum with the same covariance.
//   ceres_agrees DIR                   compares every DIR/*.problem, writes DIR/*.solution
//   ceres_agrees DIR --wrong FAULT     succeeds where a cost with that fault is told from the library's
//
// Ceres' trust region judges steps by the cost and so ends at about sqrt(rounding of the cost) of a sigma; some undamped
// Gauss-Newton steps on Ceres' own Jacobian take it to the bottom.

#include <ceres/covariance.h>

#include <chrono>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <map>

#include "build.hpp"

namespace {

constexpr double kCost = 1e-9;         // relative
constexpr double kParameter = 1e-6;    // of a sigma
constexpr double kCovariance = 1e-5;   // relative to the product of the sigmas
constexpr double kStationary = 1e-6;   // Newton decrement, sigmas

struct Linear {
  double cost = INFINITY, decrement = INFINITY;
  Eigen::VectorXd step;
};

// Cost, Gauss-Newton step and its length in sigmas, where the unknowns stand.
Linear linearised(ceres::Problem& problem, const std::vector<double*>& blocks) {
  ceres::Problem::EvaluateOptions options;
  options.parameter_blocks = blocks;
  Linear out;
  std::vector<double> r;
  ceres::CRSMatrix crs;
  if (!problem.Evaluate(options, &out.cost, &r, nullptr, &crs)) return out;
  Eigen::MatrixXd j = Eigen::MatrixXd::Zero(crs.num_rows, crs.num_cols);
  for (int row = 0; row < crs.num_rows; ++row)
    for (int k = crs.rows[row]; k < crs.rows[row + 1]; ++k) j(row, crs.cols[k]) = crs.values[k];
  const Eigen::VectorXd scale = j.colwise().norm().cwiseMax(1e-300).cwiseInverse();
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(j * scale.asDiagonal());
  const Eigen::VectorXd rhs =
      (qr.householderQ().adjoint() * -Eigen::Map<Eigen::VectorXd>(r.data(), r.size())).head(j.cols());
  const Eigen::MatrixXd upper = qr.matrixQR().topRows(j.cols());
  out.step = scale.asDiagonal() * upper.triangularView<Eigen::Upper>().solve(rhs);
  out.decrement = rhs.norm();
  return out;
}

void step(ceres::Problem& problem, const std::vector<double*>& blocks, const Eigen::VectorXd& all) {
  int at = 0;
  for (double* block : blocks) {
    const int size = problem.ParameterBlockSize(block), tangent = problem.ParameterBlockTangentSize(block);
    const Eigen::VectorXd x = Eigen::Map<Eigen::VectorXd>(block, size), d = all.segment(at, tangent);
    if (const ceres::Manifold* m = problem.GetManifold(block))
      m->Plus(x.data(), d.data(), block);
    else
      Eigen::Map<Eigen::VectorXd>(block, size) = x + d;
    at += tangent;
  }
}

struct Solved {
  double cost, own_decrement, decrement;
  int iterations;
};

Solved solve(ceres::Problem& problem, const std::vector<double*>& blocks) {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.max_num_iterations = 1000;
  options.function_tolerance = 0.0;
  options.gradient_tolerance = 0.0;
  options.parameter_tolerance = 1e-14;
  options.max_num_consecutive_invalid_steps = 20;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  Linear at = linearised(problem, blocks);
  const double own = at.decrement;
  for (int k = 0; k < 6 && at.decrement > 1e-9; ++k) {
    step(problem, blocks, at.step);
    at = linearised(problem, blocks);
  }
  return {at.cost, own, at.decrement, static_cast<int>(summary.iterations.size()) - 1};
}

Eigen::Vector3d rotation_log(const Eigen::Matrix3d& r) {
  const Eigen::AngleAxisd a(r);
  // Small angles: the antisymmetric part keeps its digits.
  const Eigen::Vector3d w(r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1));
  return w.norm() < 1e-3 ? Eigen::Vector3d(0.5 * w) : Eigen::Vector3d(a.angle() * a.axis());
}

// Left step from one motion to another: R' = exp(w) R, t' = exp(w) t + v.
Eigen::Matrix<double, 6, 1> step_between(const Motion& from, const Motion& to) {
  Eigen::Matrix<double, 6, 1> d;
  const Eigen::Matrix3d turn = to.r * from.r.transpose();
  d << rotation_log(turn), to.t - turn * from.t;
  return d;
}

Eigen::Vector3d abc(const Motion& plane) {
  const Eigen::Vector3d n = plane.r.col(2);
  return n / n.dot(plane.t);
}

const char* const kIntrinsics[10] = {"f_px",      "aspect", "cx_px", "cy_px", "alpha_rad",
                                     "beta_rad", "k1",     "k2",    "k3",    "pupil_ratio"};
const char* const kSteps[6] = {"rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm"};

// Named numbers of an answer relative to another one, and their derivative by the tangent space of `blocks`.
class Named {
 public:
  Named(const Problem& problem, const Unknowns& u, ceres::Problem& ceres, const std::vector<double*>& blocks)
      : problem_(problem) {
    for (double* b : blocks) {
      offset_[b] = size_;
      size_ += ceres.ParameterBlockTangentSize(b);
    }
    for (size_t c = 0; c < u.intrinsics.size(); ++c) {
      int at = offset(u.intrinsics[c].data());
      for (int k = 0; k < 10; ++k)
        if (problem.free[c][k]) row(problem.camera_names[c] + "." + kIntrinsics[k])(at++) = kUnit[k];
    }
    for (size_t c = 0; c < u.motion.size(); ++c)
      pose_rows(problem.camera_names[c + 1] + ".cam_from_rig.", u.motion[c].data());
    if (!problem.start.plane.empty())
      for (int k = 0; k < 3; ++k)
        row(std::string("sheet.") + "abc"[k] + "_per_mm")(offset(u.plane.data()) + k) = kPlaneUnit;
    shape_rows("target.", u.shape);
    for (size_t v = 0; v < u.pose.size(); ++v) {
      const std::string name = "view" + std::to_string(v) + ".";
      if (problem.in_plane[v])
        planar_rows(name + "rig_from_target.", u, v);
      else
        pose_rows(name + "rig_from_target.", u.pose[v].data());
      shape_rows(name, u.own_shape[v]);
    }
  }

  // Rows in the order of the library's names.
  Eigen::MatrixXd jacobian() const {
    Eigen::MatrixXd j(problem_.names.size(), size_);
    for (size_t i = 0; i < problem_.names.size(); ++i) {
      const auto found = rows_.find(problem_.names[i]);
      if (found == rows_.end()) throw std::runtime_error("no parameter " + problem_.names[i]);
      j.row(i) = found->second;
    }
    if (rows_.size() != problem_.names.size()) throw std::runtime_error("parameters that the library does not name");
    return j;
  }

  // Named numbers of `b` minus those of `a`.
  Eigen::VectorXd difference(const Answer& a, const Answer& b) const {
    std::map<std::string, double> d;
    const auto motion = [&](const std::string& name, const Motion& from, const Motion& to) {
      const auto s = step_between(from, to);
      for (int k = 0; k < 6; ++k) d[name + kSteps[k]] = s[k];
    };
    const auto shapes = [&](const std::string& name, const std::array<double, 3>& from, const std::array<double, 3>& to) {
      for (int k = 0; k < 3; ++k) d[name + shape_name(k)] = to[k] - from[k];
    };
    for (size_t c = 0; c < a.intrinsics.size(); ++c)
      for (int k = 0; k < 10; ++k)
        d[problem_.camera_names[c] + "." + kIntrinsics[k]] = b.intrinsics[c][k] - a.intrinsics[c][k];
    for (size_t c = 0; c < a.cam_from_rig.size(); ++c)
      motion(problem_.camera_names[c + 1] + ".cam_from_rig.", a.cam_from_rig[c], b.cam_from_rig[c]);
    if (!a.plane.empty())
      for (int k = 0; k < 3; ++k)
        d[std::string("sheet.") + "abc"[k] + "_per_mm"] = abc(b.plane[0])[k] - abc(a.plane[0])[k];
    shapes("target.", a.shape, b.shape);
    for (size_t v = 0; v < a.rig_from_target.size(); ++v) {
      const std::string name = "view" + std::to_string(v) + ".";
      motion(name + "rig_from_target.", a.rig_from_target[v], b.rig_from_target[v]);
      shapes(name, a.own_shape[v], b.own_shape[v]);
    }
    Eigen::VectorXd out(problem_.names.size());
    for (size_t i = 0; i < problem_.names.size(); ++i) out[i] = d.at(problem_.names[i]);
    return out;
  }

  int offset(const double* block) const { return offset_.at(block); }

 private:
  Eigen::RowVectorXd& row(const std::string& name) {
    return rows_[name] = Eigen::RowVectorXd::Zero(size_);
  }

  const char* shape_name(int k) const {
    static const char* const pair[3] = {"spacing_mm", "radius0_mm", "radius1_mm"};
    static const char* const lattice[3] = {"spacing_mm", "radius_mm", "step_mm"};
    return problem_.target == "lattice" ? lattice[k] : pair[k];
  }

  void shape_rows(const std::string& name, const std::array<double, 3>& block) {
    const auto found = offset_.find(block.data());
    if (found == offset_.end()) return;
    int at = found->second;
    for (int k = 0; k < 3; ++k)
      if (problem_.free_shape[k]) row(name + shape_name(k))(at++) = 1.0;
  }

  // The quaternion's step is half a rotation vector, on the left; v = dt - w x t.
  void pose_rows(const std::string& name, const double* block) {
    const int at = offset(block);
    const Eigen::Vector3d t(block[4], block[5], block[6]);
    for (int r = 0; r < 3; ++r) row(name + kSteps[r])(at + r) = 2.0;
    for (int r = 0; r < 3; ++r) {
      Eigen::RowVectorXd& line = row(name + kSteps[3 + r]);
      line(at + 3 + r) = 1.0;
      for (int k = 0; k < 3; ++k) line(at + k) = -2.0 * Eigen::Vector3d::Unit(k).cross(t)[r];
    }
  }

  void planar_rows(const std::string& name, const Unknowns& u, size_t v) {
    using Jet = ceres::Jet<double, 6>;
    Jet p[6];
    for (int k = 0; k < 3; ++k) p[k] = Jet(u.plane[k], k), p[3 + k] = Jet(u.planar[v][k], 3 + k);
    const Pose<Jet> pose = planar_pose(p, p + 3, problem_.z[v], u.reference);
    const Point<Jet>* columns[3] = {&pose.x, &pose.y, &pose.z};
    for (int r = 0; r < 6; ++r) row(name + kSteps[r]);
    for (int k = 0; k < 6; ++k) {
      Eigen::Matrix3d rotation, change;
      for (int c = 0; c < 3; ++c) {
        const Point<Jet>& q = *columns[c];
        rotation.col(c) << q.x.a, q.y.a, q.z.a;
        change.col(c) << q.x.v[k], q.y.v[k], q.z.v[k];
      }
      const Eigen::Matrix3d s = change * rotation.transpose();
      const Eigen::Vector3d w(s(2, 1), s(0, 2), s(1, 0)), t(pose.t.x.a, pose.t.y.a, pose.t.z.a);
      const Eigen::Vector3d dt(pose.t.x.v[k], pose.t.y.v[k], pose.t.z.v[k]), shift = dt - w.cross(t);
      const int at = k < 3 ? offset(u.plane.data()) + k : offset(u.planar[v].data()) + k - 3;
      for (int r = 0; r < 3; ++r) {
        rows_[name + kSteps[r]](at) = w[r];
        rows_[name + kSteps[3 + r]](at) = shift[r];
      }
    }
  }

  const Problem& problem_;
  std::map<const double*, int> offset_;
  std::map<std::string, Eigen::RowVectorXd> rows_;
  int size_ = 0;
};

// Covariance of the tangent space of `blocks`, from Ceres.
bool covariance(ceres::Problem& problem, const std::vector<double*>& blocks, Eigen::MatrixXd& out) {
  ceres::Covariance::Options options;
  options.algorithm_type = ceres::DENSE_SVD;
  options.min_reciprocal_condition_number = 1e-18;
  ceres::Covariance c(options);
  const std::vector<const double*> all(blocks.begin(), blocks.end());
  if (!c.Compute(all, &problem)) return false;
  int n = 0;
  for (double* b : blocks) n += problem.ParameterBlockTangentSize(b);
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> m(n, n);
  if (!c.GetCovarianceMatrixInTangentSpace(all, m.data())) return false;
  out = m;
  return true;
}

// Largest difference of two covariances over the product of the sigmas.
double apart(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  const Eigen::VectorXd s = b.diagonal().cwiseSqrt().cwiseInverse();
  return (s.asDiagonal() * (a - b) * s.asDiagonal()).cwiseAbs().maxCoeff();
}

void write_solution(const Answer& a, double cost, const std::string& file) {
  std::ofstream out(file);
  out << std::setprecision(17);
  const auto motion = [&](const Motion& m) {
    for (int i = 0; i < 9; ++i) out << m.r(i / 3, i % 3) << ' ';
    out << m.t.x() << ' ' << m.t.y() << ' ' << m.t.z() << '\n';
  };
  const auto numbers = [&](const auto& list) {
    for (double x : list) out << x << ' ';
    out << '\n';
  };
  for (const auto& i : a.intrinsics) numbers(i);
  for (const Motion& m : a.cam_from_rig) motion(m);
  for (const Motion& m : a.plane) motion(m);
  numbers(a.shape);
  for (size_t v = 0; v < a.rig_from_target.size(); ++v) {
    motion(a.rig_from_target[v]);
    numbers(a.own_shape[v]);
  }
  for (const auto& o : a.offsets) numbers(o);
  out << cost << '\n';
}

// Cost and decrement of Ceres at the library's optimum.
Linear at_library(const Problem& problem, Wrong wrong) {
  Unknowns u = Unknowns::of(problem, problem.optimum, reference_of(problem));
  ceres::Problem ceres;
  const auto blocks = build(problem, u, wrong, ceres);
  return linearised(ceres, blocks);
}

double relative(double a, double b) { return std::fabs(a / b - 1.0); }

bool agrees(const Problem& problem, const std::string& solution) {
  const auto begin = std::chrono::steady_clock::now();
  const Linear there = at_library(problem, Wrong::none);
  Unknowns u = Unknowns::of(problem, problem.start, reference_of(problem));
  ceres::Problem ceres;
  const auto blocks = build(problem, u, Wrong::none, ceres);
  const Solved solved = solve(ceres, blocks);
  const Named named(problem, u, ceres, blocks);
  const Answer answer = u.answer(problem);
  write_solution(answer, solved.cost, solution);

  Eigen::MatrixXd c;
  double parameter = INFINITY, cov = INFINITY;
  if (covariance(ceres, blocks, c)) {
    const Eigen::MatrixXd j = named.jacobian(), own = j * c * j.transpose();
    cov = apart(own, problem.covariance);
    parameter = named.difference(problem.optimum, answer).cwiseQuotient(own.diagonal().cwiseSqrt()).cwiseAbs().maxCoeff();
    for (size_t o = 0; o < u.offsets.size(); ++o)
      for (int k = 0; k < 4; ++k) {
        const int at = named.offset(u.offsets[o].data()) + k;
        const double sigma = std::sqrt(c(at, at));
        cov = std::fmax(cov, relative(sigma, problem.offset_sigmas[o][k]));
        parameter = std::fmax(parameter, std::fabs(u.offsets[o][k] - problem.optimum.offsets[o][k]) / sigma);
      }
  }
  const double here = relative(there.cost, problem.cost), cost = relative(solved.cost, problem.cost);
  const bool same = here < kCost && cost < kCost && parameter < kParameter && cov < kCovariance &&
                    there.decrement < kStationary && solved.decrement < kStationary;
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  std::printf("%-22s %3d %4d %13.6f %8.1e %8.1e %8.1e %8.1e %8.1e %8.1e %4d %8.1e %5.1f%s\n", problem.name.c_str(),
              static_cast<int>(c.rows()), ceres.NumResiduals(), solved.cost, here, cost, there.decrement, parameter, cov,
              solved.decrement, solved.iterations, solved.own_decrement, seconds, same ? "" : "  DIFFERS");
  std::fflush(stdout);
  return same;
}

// True where the fault is noticed, or where the problem has nothing that it could spoil.
bool refuses(const Problem& problem, Wrong wrong) {
  const bool tangents = !problem.images[0].pairs.empty();
  const bool contours = !problem.images[0].discs.empty();
  if ((wrong == Wrong::distance && !contours) || (wrong == Wrong::whitening && !tangents)) return true;
  const Linear there = at_library(problem, wrong);
  const bool noticed = relative(there.cost, problem.cost) > kCost || !(there.decrement < kStationary);
  std::printf("%-22s cost %8.1e decrement %8.1e %s\n", problem.name.c_str(), relative(there.cost, problem.cost),
              there.decrement, noticed ? "refused" : "NOT NOTICED");
  return noticed;
}

}  // namespace

int main(int argc, char** argv) {
  const std::map<std::string, Wrong> faults = {
      {"tilt", Wrong::tilt}, {"distance", Wrong::distance}, {"whitening", Wrong::whitening}};
  const bool wrong = argc == 4 && std::strcmp(argv[2], "--wrong") == 0 && faults.count(argv[3]);
  if (argc != 2 && !wrong) {
    std::fprintf(stderr, "ceres_agrees DIR [--wrong tilt|distance|whitening]\n");
    return 2;
  }
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(argv[1]))
    if (entry.path().extension() == ".problem") files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  if (files.empty()) {
    std::fprintf(stderr, "%s: no problems\n", argv[1]);
    return 1;
  }
  if (!wrong)
    std::printf("%-22s %3s %4s %13s %8s %8s %8s %8s %8s %8s %4s %8s %5s\n", "problem", "n", "rows", "cost", "at lib.",
                "rel.cost", "lib.decr", "param/s", "cov.", "decrem.", "it.", "unpolish", "s");
  bool good = true;
  for (auto file : files) {
    const Problem problem = Problem::read(file.string());
    good &= wrong ? refuses(problem, faults.at(argv[3])) : agrees(problem, file.replace_extension(".solution").string());
  }
  return good ? 0 : 1;
}
