// The 14 points of the common tangents of two circles, as lines cut with lines (the library has closed forms).
// Line k: n . x = h with disc 0 on its negative side; external n . (c1 - c0) = r0 - r1, internal = r0 + r1; left first.
#pragma once

#include "camera.hpp"

template <class T>
struct Flat {
  T x, y;
};

template <class T>
void tangent_points(const Flat<T>& c0, const T& r0, const Flat<T>& c1, const T& r1, Flat<T>* points) {
  using std::sqrt;
  struct Line {
    T a, b, h;
  };
  const T dx = c1.x - c0.x, dy = c1.y - c0.y, square = dx * dx + dy * dy;
  Line lines[4];
  for (int k = 0; k < 4; ++k) {
    const double q = k < 2 ? 1.0 : -1.0, side = k % 2 == 0 ? 1.0 : -1.0;
    const T along = r0 - r1 * q;
    // n = (along d + side sqrt(|d|^2 - along^2) d_left) / |d|^2
    const T across = sqrt(square - along * along) * side;
    const T a = (along * dx - across * dy) / square, b = (along * dy + across * dx) / square;
    lines[k] = {a, b, a * c0.x + b * c0.y + r0};
    points[2 * k] = {c0.x + a * r0, c0.y + b * r0};
    points[2 * k + 1] = {c1.x + a * r1 * q, c1.y + b * r1 * q};
  }
  const int crossings[6][2] = {{0, 1}, {2, 3}, {0, 2}, {0, 3}, {1, 2}, {1, 3}};
  for (int k = 0; k < 6; ++k) {
    const Line &p = lines[crossings[k][0]], &q = lines[crossings[k][1]];
    const T det = p.a * q.b - p.b * q.a;
    points[8 + k] = {(p.h * q.b - p.b * q.h) / det, (p.a * q.h - p.h * q.a) / det};
  }
}
