// The cost of a problem for Ceres, in parameters of its own choice: intrinsics as they are, poses as quaternion and shift, the
// plane as the paper's (a, b, c) with n . p = 1. No pinhole chart, no blocks, no formulas of derivatives.
#pragma once

#include <ceres/ceres.h>

#include <functional>
#include <memory>

#include "camera.hpp"
#include "problem.hpp"

// Parameter blocks are held in units that make columns comparable.
constexpr std::array<double, 10> kUnit = {1e3, 1.0, 1e3, 1e3, 1.0, 1.0, 1.0, 10.0, 100.0, 1.0};
constexpr double kPlaneUnit = 1e-3;

// Axes within the plane: a fixed direction and a fixed point, projected on it.
struct Reference {
  Eigen::Vector3d origin, x, z;
};

struct Unknowns {
  std::vector<std::array<double, 10>> intrinsics;
  std::vector<std::array<double, 7>> motion;  // quaternion w x y z, shift
  std::array<double, 3> plane;
  std::vector<std::array<double, 7>> pose;    // of free views
  std::vector<std::array<double, 3>> planar;  // of views in the plane: turn, x, y
  std::array<double, 3> shape;
  std::vector<std::array<double, 3>> own_shape;
  std::vector<std::array<double, 4>> offsets;
  Reference reference;

  static Unknowns of(const Problem& problem, const Answer& answer, const Reference& reference);
  Answer answer(const Problem& problem) const;
};

Reference reference_of(const Problem& problem);

// rig_from_target of a view in the plane.
template <class T>
Pose<T> planar_pose(const T* plane, const T* planar, double z, const Reference& ref) {
  using std::cos;
  using std::sin;
  using std::sqrt;
  const auto fixed = [](const Eigen::Vector3d& p) { return Point<T>{T(p.x()), T(p.y()), T(p.z())}; };
  const Point<T> abc{plane[0] * kPlaneUnit, plane[1] * kPlaneUnit, plane[2] * kPlaneUnit};
  const T inverse = T(1.0) / sqrt(dot(abc, abc));
  const Point<T> n = abc * inverse, x0 = fixed(ref.x), r0 = fixed(ref.origin);
  const Point<T> axis = dot(n, fixed(ref.z)) < T(0.0) ? n * T(-1.0) : n;
  const Point<T> across = x0 - axis * dot(axis, x0);
  const Point<T> x = across * (T(1.0) / sqrt(dot(across, across))), y = cross(axis, x);
  const Point<T> origin = r0 - n * (dot(n, r0) - inverse);
  const T c = cos(planar[0]), s = sin(planar[0]);
  return {x * c + y * s, y * c - x * s, axis, origin + x * planar[1] + y * planar[2] + axis * T(z)};
}

// Adds all residual blocks; `unknowns` must outlive the Ceres problem. Blocks that are adjusted come back in order.
std::vector<double*> build(const Problem& problem, Unknowns& unknowns, Wrong wrong, ceres::Problem& ceres);
// The same for residual blocks of images that are there already: facts, and what is held. `pose` makes the manifold of a pose.
std::vector<double*> with_facts(const Problem& problem, Unknowns& unknowns, ceres::Problem& ceres,
                                const std::function<ceres::Manifold*()>& pose);
