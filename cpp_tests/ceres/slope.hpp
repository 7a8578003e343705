// A number with its derivative by one variable; T may itself be a ceres::Jet or a Slope.
#pragma once

template <class T>
struct Slope {
  T v, d;
  Slope() : v(0.0), d(0.0) {}
  explicit Slope(double x) : v(x), d(0.0) {}
  Slope(const T& value, const T& slope) : v(value), d(slope) {}
};

template <class T>
Slope<T> operator+(const Slope<T>& a, const Slope<T>& b) { return {a.v + b.v, a.d + b.d}; }
template <class T>
Slope<T> operator-(const Slope<T>& a, const Slope<T>& b) { return {a.v - b.v, a.d - b.d}; }
template <class T>
Slope<T> operator*(const Slope<T>& a, const Slope<T>& b) { return {a.v * b.v, a.d * b.v + a.v * b.d}; }
template <class T>
Slope<T> operator/(const Slope<T>& a, const Slope<T>& b) {
  const T q = a.v / b.v;
  return {q, (a.d - q * b.d) / b.v};
}

// A T as an S that does not depend on S's variable.
template <class S, class T>
struct Lift;
template <class T>
struct Lift<T, T> {
  static T from(const T& x) { return x; }
};
template <class U, class T>
struct Lift<Slope<U>, T> {
  static Slope<U> from(const T& x) { return {Lift<U, T>::from(x), U(0.0)}; }
};
template <class U>
struct Lift<Slope<U>, Slope<U>> {
  static Slope<U> from(const Slope<U>& x) { return x; }
};
