// Time of one adjustment: the library against Ceres, with automatic derivatives per observation and with derivatives written
// by hand, one residual block per image; same cost, same start, as many threads each.
//   bench_adjust DIR EXPORTER ROUNDS THREADS NAME...    DIR: problems of `EXPORTER --bench DIR NAME...`; EXPORTER: examples/export_problem
//
// Ceres eliminates the views (DENSE_SCHUR), or the points where each is estimated (one block per observation then), and starts each foot where it was last. All run until nothing that matters is
// left: the library to a Newton decrement of 1e-6, Ceres to a relative change of the cost of 1e-10; the excess of
// its cost is printed. Rounds of all take turns; medians of the rounds. Automatic derivatives are left out of the large problems.

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>

#include "build.hpp"
#include "by_hand.hpp"

namespace {

double median(std::vector<double> x) {
  std::sort(x.begin(), x.end());
  return x[x.size() / 2];
}

int threads = 1;

// Processor time of one thread: what else the machine does is not counted; elapsed time of several.
double now() {
  timespec t;
  clock_gettime(threads == 1 ? CLOCK_PROCESS_CPUTIME_ID : CLOCK_MONOTONIC, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

// A pose whose derivatives are given by a turn w about its own origin and a shift v, exp(w) q and t + v: six of the seven columns of a
// Jacobian, so that nothing has to be multiplied.
class OwnStep : public ceres::Manifold {
 public:
  int AmbientSize() const override { return 7; }
  int TangentSize() const override { return 6; }
  bool Plus(const double* x, const double* d, double* out) const override {
    const Eigen::Vector3d w(d[0], d[1], d[2]);
    const double angle = w.norm(), s = angle > 1e-12 ? std::sin(0.5 * angle) / angle : 0.5;
    const Eigen::Quaterniond turn(std::cos(0.5 * angle), s * w.x(), s * w.y(), s * w.z());
    const Eigen::Quaterniond q = (turn * Eigen::Quaterniond(x[0], x[1], x[2], x[3])).normalized();
    const Eigen::Vector3d t(x[4] + d[3], x[5] + d[4], x[6] + d[5]);
    out[0] = q.w(), out[1] = q.x(), out[2] = q.y(), out[3] = q.z();
    out[4] = t.x(), out[5] = t.y(), out[6] = t.z();
    return true;
  }
  bool PlusJacobian(const double*, double* j) const override {
    for (int i = 0; i < 42; ++i) j[i] = i / 6 == i % 6 ? 1.0 : 0.0;
    return true;
  }
  bool Minus(const double*, const double*, double*) const override { return false; }
  bool MinusJacobian(const double*, double*) const override { return false; }
};

// Derivatives by a turn w about the frame's origin and a shift v to those of OwnStep for a motion with translation t.
void about_own_origin(const double* w, const double* v, const std::array<double, 3>& t, double* out) {
  out[0] = w[0] - (t[1] * v[2] - t[2] * v[1]);
  out[1] = w[1] - (t[2] * v[0] - t[0] * v[2]);
  out[2] = w[2] - (t[0] * v[1] - t[1] * v[0]);
  out[3] = v[0], out[4] = v[1], out[5] = v[2], out[6] = 0.0;
}

// Derivatives by the turn w and shift v in the camera frame to those in the rig's, through the adjoint of cam_from_rig:
// w -> R w, [t]x R w;  v -> R v.
void through(const by_hand::Motion& cam_from_rig, const double* w, const double* v, double* turn, double* shift) {
  const auto &t = cam_from_rig.t, a = std::array<double, 3>{w[0] + v[1] * t[2] - v[2] * t[1],
                                                            w[1] + v[2] * t[0] - v[0] * t[2],
                                                            w[2] + v[0] * t[1] - v[1] * t[0]};
  for (int k = 0; k < 3; ++k) {
    const auto& r = cam_from_rig.r;
    turn[k] = a[0] * r[k] + a[1] * r[3 + k] + a[2] * r[6 + k];
    shift[k] = v[0] * r[k] + v[1] * r[3 + k] + v[2] * r[6 + k];
  }
}

// One observation of a point that is estimated; blocks: intrinsics, motion unless the first camera, pose, offset of the point.
class FreePointCost : public ceres::CostFunction {
 public:
  FreePointCost(std::array<double, 3> nominal, std::array<double, 3> seen, bool second)
      : nominal_(nominal), seen_(seen), second_(second) {
    set_num_residuals(2);
    *mutable_parameter_block_sizes() = second ? std::vector<int32_t>{10, 7, 7, 4} : std::vector<int32_t>{10, 7, 4};
  }

  bool Evaluate(double const* const* p, double* residuals, double** jacobians) const override {
    using by_hand::Motion;
    double intrinsics[10], local[32], place[6];
    for (int k = 0; k < 10; ++k) intrinsics[k] = p[0][k] * kUnit[k];
    const Motion cam_from_rig = second_ ? Motion::of(p[1]) : Motion{};
    const Motion pose = Motion::of(p[second_ ? 2 : 1]);
    const int offset = second_ ? 3 : 2;
    const double x[3] = {nominal_[0] + p[offset][0], nominal_[1] + p[offset][1], nominal_[2] + p[offset][2]};
    if (!by_hand::evaluate_point(intrinsics, second_ ? cam_from_rig * pose : pose, x, seen_.data(), residuals,
                                 jacobians ? local : nullptr, place))
      return false;
    if (!jacobians) return true;
    for (int i = 0; i < 2; ++i) {
      const double* row = local + 16 * i;
      if (jacobians[0])
        for (int k = 0; k < 10; ++k) jacobians[0][10 * i + k] = row[k] * kUnit[k];
      if (jacobians[offset]) {
        for (int k = 0; k < 3; ++k) jacobians[offset][4 * i + k] = place[3 * i + k];
        jacobians[offset][4 * i + 3] = 0.0;
      }
      if (second_ && jacobians[1]) about_own_origin(row + 10, row + 13, cam_from_rig.t, jacobians[1] + 7 * i);
      if (double* out = jacobians[second_ ? 2 : 1]) {
        double turn[3] = {row[10], row[11], row[12]}, shift[3] = {row[13], row[14], row[15]};
        if (second_) through(cam_from_rig, row + 10, row + 13, turn, shift);
        about_own_origin(turn, shift, pose.t, out + 7 * i);
      }
    }
    return true;
  }

 private:
  std::array<double, 3> nominal_, seen_;
  bool second_;
};

// All residuals of an image; blocks: intrinsics, motion unless the first camera, pose, lengths of the target.
class ImageCost : public ceres::CostFunction {
 public:
  ImageCost(by_hand::Image image, bool second) : image_(std::move(image)), second_(second) {
    set_num_residuals(image_.residuals());
    *mutable_parameter_block_sizes() = second ? std::vector<int32_t>{10, 7, 7, 3} : std::vector<int32_t>{10, 7, 3};
    local_.resize(static_cast<size_t>(num_residuals()) * by_hand::kLocal);
  }

  bool Evaluate(double const* const* p, double* residuals, double** jacobians) const override {
    using by_hand::Motion;
    double intrinsics[10];
    for (int k = 0; k < 10; ++k) intrinsics[k] = p[0][k] * kUnit[k];
    const Motion cam_from_rig = second_ ? Motion::of(p[1]) : Motion{};
    const Motion pose = Motion::of(p[second_ ? 2 : 1]);
    const int shape = second_ ? 3 : 2, n = num_residuals();
    if (!by_hand::evaluate(image_, intrinsics, second_ ? cam_from_rig * pose : pose, p[shape], residuals,
                           jacobians ? local_.data() : nullptr))
      return false;
    if (!jacobians) return true;
    for (int i = 0; i < n; ++i) {
      const double* row = &local_[static_cast<size_t>(i) * by_hand::kLocal];
      if (jacobians[0])
        for (int k = 0; k < 10; ++k) jacobians[0][10 * i + k] = row[k] * kUnit[k];
      if (jacobians[shape])
        for (int k = 0; k < 3; ++k) jacobians[shape][3 * i + k] = row[16 + k];
      if (second_ && jacobians[1]) about_own_origin(row + 10, row + 13, cam_from_rig.t, jacobians[1] + 7 * i);
      double* out = jacobians[second_ ? 2 : 1];
      if (!out) continue;
      out += 7 * i;
      if (!second_) {
        about_own_origin(row + 10, row + 13, pose.t, out);
        continue;
      }
      double turn[3], shift[3];
      through(cam_from_rig, row + 10, row + 13, turn, shift);
      about_own_origin(turn, shift, pose.t, out);
    }
    return true;
  }

 private:
  mutable by_hand::Image image_;
  bool second_;
  mutable std::vector<double> local_;
};

by_hand::Image converted(const Problem& problem, const Image& image) {
  by_hand::Image out;
  for (const Disc& d : image.discs) {
    by_hand::Contour c;
    const bool lattice = problem.target == "lattice";
    c.pair = lattice ? -1 : d.disc;
    if (lattice) c.node = problem.nodes[d.disc];
    for (const auto& e : d.edge) c.u.push_back(e[0]), c.v.push_back(e[1]), c.sigma.push_back(e[2] * image.scale);
    out.contours.push_back(std::move(c));
  }
  for (const Pair& p : image.pairs) {
    by_hand::Tangents t{p.kept, {p.pixels.begin(), p.pixels.end()}, {}, static_cast<int>(p.whitening.rows())};
    for (int i = 0; i < p.whitening.rows(); ++i)
      for (int j = 0; j < p.whitening.cols(); ++j) t.whitening.push_back(p.whitening(i, j) / image.scale);
    out.tangents.push_back(std::move(t));
  }
  for (const PointSeen& p : image.points) {
    out.points.node.push_back(problem.nodes[p.disc]);
    out.points.u.push_back(p.u), out.points.v.push_back(p.v), out.points.sigma.push_back(p.sigma * image.scale);
  }
  return out;
}

std::vector<double*> build_by_hand(const Problem& problem, Unknowns& u, ceres::Problem& ceres) {
  for (const Image& image : problem.images) {
    const bool second = image.camera > 0;
    std::vector<double*> blocks = {u.intrinsics[image.camera].data()};
    if (second) blocks.push_back(u.motion[0].data());
    blocks.push_back(u.pose[image.view].data());
    if (!u.offsets.empty()) {
      for (const PointSeen& p : image.points) {
        const auto& n = problem.nodes[p.disc];
        auto own = blocks;
        own.push_back(u.offsets[p.disc].data());
        ceres.AddResidualBlock(new FreePointCost({n[0] * u.shape[0], n[1] * u.shape[0], -n[2] * u.shape[2]},
                                                 {p.u, p.v, p.sigma * image.scale}, second),
                               nullptr, own);
      }
      continue;
    }
    blocks.push_back(u.shape.data());
    ceres.AddResidualBlock(new ImageCost(converted(problem, image), second), nullptr, blocks);
  }
  return with_facts(problem, u, ceres, [] { return new OwnStep; });
}

struct Run {
  double seconds, cost;
  int iterations;
};

using Build = std::function<std::vector<double*>(const Problem&, Unknowns&, ceres::Problem&)>;

struct Solved {
  Unknowns u;
  ceres::Problem ceres;
  Run run;
};

void solve(const Problem& problem, const Build& build, Solved& s) {
  s.u = Unknowns::of(problem, problem.start, reference_of(problem));
  const auto blocks = build(problem, s.u, s.ceres);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 1000;
  options.function_tolerance = 1e-10;
  options.gradient_tolerance = 0.0;
  options.parameter_tolerance = 0.0;
  options.num_threads = threads;
  options.logging_type = ceres::SILENT;
  auto* order = new ceres::ParameterBlockOrdering;
  for (double* b : blocks) order->AddElementToGroup(b, 1);
  // Blocks that are held have to be in some group as well.
  if (s.ceres.HasParameterBlock(s.u.shape.data())) order->AddElementToGroup(s.u.shape.data(), 1);
  for (auto& own : s.u.own_shape)
    if (s.ceres.HasParameterBlock(own.data())) order->AddElementToGroup(own.data(), 1);
  if (s.u.offsets.empty())
    for (size_t v = 0; v < s.u.pose.size(); ++v)
      order->AddElementToGroup(problem.in_plane[v] ? s.u.planar[v].data() : s.u.pose[v].data(), 0);
  for (auto& offset : s.u.offsets) order->AddElementToGroup(offset.data(), 0);
  options.linear_solver_ordering.reset(order);
  ceres::Solver::Summary summary;
  const double begin = now();
  ceres::Solve(options, &s.ceres, &summary);
  s.run = {now() - begin, summary.final_cost, static_cast<int>(summary.iterations.size()) - 1};
}

// Covariance of everything but the poses, and with `poses` of each pose, and of each pose with the rest: what the library keeps as well.
double covariance_seconds(const Problem& problem, Solved& s, bool poses) {
  std::vector<const double*> global;
  for (auto& i : s.u.intrinsics) global.push_back(i.data());
  for (auto& m : s.u.motion) global.push_back(m.data());
  global.push_back(s.u.shape.data());
  std::vector<std::pair<const double*, const double*>> wanted;
  for (size_t i = 0; i < global.size(); ++i)
    for (size_t j = i; j < global.size(); ++j) wanted.push_back({global[i], global[j]});
  for (size_t v = 0; poses && v < problem.in_plane.size(); ++v) {
    const double* pose = s.u.pose[v].data();
    wanted.push_back({pose, pose});
    for (const double* g : global) wanted.push_back({pose, g});
  }
  ceres::Covariance::Options options;
  options.num_threads = threads;
  ceres::Covariance covariance(options);
  const double begin = now();
  const bool good = covariance.Compute(wanted, &s.ceres);
  return good ? now() - begin : -1.0;
}

struct Library {
  double observations, seconds, cost, decrement, iterations, covariance, shared, named;
};

// In a process of its own.
Library by_library(const std::string& exporter, const std::string& name, int repeats) {
  const std::string command = exporter + " --time " + name + " " + std::to_string(repeats) + " " + std::to_string(threads);
  FILE* pipe = popen(command.c_str(), "r");
  Library l{};
  const int read = pipe ? std::fscanf(pipe, "%lf %lf %lf %lf %lf %lf %lf %lf", &l.observations, &l.seconds, &l.cost,
                                      &l.decrement, &l.iterations, &l.covariance, &l.shared, &l.named)
                        : 0;
  if (!pipe || pclose(pipe) != 0 || read != 8) throw std::runtime_error(command + ": failed");
  return l;
}

// Observations beyond which automatic derivatives per observation take too long to wait for.
constexpr double kMany = 20000;

void compare(const std::string& dir, const std::string& exporter, const std::string& name, int rounds) {
  const Problem problem = Problem::read(dir + "/" + name + ".problem");
  std::vector<double> automatic, by_hand, library, covariance, own, shared, own_shared;
  Run a{}, b{};
  Library l{};
  // Minutes for the largest.
  for (int round = 0; round < (problem.start.offsets.empty() ? rounds : std::min(rounds, 3)); ++round) {
    l = by_library(exporter, name, problem.start.offsets.empty() ? 15 : 1);
    library.push_back(l.seconds);
    own.push_back(l.covariance);
    own_shared.push_back(l.shared);
    Solved s;
    solve(problem, build_by_hand, s);
    b = s.run;
    by_hand.push_back(b.seconds);
    if (l.observations > kMany) continue;
    covariance.push_back(covariance_seconds(problem, s, true));
    shared.push_back(covariance_seconds(problem, s, false));
    Solved t;
    solve(problem, [](const Problem& p, Unknowns& u, ceres::Problem& c) { return build(p, u, Wrong::none, c); }, t);
    a = t.run;
    automatic.push_back(a.seconds);
  }
  const double y = median(library), x = median(by_hand);
  std::printf("%-14s %8.0f |", name.c_str(), l.observations);
  if (automatic.empty()) {
    std::printf(" %9s %3s %6s |", "-", "-", "-");
  } else {
    std::printf(" %9.2f %3d %6.1f |", 1e3 * median(automatic), a.iterations, median(automatic) / y);
  }
  std::printf(" %9.3f %3d %6.1f | %9.3f %3.0f | %9.1e |", 1e3 * x, b.iterations, x / y, 1e3 * y, l.iterations,
              b.cost / l.cost - 1.0);
  if (covariance.empty()) {
    std::printf(" %9s %9.4f | %9s %9.4f\n", "-", 1e3 * median(own), "-", 1e3 * median(own_shared));
  } else {
    std::printf(" %9.3f %9.4f | %9.3f %9.4f\n", 1e3 * median(covariance), 1e3 * median(own), 1e3 * median(shared),
                1e3 * median(own_shared));
  }
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 6) return std::fprintf(stderr, "bench_adjust DIR EXPORTER ROUNDS THREADS NAME...\n"), 2;
  threads = std::atoi(argv[4]);
  std::printf("Milliseconds, iterations, and times of the library. Last: Ceres's excess of cost; covariance by Ceres (-1000: fails), library; the same of what the views share alone.\n");
  std::printf("%-14s %8s | %-20s | %-20s | %-13s | %9s | %s\n", "problem", "numbers", "Ceres, automatic", "Ceres, by hand",
              "spivcal", "cost", "covariance");
  for (int k = 5; k < argc; ++k) compare(argv[1], argv[2], argv[k], std::atoi(argv[3]));
  return 0;
}
