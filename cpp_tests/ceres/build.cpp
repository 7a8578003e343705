#include "build.hpp"

#include <cmath>

#include "contour.hpp"
#include "tangents.hpp"

namespace {

std::array<double, 7> packed(const Motion& m) {
  const Eigen::Quaterniond q(m.r);
  return {q.w(), q.x(), q.y(), q.z(), m.t.x(), m.t.y(), m.t.z()};
}

Motion unpacked(const Pose<double>& p) {
  Motion m;
  m.r << p.x.x, p.y.x, p.z.x, p.x.y, p.y.y, p.z.y, p.x.z, p.y.z, p.z.z;
  m.t << p.t.x, p.t.y, p.t.z;
  return m;
}

// What one image's residuals are made of: which parameter blocks they get, in which order, and how to read them.
struct Scene {
  const Problem* problem;
  const Reference* reference;
  int view, camera;
  Wrong wrong;

  std::vector<double*> blocks(Unknowns& u) const {
    std::vector<double*> b = {u.intrinsics[camera].data()};
    if (camera > 0) b.push_back(u.motion[camera - 1].data());
    if (problem->in_plane[view]) b.push_back(u.plane.data());
    b.push_back(problem->in_plane[view] ? u.planar[view].data() : u.pose[view].data());
    b.push_back(problem->own_shapes() ? u.own_shape[view].data() : u.shape.data());
    return b;
  }

  template <class T>
  struct View {
    Camera<T> camera;
    Pose<T> cam_from_target;
    const T* shape;
  };

  // Reads the blocks and leaves `p` at the first one behind them.
  template <class T>
  View<T> read(T const* const*& p) const {
    T i[10];
    for (int k = 0; k < 10; ++k) i[k] = p[0][k] * kUnit[k];
    ++p;
    const T* motion = camera > 0 ? *p++ : nullptr;
    Pose<T> pose;
    if (problem->in_plane[view]) {
      pose = planar_pose(p[0], p[1], problem->z[view], *reference);
      p += 2;
    } else {
      pose = Pose<T>::of(*p++);
    }
    return {Camera<T>::of(i, problem->distorted_to_ideal, wrong), motion ? Pose<T>::of(motion) * pose : pose, *p++};
  }

  // Centre and radius of a disc without offsets.
  template <class T>
  void disc(int j, const T* shape, Point<T>* center, T* radius) const {
    if (problem->target == "lattice") {
      const auto& n = problem->nodes[j];
      *center = {shape[0] * n[0], shape[0] * n[1], shape[2] * -n[2]};
      *radius = shape[1];
    } else {
      *center = {j == 0 ? T(0.0) : shape[0], T(0.0), T(0.0)};
      *radius = shape[1 + j];
    }
  }
};

struct EdgeResidual {
  Scene scene;
  int disc;
  bool offsets;
  std::array<double, 3> edge;
  double scale;
  mutable double phi;  // the last foot: the next one is not far

  template <class T>
  bool operator()(T const* const* p, T* residual) const {
    const auto view = scene.read<T>(p);
    Circle<T> circle{view.camera, view.cam_from_target, {}, {}};
    scene.disc(disc, view.shape, &circle.center, &circle.radius);
    if (offsets) {
      circle.center = circle.center + Point<T>{(*p)[0], (*p)[1], (*p)[2]};
      circle.radius = circle.radius + (*p)[3];
    }
    if (value_of(view.cam_from_target(circle.center).z) <= 0.0) return false;
    if (!contour_distance(circle, edge.data(), scene.wrong, phi, residual)) return false;
    *residual = *residual / (edge[2] * scale);
    return true;
  }
};

struct PairResidual {
  Scene scene;
  const Pair* pair;
  Eigen::MatrixXd whitening;

  template <class T>
  bool operator()(T const* const* p, T* residual) const {
    const T* intrinsics = p[0];
    const auto view = scene.read<T>(p);
    Point<T> c[2];
    T r[2];
    for (int k = 0; k < 2; ++k) scene.disc(pair->discs[k], view.shape, &c[k], &r[k]);
    Flat<T> points[14];
    tangent_points<T>({c[0].x, c[0].y}, r[0], {c[1].x, c[1].y}, r[1], points);
    std::vector<T> gap;
    for (size_t k = 0; k < pair->kept.size(); ++k) {
      const Flat<T>& f = points[pair->kept[k]];
      const Point<T> at = view.cam_from_target({f.x, f.y, c[0].z});
      if (value_of(at.z) <= 0.0) return false;
      T q[2];
      view.camera.project(at, q);
      gap.push_back(pair->pixels[2 * k] - q[0]);
      gap.push_back(pair->pixels[2 * k + 1] - q[1]);
    }
    for (int i = 0; i < pair->by_lens.rows(); ++i)
      for (int k = 0; k < 10; ++k) gap[i] += pair->by_lens(i, k) * (intrinsics[k] * kUnit[k] - pair->lens[k]);
    for (int i = 0; i < whitening.rows(); ++i) {
      residual[i] = T(0.0);
      for (size_t j = 0; j < gap.size(); ++j) residual[i] += whitening(i, j) * gap[j];
    }
    return true;
  }
};

struct PointResidual {
  Scene scene;
  bool offsets;
  PointSeen seen;
  double scale;

  template <class T>
  bool operator()(T const* const* p, T* residual) const {
    const auto view = scene.read<T>(p);
    Point<T> center;
    T radius;
    scene.disc(seen.disc, view.shape, &center, &radius);
    if (offsets) center = center + Point<T>{(*p)[0], (*p)[1], (*p)[2]};
    const Point<T> at = view.cam_from_target(center);
    if (value_of(at.z) <= 0.0) return false;
    T q[2];
    view.camera.project(at, q);
    residual[0] = (seen.u - q[0]) / (seen.sigma * scale);
    residual[1] = (seen.v - q[1]) / (seen.sigma * scale);
    return true;
  }
};

// One number known beforehand: `index` of a block, in `unit`.
struct Known {
  int index;
  double unit, value, sigma;
  template <class T>
  bool operator()(T const* const* p, T* r) const {
    *r = (p[0][index] * unit - value) / sigma;
    return true;
  }
};

struct Baseline {
  double value, sigma;
  template <class T>
  bool operator()(T const* const* p, T* r) const {
    using std::sqrt;
    const T* t = p[0] + 4;
    *r = (sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2]) - value) / sigma;
    return true;
  }
};

// In focus is the plane (tan b / F, tan a / (F cos b), m (1 / f_lens - 1 / F)) . p = 1 of the camera frame; two
// directions e in the sheet at right angles have to be at right angles to its normal, with the sheet's c where f_lens is not
// needed. Which directions does not change the cost, but where the residuals are not small, directions that spin in the sheet as
// other parameters change give another J^T J (by a thousandth in the covariance). Like the library's, these stand still against
// the sensor of the first camera.
struct FocusResidual {
  Fact fact;
  Point<double> still;  // in the frame of that sensor

  // Blocks: intrinsics, motion unless the first camera, plane, intrinsics of the first camera unless it is the first.
  template <class T>
  bool operator()(T const* const* p, T* r) const {
    using std::cos;
    using std::sqrt;
    using std::tan;
    const bool second = fact.camera > 0;
    const T f = p[0][0] * (kUnit[0] * fact.value), a = p[0][4], b = p[0][5];
    const T* plane = p[second ? 2 : 1];
    Point<T> abc{plane[0] * kPlaneUnit, plane[1] * kPlaneUnit, plane[2] * kPlaneUnit};
    const Camera<T> first = Camera<T>::of(p[second ? 3 : 0], false, Wrong::none);
    Point<T> x = first.u * T(still.x) + first.v * T(still.y) + cross(first.u, first.v) * T(still.z);
    if (second) {
      const Pose<T> m = Pose<T>::of(p[1]);
      abc = m.turned(abc);
      abc = abc * (T(1.0) / (T(1.0) + dot(abc, m.t)));
      x = m.turned(x);
    }
    const T c = abc.z;
    const Point<T> n = abc * (T(1.0) / sqrt(dot(abc, abc))), g{tan(b) / f, tan(a) / (f * cos(b)), c};
    x = x - n * dot(x, n);
    x = x * (T(1.0) / sqrt(dot(x, x)));
    const T size = sqrt(dot(g, g));
    r[0] = dot(x, g) / (size * fact.sigma);
    r[1] = dot(cross(n, x), g) / (size * fact.sigma);
    const T ratio = p[0][9];
    if (fact.distance) r[2] = (ratio * (1.0 / fact.focal_length - 1.0 / f) / c - 1.0) / fact.distance_sigma;
    return true;
  }
};

// The plane's x axis in the frame of the first camera's sensor, at the library's optimum.
Point<double> still_direction(const Problem& problem) {
  double i[10];
  std::copy(problem.optimum.intrinsics[0].begin(), problem.optimum.intrinsics[0].end(), i);
  const Camera<double> c = Camera<double>::of(i, false, Wrong::none);
  const Eigen::Vector3d x = problem.optimum.plane[0].r.col(0);
  const Point<double> p{x.x(), x.y(), x.z()};
  return {dot(c.u, p), dot(c.v, p), dot(cross(c.u, c.v), p)};
}

template <class F>
void add(ceres::Problem& ceres, F* functor, int residuals, ceres::LossFunction* loss,
         const std::vector<std::pair<double*, int>>& blocks) {
  auto* cost = new ceres::DynamicAutoDiffCostFunction<F, 8>(functor);
  std::vector<double*> pointers;
  for (const auto& [pointer, size] : blocks) {
    cost->AddParameterBlock(size);
    pointers.push_back(pointer);
  }
  cost->SetNumResiduals(residuals);
  ceres.AddResidualBlock(cost, loss, pointers);
}

ceres::LossFunction* loss_of(const Problem& problem, int rank) {
  const double k = problem.loss_scale * std::sqrt(static_cast<double>(rank));
  if (problem.loss == "huber") return new ceres::HuberLoss(k);
  if (problem.loss == "cauchy") return new ceres::CauchyLoss(k);
  return nullptr;
}

std::vector<std::pair<double*, int>> sized(const Problem& problem, const Scene& s, Unknowns& u) {
  std::vector<std::pair<double*, int>> out;
  std::vector<int> sizes = {10};
  if (s.camera > 0) sizes.push_back(7);
  if (problem.in_plane[s.view]) sizes.push_back(3);
  sizes.push_back(problem.in_plane[s.view] ? 3 : 7);
  sizes.push_back(3);
  const auto blocks = s.blocks(u);
  for (size_t i = 0; i < blocks.size(); ++i) out.push_back({blocks[i], sizes[i]});
  return out;
}

// As if the features were independent of each other: what must be noticed.
Eigen::MatrixXd independent(const Eigen::MatrixXd& whitening) {
  const Eigen::MatrixXd root = whitening.completeOrthogonalDecomposition().pseudoInverse();
  return root.rowwise().norm().cwiseInverse().asDiagonal();
}

void add_images(const Problem& problem, Unknowns& u, Wrong wrong, ceres::Problem& ceres) {
  for (const Image& image : problem.images) {
    const Scene scene{&problem, &u.reference, image.view, image.camera, wrong};
    for (const Disc& disc : image.discs) {
      auto blocks = sized(problem, scene, u);
      const bool offsets = !u.offsets.empty();
      if (offsets) blocks.push_back({u.offsets[disc.disc].data(), 4});
      for (const auto& edge : disc.edge)
        add(ceres, new EdgeResidual{scene, disc.disc, offsets, edge, image.scale, NAN}, 1, loss_of(problem, 1), blocks);
    }
    for (const Pair& pair : image.pairs) {
      Eigen::MatrixXd w = pair.whitening / image.scale;
      if (wrong == Wrong::whitening) w = independent(w);
      auto* functor = new PairResidual{scene, &pair, w};
      add(ceres, functor, w.rows(), loss_of(problem, w.rows()), sized(problem, scene, u));
    }
    for (const PointSeen& p : image.points) {
      auto blocks = sized(problem, scene, u);
      if (!u.offsets.empty()) blocks.push_back({u.offsets[p.disc].data(), 4});
      add(ceres, new PointResidual{scene, !u.offsets.empty(), p, image.scale}, 2, loss_of(problem, 2), blocks);
    }
  }
}

void add_facts(const Problem& problem, Unknowns& u, ceres::Problem& ceres) {
  for (const Fact& f : problem.facts) {
    if (f.kind == "intrinsic") {
      add(ceres, new Known{f.parameter, kUnit[f.parameter], f.value, f.sigma}, 1, nullptr,
          {{u.intrinsics[f.camera].data(), 10}});
    } else if (f.kind == "baseline") {
      add(ceres, new Baseline{f.value, f.sigma}, 1, nullptr, {{u.motion[0].data(), 7}});
    } else if (f.kind == "shape") {
      double* block = f.view >= 0 ? u.own_shape[f.view].data() : u.shape.data();
      add(ceres, new Known{f.parameter, 1.0, f.value, f.sigma}, 1, nullptr, {{block, 3}});
    } else if (f.kind == "focus") {
      std::vector<std::pair<double*, int>> blocks = {{u.intrinsics[f.camera].data(), 10}};
      if (f.camera > 0) blocks.push_back({u.motion[f.camera - 1].data(), 7});
      blocks.push_back({u.plane.data(), 3});
      if (f.camera > 0) blocks.push_back({u.intrinsics[0].data(), 10});
      add(ceres, new FocusResidual{f, still_direction(problem)}, f.distance ? 3 : 2, nullptr, blocks);
    } else {
      throw std::runtime_error("unknown fact " + f.kind);
    }
  }
  for (auto& offset : u.offsets)
    for (int k = 0; k < 4; ++k)
      add(ceres, new Known{k, 1.0, 0.0, problem.offset_sigma[k]}, 1, nullptr, {{offset.data(), 4}});
}

// Holds what is not free; false where nothing of the block is.
template <size_t N>
bool hold(ceres::Problem& ceres, std::array<double, N>& block, const std::array<bool, N>& free) {
  if (!ceres.HasParameterBlock(block.data())) return false;
  std::vector<int> fixed;
  for (size_t k = 0; k < N; ++k)
    if (!free[k]) fixed.push_back(static_cast<int>(k));
  if (fixed.size() == N) {
    ceres.SetParameterBlockConstant(block.data());
    return false;
  }
  if (!fixed.empty()) ceres.SetManifold(block.data(), new ceres::SubsetManifold(N, fixed));
  return true;
}

using PoseManifold = ceres::ProductManifold<ceres::QuaternionManifold, ceres::EuclideanManifold<3>>;

}  // namespace

Reference reference_of(const Problem& problem) {
  if (problem.start.plane.empty()) return {};
  const Motion& m = problem.start.plane[0];
  return {m.t, m.r.col(0), m.r.col(2)};
}

Unknowns Unknowns::of(const Problem& problem, const Answer& a, const Reference& reference) {
  Unknowns u;
  u.reference = reference;
  for (auto i : a.intrinsics) {
    for (int k = 0; k < 10; ++k) i[k] /= kUnit[k];
    u.intrinsics.push_back(i);
  }
  for (const Motion& m : a.cam_from_rig) u.motion.push_back(packed(m));
  u.plane = {};
  Pose<double> frame{};
  if (!a.plane.empty()) {
    const Eigen::Vector3d n = a.plane[0].r.col(2);
    const Eigen::Vector3d abc = n / n.dot(a.plane[0].t) / kPlaneUnit;
    u.plane = {abc.x(), abc.y(), abc.z()};
    const double zero[3] = {};
    frame = planar_pose(u.plane.data(), zero, 0.0, reference);
  }
  const Motion plane = unpacked(frame);
  for (size_t v = 0; v < a.rig_from_target.size(); ++v) {
    const Motion& m = a.rig_from_target[v];
    u.pose.push_back(packed(m));
    const Eigen::Vector3d at = plane.r.transpose() * (m.t - plane.t), x = plane.r.transpose() * m.r.col(0);
    u.planar.push_back({std::atan2(x.y(), x.x()), at.x(), at.y()});
  }
  u.shape = a.shape;
  u.own_shape = a.own_shape;
  u.offsets = a.offsets;
  if (problem.offset_sigmas.empty()) u.offsets.clear();
  return u;
}

Answer Unknowns::answer(const Problem& problem) const {
  Answer a;
  for (auto i : intrinsics) {
    for (int k = 0; k < 10; ++k) i[k] *= kUnit[k];
    a.intrinsics.push_back(i);
  }
  for (const auto& m : motion) a.cam_from_rig.push_back(unpacked(Pose<double>::of(m.data())));
  const double zero[3] = {};
  if (!problem.start.plane.empty()) a.plane.push_back(unpacked(planar_pose(plane.data(), zero, 0.0, reference)));
  for (size_t v = 0; v < pose.size(); ++v) {
    a.rig_from_target.push_back(unpacked(problem.in_plane[v]
                                             ? planar_pose(plane.data(), planar[v].data(), problem.z[v], reference)
                                             : Pose<double>::of(pose[v].data())));
  }
  a.shape = shape;
  a.own_shape = own_shape;
  a.offsets = offsets;
  return a;
}

std::vector<double*> build(const Problem& problem, Unknowns& u, Wrong wrong, ceres::Problem& ceres) {
  add_images(problem, u, wrong, ceres);
  return with_facts(problem, u, ceres, [] {
    return new PoseManifold(ceres::QuaternionManifold(), ceres::EuclideanManifold<3>());
  });
}

std::vector<double*> with_facts(const Problem& problem, Unknowns& u, ceres::Problem& ceres,
                                const std::function<ceres::Manifold*()>& pose) {
  add_facts(problem, u, ceres);
  std::vector<double*> free;
  for (size_t c = 0; c < u.intrinsics.size(); ++c)
    if (hold(ceres, u.intrinsics[c], problem.free[c])) free.push_back(u.intrinsics[c].data());
  for (auto& m : u.motion) {
    ceres.SetManifold(m.data(), pose());
    free.push_back(m.data());
  }
  if (ceres.HasParameterBlock(u.plane.data())) free.push_back(u.plane.data());
  if (hold(ceres, u.shape, problem.free_shape)) free.push_back(u.shape.data());
  for (size_t v = 0; v < u.pose.size(); ++v) {
    if (problem.in_plane[v]) {
      free.push_back(u.planar[v].data());
    } else {
      ceres.SetManifold(u.pose[v].data(), pose());
      free.push_back(u.pose[v].data());
    }
    if (hold(ceres, u.own_shape[v], problem.free_shape)) free.push_back(u.own_shape[v].data());
  }
  for (auto& o : u.offsets) free.push_back(o.data());
  return free;
}
