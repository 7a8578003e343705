#include "by_hand.hpp"

#include <cmath>

namespace by_hand {

namespace {

struct Camera {
  double f, fv, aspect, cx, cy, k1, k2, k3, m, sa, ca, ta, sb, cb, tb;

  explicit Camera(const double* i)
      : f(i[0]), fv(i[0] * i[1]), aspect(i[1]), cx(i[2]), cy(i[3]), k1(i[6]), k2(i[7]), k3(i[8]), m(i[9]),
        sa(std::sin(i[4])), ca(std::cos(i[4])), ta(sa / ca), sb(std::sin(i[5])), cb(std::cos(i[5])), tb(sb / cb) {}
};

struct Projected {
  double u, v, iz, x, y, s, gain, slope, xd, yd, ih, tx, ty;

  bool of(const Camera& c, const double* p) {
    if (!(p[2] > 0.0)) return false;
    iz = 1.0 / p[2], x = p[0] * iz, y = p[1] * iz, s = x * x + y * y;
    gain = 1.0 + s * (c.k1 + s * (c.k2 + s * c.k3));
    slope = c.k1 + s * (2.0 * c.k2 + s * 3.0 * c.k3);
    xd = x * gain, yd = y * gain;
    const double h = 1.0 - (xd * c.tb + yd * c.ta / c.cb) / c.m;
    if (!(h > 0.0)) return false;
    ih = 1.0 / h;
    tx = (xd / c.cb + yd * c.ta * c.tb) * ih, ty = yd / c.ca * ih;
    u = c.cx + c.f * tx, v = c.cy + c.fv * ty;
    return true;
  }

  // Movement of the image for a movement of the point.
  void along(const Camera& c, const double* d, double* q) const {
    const double dx = (d[0] - x * d[2]) * iz, dy = (d[1] - y * d[2]) * iz;
    const double dgain = slope * 2.0 * (x * dx + y * dy);
    const double dxd = dx * gain + x * dgain, dyd = dy * gain + y * dgain;
    const double dh = -(dxd * c.tb + dyd * c.ta / c.cb) / c.m;
    q[0] = c.f * (dxd / c.cb + dyd * c.ta * c.tb - tx * dh) * ih;
    q[1] = c.fv * (dyd / c.ca - ty * dh) * ih;
  }

  // Derivative of n . pixel by the point and by the intrinsics.
  void derivative(const Camera& c, double nu, double nv, double* g, double* i) const {
    const double eu = c.f * nu * ih, ev = c.fv * nv * ih, h = -(tx * eu + ty * ev);
    const double bxd = eu / c.cb - h * c.tb / c.m, byd = eu * c.ta * c.tb + ev / c.ca - h * c.ta / (c.cb * c.m);
    const double w = x * bxd + y * byd, bent = 2.0 * slope * w;
    const double bx = gain * bxd + bent * x, by = gain * byd + bent * y;
    g[0] = bx * iz, g[1] = by * iz, g[2] = -(x * bx + y * by) * iz;
    const double ca2 = c.ca * c.ca, cb2 = c.cb * c.cb;
    i[0] = nu * tx + nv * c.aspect * ty, i[1] = nv * c.f * ty, i[2] = nu, i[3] = nv;
    i[4] = yd * (eu * c.tb / ca2 + ev * c.sa / ca2 - h / (ca2 * c.cb * c.m));
    i[5] = eu * (xd * c.sb + yd * c.ta) / cb2 - h * (xd + yd * c.ta * c.sb) / (cb2 * c.m);
    i[6] = s * w, i[7] = s * i[6], i[8] = s * i[7];
    i[9] = h * (xd * c.tb + yd * c.ta / c.cb) / (c.m * c.m);
  }
};

// Turn, shift and lengths behind the intrinsics: centre and radius move by `by[k]` (x, y, z, r) with length k; `outwards` is the
// derivative by the radius.
void behind_intrinsics(const double* p, const double* g, const Motion& m, const double (*by)[4], double outwards,
                       double* row) {
  row[10] = p[1] * g[2] - p[2] * g[1], row[11] = p[2] * g[0] - p[0] * g[2], row[12] = p[0] * g[1] - p[1] * g[0];
  for (int k = 0; k < 3; ++k) row[13 + k] = g[k];
  double in_target[3];
  for (int k = 0; k < 3; ++k) in_target[k] = g[0] * m.r[k] + g[1] * m.r[3 + k] + g[2] * m.r[6 + k];
  for (int k = 0; k < 3; ++k)
    row[16 + k] =
        in_target[0] * by[k][0] + in_target[1] * by[k][1] + in_target[2] * by[k][2] + outwards * by[k][3];
}

bool contour(Contour& seen, const Camera& c, const Motion& m, const double* shape, double* r, double* jacobian) {
  double center[3], radius, by[3][4] = {};
  if (seen.pair < 0) {
    center[0] = seen.node[0] * shape[0], center[1] = seen.node[1] * shape[0], center[2] = -seen.node[2] * shape[2];
    radius = shape[1];
    by[0][0] = seen.node[0], by[0][1] = seen.node[1], by[2][2] = -seen.node[2], by[1][3] = 1.0;
  } else {
    center[0] = seen.pair == 0 ? 0.0 : shape[0], center[1] = center[2] = 0.0;
    radius = shape[1 + seen.pair];
    if (seen.pair == 1) by[0][0] = 1.0;
    by[1 + seen.pair][3] = 1.0;
  }
  double o[3], ex[3], ey[3];
  for (int k = 0; k < 3; ++k) {
    const double* row = &m.r[3 * k];
    o[k] = row[0] * center[0] + row[1] * center[1] + row[2] * center[2] + m.t[k];
    ex[k] = row[0], ey[k] = row[1];
  }
  Projected middle, at;
  if (!middle.of(c, o)) return false;
  const bool known = !seen.phi.empty();
  double a[2], b[2];
  if (!known) {
    seen.phi.resize(seen.u.size());
    middle.along(c, ex, a);
    middle.along(c, ey, b);
  }
  for (size_t i = 0; i < seen.u.size(); ++i) {
    if (!known) {
      const double x = seen.u[i] - middle.u, y = seen.v[i] - middle.v;
      const double det = a[0] * b[1] - a[1] * b[0];
      seen.phi[i] = std::atan2((a[0] * y - a[1] * x) / det, (b[1] * x - b[0] * y) / det);
    }
    double p[3], radial[3], turned[3], q[2], gap[2], speed = 0.0;
    for (int round = 0; round < 12; ++round) {
      const double co = std::cos(seen.phi[i]), si = std::sin(seen.phi[i]);
      for (int k = 0; k < 3; ++k) {
        radial[k] = ex[k] * co + ey[k] * si;
        turned[k] = (ey[k] * co - ex[k] * si) * radius;
        p[k] = o[k] + radius * radial[k];
      }
      if (!at.of(c, p)) return false;
      at.along(c, turned, q);
      gap[0] = seen.u[i] - at.u, gap[1] = seen.v[i] - at.v;
      speed = q[0] * q[0] + q[1] * q[1];
      const double along = gap[0] * q[0] + gap[1] * q[1];
      if (along * along <= 1e-14 * speed) break;
      const double curvature = gap[0] * (middle.u - at.u) + gap[1] * (middle.v - at.v);
      seen.phi[i] += std::fmax(-0.7, std::fmin(0.7, along / std::fmax(speed - curvature, 0.3 * speed)));
    }
    const double length = std::sqrt(speed);
    double n[2] = {q[1] / length, -q[0] / length};
    if (n[0] * (at.u - middle.u) + n[1] * (at.v - middle.v) < 0.0) n[0] = -n[0], n[1] = -n[1];
    const double iw = 1.0 / seen.sigma[i];
    r[i] = (n[0] * gap[0] + n[1] * gap[1]) * iw;
    if (jacobian) {
      double g[3], *row = jacobian + kLocal * i;
      at.derivative(c, -n[0] * iw, -n[1] * iw, g, row);
      behind_intrinsics(p, g, m, by, g[0] * radial[0] + g[1] * radial[1] + g[2] * radial[2], row);
    }
  }
  return true;
}

// A number with its derivatives by the three lengths.
struct Jet {
  double v, d[3];
};
Jet operator+(const Jet& a, const Jet& b) { return {a.v + b.v, {a.d[0] + b.d[0], a.d[1] + b.d[1], a.d[2] + b.d[2]}}; }
Jet operator-(const Jet& a, const Jet& b) { return {a.v - b.v, {a.d[0] - b.d[0], a.d[1] - b.d[1], a.d[2] - b.d[2]}}; }
Jet operator*(const Jet& a, const Jet& b) {
  Jet c{a.v * b.v, {}};
  for (int k = 0; k < 3; ++k) c.d[k] = a.d[k] * b.v + a.v * b.d[k];
  return c;
}
Jet operator/(const Jet& a, const Jet& b) {
  const double i = 1.0 / b.v;
  Jet c{a.v * i, {}};
  for (int k = 0; k < 3; ++k) c.d[k] = (a.d[k] - c.v * b.d[k]) * i;
  return c;
}
Jet root(const Jet& a) {
  const double s = std::sqrt(a.v), i = 0.5 / s;
  return {s, {a.d[0] * i, a.d[1] * i, a.d[2] * i}};
}

// Tangent points of the circles (0, 0), s1 and (s0, 0), s2: touching points and crossings of the four common tangents.
void tangent_points(const double* shape, Jet (*points)[2]) {
  const Jet l{shape[0], {1, 0, 0}}, r0{shape[1], {0, 1, 0}}, r1{shape[2], {0, 0, 1}}, one{1.0, {}}, zero{0.0, {}};
  Jet n[4][2];
  for (int k = 0; k < 4; ++k) {
    const Jet q{k < 2 ? 1.0 : -1.0, {}}, side{k % 2 == 0 ? 1.0 : -1.0, {}};
    const Jet c = (r0 - q * r1) / l;
    n[k][0] = c, n[k][1] = side * root((one - c) * (one + c));
    for (int i = 0; i < 2; ++i) {
      points[2 * k][i] = n[k][i] * r0;
      points[2 * k + 1][i] = (i == 0 ? l : zero) + q * r1 * n[k][i];
    }
  }
  const int crossings[6][2] = {{0, 1}, {2, 3}, {0, 2}, {0, 3}, {1, 2}, {1, 3}};
  for (int k = 0; k < 6; ++k) {
    const Jet *a = n[crossings[k][0]], *b = n[crossings[k][1]];
    const Jet w = r0 / (one + a[0] * b[0] + a[1] * b[1]);
    for (int i = 0; i < 2; ++i) points[8 + k][i] = (a[i] + b[i]) * w;
  }
}

bool tangents(const Tangents& seen, const Camera& c, const Motion& m, const double* shape, double* r,
              double* jacobian) {
  Jet points[14][2];
  tangent_points(shape, points);
  const int n = static_cast<int>(seen.kept.size());
  double gap[28], rows[28][kLocal];
  for (int k = 0; k < n; ++k) {
    const Jet* point = points[seen.kept[k]];
    double p[3];
    for (int i = 0; i < 3; ++i) p[i] = m.r[3 * i] * point[0].v + m.r[3 * i + 1] * point[1].v + m.t[i];
    Projected at;
    if (!at.of(c, p)) return false;
    gap[2 * k] = seen.pixels[2 * k] - at.u, gap[2 * k + 1] = seen.pixels[2 * k + 1] - at.v;
    if (!jacobian) continue;
    double by[3][4];
    for (int s = 0; s < 3; ++s) by[s][0] = point[0].d[s], by[s][1] = point[1].d[s], by[s][2] = by[s][3] = 0.0;
    for (int s = 0; s < 2; ++s) {
      double g[3];
      at.derivative(c, s == 0 ? -1.0 : 0.0, s == 1 ? -1.0 : 0.0, g, rows[2 * k + s]);
      behind_intrinsics(p, g, m, by, 0.0, rows[2 * k + s]);
    }
  }
  for (int i = 0; i < seen.rank; ++i) {
    const double* w = &seen.whitening[2 * n * i];
    r[i] = 0.0;
    for (int j = 0; j < 2 * n; ++j) r[i] += w[j] * gap[j];
    if (!jacobian) continue;
    double* row = jacobian + kLocal * i;
    for (int k = 0; k < kLocal; ++k) row[k] = 0.0;
    for (int j = 0; j < 2 * n; ++j)
      for (int k = 0; k < kLocal; ++k) row[k] += w[j] * rows[j][k];
  }
  return true;
}

bool points(const Points& seen, const Camera& c, const Motion& m, const double* shape, double* r, double* jacobian) {
  for (size_t i = 0; i < seen.u.size(); ++i) {
    const auto& n = seen.node[i];
    const double by[3][4] = {{n[0], n[1], 0.0, 0.0}, {}, {0.0, 0.0, -n[2], 0.0}};
    const double x[3] = {n[0] * shape[0], n[1] * shape[0], -n[2] * shape[2]};
    double p[3];
    for (int k = 0; k < 3; ++k) p[k] = m.r[3 * k] * x[0] + m.r[3 * k + 1] * x[1] + m.r[3 * k + 2] * x[2] + m.t[k];
    Projected at;
    if (!at.of(c, p)) return false;
    const double iw = 1.0 / seen.sigma[i];
    r[2 * i] = (seen.u[i] - at.u) * iw, r[2 * i + 1] = (seen.v[i] - at.v) * iw;
    if (!jacobian) continue;
    for (int s = 0; s < 2; ++s) {
      double g[3], *row = jacobian + kLocal * (2 * i + s);
      at.derivative(c, s == 0 ? -iw : 0.0, s == 1 ? -iw : 0.0, g, row);
      behind_intrinsics(p, g, m, by, 0.0, row);
    }
  }
  return true;
}

}  // namespace

bool evaluate_point(const double* intrinsics, const Motion& m, const double* x, const double* seen, double* r,
                    double* jacobian, double* by_place) {
  const Camera c(intrinsics);
  double p[3];
  for (int k = 0; k < 3; ++k) p[k] = m.r[3 * k] * x[0] + m.r[3 * k + 1] * x[1] + m.r[3 * k + 2] * x[2] + m.t[k];
  Projected at;
  if (!at.of(c, p)) return false;
  const double iw = 1.0 / seen[2];
  r[0] = (seen[0] - at.u) * iw, r[1] = (seen[1] - at.v) * iw;
  if (!jacobian) return true;
  for (int s = 0; s < 2; ++s) {
    double g[3], *row = jacobian + 16 * s;
    at.derivative(c, s == 0 ? -iw : 0.0, s == 1 ? -iw : 0.0, g, row);
    row[10] = p[1] * g[2] - p[2] * g[1], row[11] = p[2] * g[0] - p[0] * g[2], row[12] = p[0] * g[1] - p[1] * g[0];
    for (int k = 0; k < 3; ++k) {
      row[13 + k] = g[k];
      by_place[3 * s + k] = g[0] * m.r[k] + g[1] * m.r[3 + k] + g[2] * m.r[6 + k];
    }
  }
  return true;
}

Motion Motion::of(const double* q) {
  const double a = q[0], b = q[1], c = q[2], d = q[3];
  return {{a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (a * c + b * d),
           2 * (a * d + b * c), a * a - b * b + c * c - d * d, 2 * (c * d - a * b),
           2 * (b * d - a * c), 2 * (a * b + c * d), a * a - b * b - c * c + d * d},
          {q[4], q[5], q[6]}};
}

Motion Motion::operator*(const Motion& b) const {
  Motion out{};
  for (int i = 0; i < 3; ++i) {
    out.t[i] = t[i];
    for (int k = 0; k < 3; ++k) {
      out.t[i] += r[3 * i + k] * b.t[k];
      for (int j = 0; j < 3; ++j) out.r[3 * i + j] += r[3 * i + k] * b.r[3 * k + j];
    }
  }
  return out;
}

int Image::residuals() const {
  int n = 0;
  for (const Contour& c : contours) n += static_cast<int>(c.u.size());
  for (const Tangents& t : tangents) n += t.rank;
  return n + 2 * static_cast<int>(points.u.size());
}

bool evaluate(Image& image, const double* intrinsics, const Motion& cam_from_target, const double* shape,
              double* residuals, double* jacobian) {
  const Camera camera(intrinsics);
  const auto next = [&](int n) {
    residuals += n;
    if (jacobian) jacobian += kLocal * n;
  };
  for (Contour& c : image.contours) {
    if (!contour(c, camera, cam_from_target, shape, residuals, jacobian)) return false;
    next(static_cast<int>(c.u.size()));
  }
  for (const Tangents& t : image.tangents) {
    if (!tangents(t, camera, cam_from_target, shape, residuals, jacobian)) return false;
    next(t.rank);
  }
  return points(image.points, camera, cam_from_target, shape, residuals, jacobian);
}

}  // namespace by_hand
