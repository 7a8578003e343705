// The Scheimpflug camera as geometry in space, in units of f: exit pupil at 0, lens axis along z, sensor plane through
// o = (0, 0, m) spanned by u and v. The library has formulas for this; here lines are cut with planes.
//   d = (xd, yd, m),  s = (n . o) / (n . d),  w = s d - o,  pixel = (cx + f u . w, cy + aspect f v . w)
#pragma once

#include <ceres/jet.h>

#include "slope.hpp"

// What the checker must refuse; none in the real comparison.
enum class Wrong { none, tilt, distance, whitening };

template <class S>
struct Point {
  S x, y, z;
};

template <class S>
S dot(const Point<S>& a, const Point<S>& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
template <class S>
Point<S> cross(const Point<S>& a, const Point<S>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class S>
Point<S> operator+(const Point<S>& a, const Point<S>& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
template <class S>
Point<S> operator-(const Point<S>& a, const Point<S>& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
template <class S>
Point<S> operator*(const Point<S>& a, const S& k) { return {a.x * k, a.y * k, a.z * k}; }
template <class S, class T>
Point<S> lift(const Point<T>& p) {
  return {Lift<S, T>::from(p.x), Lift<S, T>::from(p.y), Lift<S, T>::from(p.z)};
}

template <class S>
struct Camera {
  S f, fv, cx, cy, m, k1, k2, k3;
  Point<S> u, v;
  bool distorted_to_ideal;

  // i: f, aspect, cx, cy, alpha, beta, k1, k2, k3, m.
  static Camera of(const S* i, bool distorted_to_ideal, Wrong wrong) {
    using std::cos;
    using std::sin;
    const S sa = sin(i[4]), ca = cos(i[4]), sb = sin(i[5]), cb = cos(i[5]);
    Camera c;
    c.f = i[0], c.fv = i[0] * i[1], c.cx = i[2], c.cy = i[3], c.m = i[9], c.k1 = i[6], c.k2 = i[7], c.k3 = i[8];
    c.u = {cb, S(0.0), sb};
    c.v = {-sa * sb, ca, sa * cb};
    // As misprinted in equation 7.
    if (wrong == Wrong::tilt) c.v.x = sa * cb;
    c.distorted_to_ideal = distorted_to_ideal;
    return c;
  }

  template <class U>
  Camera<U> lifted() const {
    const auto l = [](const S& x) { return Lift<U, S>::from(x); };
    return {l(f), l(fv), l(cx), l(cy), l(m), l(k1), l(k2), l(k3), lift<U>(u), lift<U>(v), distorted_to_ideal};
  }

  S gain(const S& s) const { return S(1.0) + s * (k1 + s * (k2 + s * k3)); }

  // Factor q with q g(q^2 s) = 1, by Newton's method carried out on S.
  S inverse_gain(const S& s) const {
    S q(1.0);
    for (int round = 0; round < 10; ++round) {
      const S w = q * q * s;
      const S slope = S(1.0) + w * (S(3.0) * k1 + w * (S(5.0) * k2 + w * (S(7.0) * k3)));
      q = q - (q * gain(w) - S(1.0)) / slope;
    }
    return q;
  }

  void project(const Point<S>& p, S* pixel) const {
    const S x = p.x / p.z, y = p.y / p.z, s = x * x + y * y;
    const S g = distorted_to_ideal ? inverse_gain(s) : gain(s);
    const Point<S> d{x * g, y * g, m}, o{S(0.0), S(0.0), m}, n = cross(u, v);
    const Point<S> w = d * (dot(n, o) / dot(n, d)) - o;
    pixel[0] = cx + f * dot(u, w);
    pixel[1] = cy + fv * dot(v, w);
  }
};

template <class T>
struct Pose {
  Point<T> x, y, z, t;  // columns of the rotation, translation

  Point<T> turned(const Point<T>& p) const { return x * p.x + y * p.y + z * p.z; }
  Point<T> operator()(const Point<T>& p) const { return turned(p) + t; }
  Pose operator*(const Pose& b) const { return {turned(b.x), turned(b.y), turned(b.z), (*this)(b.t)}; }

  // Unit quaternion (w, x, y, z) and translation.
  static Pose of(const T* q) {
    const T &a = q[0], &b = q[1], &c = q[2], &d = q[3];
    const T two(2.0);
    return {{a * a + b * b - c * c - d * d, two * (a * d + b * c), two * (b * d - a * c)},
            {two * (b * c - a * d), a * a - b * b + c * c - d * d, two * (a * b + c * d)},
            {two * (a * c + b * d), two * (c * d - a * b), a * a - b * b - c * c + d * d},
            {q[4], q[5], q[6]}};
  }
};
