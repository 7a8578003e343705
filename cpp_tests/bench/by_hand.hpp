// Residuals of one image with derivatives written by hand: what a user of Ceres arrives at who wants speed. No Ceres and no
// Eigen here, so that this part alone may be compiled for the machine's own instructions.
#pragma once

#include <array>
#include <vector>

namespace by_hand {

// Derivatives of an image are by: intrinsics, turn and shift of the target in the camera frame, lengths of the target.
constexpr int kLocal = 10 + 6 + 3;

// x_in_a = r x_in_b + t, r by rows.
struct Motion {
  std::array<double, 9> r;
  std::array<double, 3> t;
  // Unit quaternion w x y z and shift.
  static Motion of(const double* q);
  Motion operator*(const Motion& b) const;
};

struct Contour {
  std::array<double, 3> node;  // centre and radius are (node[0] s0, node[1] s0, node[2] s2), s1; pair: see `pair`
  int pair;                    // 0 or 1: disc of a pair, (0 or s0, 0, 0), s1 or s2; -1: of a lattice
  std::vector<double> u, v, sigma;
  std::vector<double> phi;     // the last feet: the next ones are not far
};

struct Tangents {
  std::vector<int> kept;
  std::vector<double> pixels, whitening;  // u v u v ...; rank x 2 kept by rows
  int rank;
};

// Images of the points (node[0] s0, node[1] s0, -node[2] s2).
struct Points {
  std::vector<std::array<double, 3>> node;
  std::vector<double> u, v, sigma;
};

struct Image {
  std::vector<Contour> contours;
  std::vector<Tangents> tangents;
  Points points;
  int residuals() const;
};

// Residuals, and where `jacobian` is given their derivatives (residuals x kLocal, by rows). False where there is no image.
bool evaluate(Image& image, const double* intrinsics, const Motion& cam_from_target, const double* shape,
              double* residuals, double* jacobian);

// One point (u, v, sigma) of the place `in_target`: residuals[2], and where they are given jacobian[2 x 16] by intrinsics, turn and shift
// of the target in the camera frame, and by_place[2 x 3].
bool evaluate_point(const double* intrinsics, const Motion& cam_from_target, const double* in_target, const double* seen,
                    double* residuals, double* jacobian, double* by_place);

}  // namespace by_hand
