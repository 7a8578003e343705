// Signed orthogonal distance of an edge point from the image of its circle:
//   r = n . (q - q(phi)),  g(phi) = (q(phi) - q) . q'(phi) = 0,  q(phi) = image of C + R (cos phi, sin phi, 0)
// The foot phi is found in doubles; one Newton step on the autodiff type gives it its derivative by everything else
// (implicit function theorem), and normal and distance follow from it. q' and g' come from Slope, not from formulas.
#pragma once

#include <cmath>

#include "camera.hpp"

inline double value_of(double x) { return x; }
template <class T, int N>
double value_of(const ceres::Jet<T, N>& x) { return value_of(x.a); }

template <class T>
struct Circle {
  Camera<T> camera;
  Pose<T> cam_from_target;
  Point<T> center;
  T radius;

  template <class S>
  void image(const S& cos_phi, const S& sin_phi, S* q) const {
    const Pose<T>& m = cam_from_target;
    const Point<S> c = lift<S>(m(center)), ex = lift<S>(m.x), ey = lift<S>(m.y);
    const S r = Lift<S, T>::from(radius);
    camera.template lifted<S>().project(c + ex * (r * cos_phi) + ey * (r * sin_phi), q);
  }

  // Image and its derivative by phi.
  void with_tangent(const T& phi, Slope<T>* q) const {
    using std::cos;
    using std::sin;
    const T c = cos(phi), s = sin(phi);
    image(Slope<T>(c, -s), Slope<T>(s, c), q);
  }

  Circle<double> plain() const {
    const auto p = [](const Point<T>& a) { return Point<double>{value_of(a.x), value_of(a.y), value_of(a.z)}; };
    const Camera<T>& c = camera;
    const Pose<T>& m = cam_from_target;
    return {{value_of(c.f), value_of(c.fv), value_of(c.cx), value_of(c.cy), value_of(c.m), value_of(c.k1),
             value_of(c.k2), value_of(c.k3), p(c.u), p(c.v), c.distorted_to_ideal},
            {p(m.x), p(m.y), p(m.z), p(m.t)},
            p(center),
            value_of(radius)};
  }
};

// Foot of a pixel, in doubles, and the derivative of g there.
struct Foot {
  double phi, slope;
  bool found;
};

// `phi`: a foot close by, or NaN; comes back as the foot.
inline Foot foot(const Circle<double>& circle, const double* seen, double& phi) {
  double best = INFINITY;
  const bool known = std::isfinite(phi);
  for (int k = 0; k < 24 && !known; ++k) {
    const double a = k * (M_PI / 12.0), c = std::cos(a), s = std::sin(a);
    double q[2];
    circle.image(c, s, q);
    const double gap = std::hypot(q[0] - seen[0], q[1] - seen[1]);
    if (gap < best) best = gap, phi = a;
  }
  double slope = 0.0;
  using Twice = Slope<Slope<double>>;
  for (int round = 0; round < 30; ++round) {
    const double c = std::cos(phi), s = std::sin(phi);
    Twice q[2];
    circle.image(Twice({c, -s}, {-s, -c}), Twice({s, c}, {c, -s}), q);
    // q.v.v = q, q.v.d = q.d.v = q', q.d.d = q''.
    double g = 0.0, speed = 0.0;
    slope = 0.0;
    for (int i = 0; i < 2; ++i) {
      const double gap = q[i].v.v - seen[i];
      g += gap * q[i].v.d;
      speed += q[i].v.d * q[i].v.d;
      slope += q[i].v.d * q[i].v.d + gap * q[i].d.d;
    }
    const double step = g / std::fmax(slope, 0.2 * speed);
    phi -= std::fmax(-0.3, std::fmin(0.3, step));
    if (std::fabs(step) < 1e-13) return {phi, slope, std::isfinite(phi)};
  }
  return {phi, slope, std::isfinite(phi)};
}

template <class T>
bool contour_distance(const Circle<T>& circle, const double* seen, Wrong wrong, double& phi, T* distance) {
  using std::sqrt;
  const Circle<double> plain = circle.plain();
  const Foot at = foot(plain, seen, phi);
  if (!at.found) return false;
  Slope<T> q[2];
  circle.with_tangent(T(at.phi), q);
  const T g = (q[0].v - seen[0]) * q[0].d + (q[1].v - seen[1]) * q[1].d;
  circle.with_tangent(T(at.phi) - g / at.slope, q);
  const T length = sqrt(q[0].d * q[0].d + q[1].d * q[1].d);
  T n[2] = {q[1].d / length, -q[0].d / length};
  double center[2];
  plain.camera.project(plain.cam_from_target(plain.center), center);
  const double outward =
      value_of(n[0]) * (value_of(q[0].v) - center[0]) + value_of(n[1]) * (value_of(q[1].v) - center[1]);
  if (outward < 0.0) n[0] = -n[0], n[1] = -n[1];
  *distance = n[0] * (seen[0] - q[0].v) + n[1] * (seen[1] - q[1].v);
  // The distance from the contour along the ray from the centre, as an algebraic fit takes it, is nearly the same.
  if (wrong == Wrong::distance) {
    const double dx = seen[0] - center[0], dy = seen[1] - center[1], r = std::hypot(dx, dy);
    *distance = *distance / ((n[0] * dx + n[1] * dy) / r);
  }
  return true;
}
