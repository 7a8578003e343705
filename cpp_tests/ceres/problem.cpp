#include "problem.hpp"

#include <fstream>
#include <stdexcept>

namespace {

class Reader {
 public:
  explicit Reader(const std::string& file) : in_(file), file_(file) {
    if (!in_) throw std::runtime_error(file + ": cannot be read");
  }
  template <class T>
  T one() {
    T x;
    if (!(in_ >> x)) throw std::runtime_error(file_ + ": ends early or is not a number");
    return x;
  }
  int count() { return one<int>(); }
  bool flag() { return one<int>() != 0; }
  // strtod reads what the stream would not (subnormals) and rounds correctly.
  double number() { return std::stod(one<std::string>()); }
  void word(const char* wanted) {
    const auto got = one<std::string>();
    if (got != wanted) throw std::runtime_error(file_ + ": " + got + " in place of " + wanted);
  }
  template <size_t N>
  std::array<double, N> some() {
    std::array<double, N> a;
    for (double& x : a) x = number();
    return a;
  }
  template <size_t N>
  std::array<bool, N> flags() {
    std::array<bool, N> a;
    for (bool& x : a) x = flag();
    return a;
  }
  Motion motion() {
    Motion m;
    for (int i = 0; i < 9; ++i) m.r(i / 3, i % 3) = number();
    for (int i = 0; i < 3; ++i) m.t(i) = number();
    return m;
  }

 private:
  std::ifstream in_;
  std::string file_;
};

void read_state(Reader& in, Problem& p) {
  Answer &a = p.start, &b = p.optimum;
  in.word("cameras");
  for (int n = in.count(); n > 0; --n) {
    in.word("camera");
    p.camera_names.push_back(in.one<std::string>());
    p.free.push_back(in.flags<10>());
    a.intrinsics.push_back(in.some<10>());
    b.intrinsics.push_back(in.some<10>());
  }
  in.word("motions");
  for (int n = in.count(); n > 0; --n) {
    a.cam_from_rig.push_back(in.motion());
    b.cam_from_rig.push_back(in.motion());
  }
  in.word("plane");
  if (in.flag()) {
    a.plane.push_back(in.motion());
    b.plane.push_back(in.motion());
  }
  in.word("target");
  p.target = in.one<std::string>();
  if (p.target == "lattice") {
    for (int n = in.count(); n > 0; --n) p.nodes.push_back(in.some<3>());
  }
  p.free_shape = in.flags<3>();
  a.shape = in.some<3>();
  b.shape = in.some<3>();
  in.word("offsets");
  const int offsets = in.count();
  p.offset_sigma = in.some<4>();
  for (int j = 0; j < offsets; ++j) a.offsets.push_back(in.some<4>());
  for (int j = 0; j < offsets; ++j) b.offsets.push_back(in.some<4>());
  for (int j = 0; j < offsets; ++j) p.offset_sigmas.push_back(in.some<4>());
  in.word("views");
  for (int n = in.count(); n > 0; --n) {
    p.in_plane.push_back(in.flag());
    p.z.push_back(in.number());
    a.rig_from_target.push_back(in.motion());
    a.own_shape.push_back(in.some<3>());
    b.rig_from_target.push_back(in.motion());
    b.own_shape.push_back(in.some<3>());
  }
}

Fact read_fact(Reader& in) {
  Fact f;
  f.kind = in.one<std::string>();
  if (f.kind == "intrinsic") f.camera = in.count();
  if (f.kind == "intrinsic" || f.kind == "shape") f.parameter = in.count();
  if (f.kind == "shape") f.view = in.count();
  if (f.kind == "focus") f.camera = in.count();
  f.value = in.number();
  f.sigma = in.number();
  if (f.kind == "focus") {
    f.distance = in.flag();
    f.focal_length = in.number();
    f.distance_sigma = in.number();
  }
  return f;
}

Image read_image(Reader& in) {
  Image image;
  image.view = in.count();
  image.camera = in.count();
  image.scale = in.number();
  const int discs = in.count(), pairs = in.count(), points = in.count();
  for (int k = 0; k < discs; ++k) {
    in.word("disc");
    Disc d;
    d.disc = in.count();
    for (int n = in.count(); n > 0; --n) d.edge.push_back(in.some<3>());
    image.discs.push_back(d);
  }
  for (int k = 0; k < pairs; ++k) {
    in.word("pair");
    Pair p;
    p.discs[0] = in.count();
    p.discs[1] = in.count();
    p.kept.resize(in.count());
    for (int& i : p.kept) i = in.count();
    p.pixels.resize(2 * p.kept.size());
    for (double& x : p.pixels) x = in.number();
    p.whitening.resize(in.count(), p.pixels.size());
    for (int i = 0; i < p.whitening.rows(); ++i)
      for (int j = 0; j < p.whitening.cols(); ++j) p.whitening(i, j) = in.number();
    if (in.flag()) {
      p.lens.resize(10);
      for (double& x : p.lens) x = in.number();
      p.by_lens.resize(p.pixels.size(), 10);
      for (int i = 0; i < p.by_lens.rows(); ++i)
        for (int j = 0; j < 10; ++j) p.by_lens(i, j) = in.number();
    }
    image.pairs.push_back(p);
  }
  for (int k = 0; k < points; ++k) {
    const int disc = in.count();
    const auto p = in.some<3>();
    image.points.push_back({disc, p[0], p[1], p[2]});
  }
  return image;
}

}  // namespace

Problem Problem::read(const std::string& file) {
  Reader in(file);
  Problem p;
  in.word("name");
  p.name = in.one<std::string>();
  in.word("radial");
  p.distorted_to_ideal = in.flag();
  in.word("loss");
  p.loss = in.one<std::string>();
  p.loss_scale = in.number();
  read_state(in, p);
  in.word("facts");
  for (int n = in.count(); n > 0; --n) p.facts.push_back(read_fact(in));
  in.word("images");
  for (int n = in.count(); n > 0; --n) p.images.push_back(read_image(in));
  in.word("optimum");
  p.cost = in.number();
  p.decrement = in.number();
  in.count();
  in.word("covariance");
  const int n = in.count();
  for (int i = 0; i < n; ++i) p.names.push_back(in.one<std::string>());
  p.covariance.resize(n, n);
  for (int i = 0; i < n * n; ++i) p.covariance(i / n, i % n) = in.number();
  return p;
}
