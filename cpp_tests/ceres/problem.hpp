// A problem as `examples/export_problem` writes it (format in its text.rs), with the library's answer.
#pragma once

#include <Eigen/Dense>
#include <array>
#include <string>
#include <vector>

struct Motion {
  Eigen::Matrix3d r;
  Eigen::Vector3d t;
};

// Everything that is adjusted, in natural frames.
struct Answer {
  std::vector<std::array<double, 10>> intrinsics;
  std::vector<Motion> cam_from_rig;  // of the second camera
  std::vector<Motion> plane;         // none or one
  std::array<double, 3> shape;
  std::vector<std::array<double, 4>> offsets;
  std::vector<Motion> rig_from_target;
  std::vector<std::array<double, 3>> own_shape;
};

struct Disc {
  int disc;
  std::vector<std::array<double, 3>> edge;  // u, v, sigma
};

struct Pair {
  int discs[2];
  std::vector<int> kept;
  Eigen::VectorXd pixels;
  Eigen::MatrixXd whitening;
  // Where features were found through a lens: its intrinsics, and how they follow another one (2 n x 10); else empty.
  Eigen::VectorXd lens;
  Eigen::MatrixXd by_lens;
};

// The image of a disc's centre.
struct PointSeen {
  int disc;
  double u, v, sigma;
};

struct Image {
  int view, camera;
  double scale;
  std::vector<Disc> discs;
  std::vector<Pair> pairs;
  std::vector<PointSeen> points;
};

struct Fact {
  std::string kind;
  int camera = -1, parameter = -1, view = -1;
  double value = 0, sigma = 1;              // focus: pitch, tilt sigma
  bool distance = false;
  double focal_length = 0, distance_sigma = 1;
};

struct Problem {
  std::string name, loss;
  bool distorted_to_ideal = false;
  double loss_scale = 0;
  std::vector<std::string> camera_names;
  std::vector<std::array<bool, 10>> free;
  std::string target;  // pair, bubbles, lattice
  std::vector<std::array<double, 3>> nodes;
  std::array<bool, 3> free_shape;
  std::array<double, 4> offset_sigma;
  std::vector<std::array<double, 4>> offset_sigmas;  // of the library's optimum
  std::vector<bool> in_plane;
  std::vector<double> z;
  std::vector<Fact> facts;
  std::vector<Image> images;
  Answer start, optimum;
  double cost = 0, decrement = 0;
  std::vector<std::string> names;
  Eigen::MatrixXd covariance;

  bool own_shapes() const { return target == "bubbles"; }
  static Problem read(const std::string& file);
};
