// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"
#include "imu/motion_pack.hpp"
#include "imu/preintegrate.hpp"
#include "imu/propagate.hpp"

namespace heliograph {

namespace {

using Basis = Array<const double, nb::shape<3, 2>>;
using Doubles = Array<const double, nb::shape<-1>>;

Tuple propagate_state(const Stamps& stamps, const Vectors& gyro, const Vectors& accel, int64_t t0_ns, int64_t t1_ns,
                          const Matrix3& R, const Vectors& vectors, const Basis& g_basis, const Doubles& model) {
  if (stamps.size() == 0 || gyro.shape(0) != stamps.size() || accel.shape(0) != stamps.size())
    throw std::invalid_argument("one rate and one specific force a stamp are needed, and at least one");
  if (vectors.shape(0) != 5 || model.size() != kImuModelNumbers) throw std::invalid_argument("state or model has the wrong length");
  if (t1_ns < t0_ns) throw std::invalid_argument("the interval runs backwards");
  const double* v = vectors.data();
  const NavState start{Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R.data()),
                       Eigen::Vector3d(v), Eigen::Vector3d(v + 3), Eigen::Vector3d(v + 6), Eigen::Vector3d(v + 9),
                       Eigen::Vector3d(v + 12), Eigen::Map<const Eigen::Matrix<double, 3, 2, Eigen::RowMajor>>(g_basis.data())};
  const ImuModel noise = imu_model(model.data());
  Propagation out;
  {
    nb::gil_scoped_release release;
    out = propagate(start, {span_of(stamps), gyro.data(), accel.data()}, t0_ns, t1_ns, noise);
  }
  const size_t n = out.stamps_ns.size();
  std::vector<double> transition(static_cast<size_t>(kNavDim * kNavDim)), covariance(transition.size());
  using RowMajor = Eigen::Matrix<double, kNavDim, kNavDim, Eigen::RowMajor>;
  Eigen::Map<RowMajor>(transition.data()) = out.transition;
  Eigen::Map<RowMajor>(covariance.data()) = out.noise;
  static TupleType type{"Propagation", "stamps_ns R p v transition noise held_s"};
  return named(type, to_numpy<int64_t>(std::move(out.stamps_ns), {n}), to_numpy<double>(std::move(out.R), {n, 3, 3}),
               to_numpy<double>(std::move(out.p), {n, 3}), to_numpy<double>(std::move(out.v), {n, 3}),
               to_numpy<double>(std::move(transition), {kNavDim, kNavDim}),
               to_numpy<double>(std::move(covariance), {kNavDim, kNavDim}), out.held_s);
}

template <typename Derived>
void put(std::vector<double>& to, const Eigen::MatrixBase<Derived>& matrix) {
  for (Eigen::Index r = 0; r < matrix.rows(); ++r)
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) to.push_back(matrix(r, c));
}

// N intervals in one call. Rotations, positions, velocities, (seconds, of gravity, its integral, held), bias Jacobians,
// covariances, combined ones.
Tuple preintegrate_intervals(const Stamps& stamps, const Vectors& gyro, const Vectors& accel, const Stamps& starts_ns,
                             const Stamps& ends_ns, const Array<const double, nb::shape<-1, 6>>& biases, const Doubles& model) {
  const size_t n = starts_ns.size();
  if (stamps.size() == 0 || gyro.shape(0) != stamps.size() || accel.shape(0) != stamps.size())
    throw std::invalid_argument("one rate and one specific force a stamp are needed, and at least one");
  if (ends_ns.size() != n || biases.shape(0) != n || model.size() != kImuModelNumbers)
    throw std::invalid_argument("intervals, biases or model have the wrong length");
  std::vector<double> R, p, v, times, by_bias, covariance, combined;
  const auto integrate_all = [&] {
    for (auto [part, size] : {std::pair{&R, 9}, {&p, 3}, {&v, 3}, {&times, 4}, {&by_bias, 54}, {&covariance, 81}, {&combined, 225}})
      part->reserve(n * static_cast<size_t>(size));
    const ImuSamples samples{span_of(stamps), gyro.data(), accel.data()};
    const ImuModel noise = imu_model(model.data());
    for (size_t i = 0; i < n; ++i) {
      const double* b = biases.data() + 6 * i;
      const Preintegrated out = preintegrate(samples, starts_ns.data()[i], ends_ns.data()[i],
                                             {Eigen::Vector3d(b), Eigen::Vector3d(b + 3)}, noise);
      put(R, out.delta.R);
      put(p, out.delta.p);
      put(v, out.delta.v);
      times.insert(times.end(), {out.delta.duration_s, out.delta.gravity_s, out.delta.gravity_s2, out.delta.held_s});
      put(by_bias, out.delta.by_bias);
      put(covariance, out.covariance);
      put(combined, out.combined);
    }
  };
  unlocked(integrate_all);
  static TupleType type{"Preintegrated", "R p v times by_bias covariance combined"};
  return named(type, to_numpy<double>(std::move(R), {n, 3, 3}), to_numpy<double>(std::move(p), {n, 3}),
               to_numpy<double>(std::move(v), {n, 3}), to_numpy<double>(std::move(times), {n, 4}),
               to_numpy<double>(std::move(by_bias), {n, 9, 6}), to_numpy<double>(std::move(covariance), {n, 9, 9}),
               to_numpy<double>(std::move(combined), {n, 15, 15}));
}

using Column = Array<const double, nb::shape<-1>>;

// The measurements (N, m) of the factors of N motions, and whether all numbers are finite.
Tuple motion_measurements(const Stamps& stamps, const Vectors& gyro, const Vectors& accel, const Stamps& starts_ns, const Stamps& ends_ns,
                          const Rotations& R, const Vectors& p, const Vectors& v, const Column& duration, const Column& gravity_s,
                          const Column& gravity_s2, const Vectors& gyro_bias, const Vectors& accel_bias,
                          const Array<const double, nb::shape<-1, 9, 6>>& by_bias, const Array<const double, nb::shape<-1, 9, 9>>& covariance,
                          const Doubles& model, const Doubles& gravity, double share, bool keep_samples) {
  const size_t n = starts_ns.size();
  for (const size_t size : {ends_ns.size(), R.shape(0), p.shape(0), v.shape(0), duration.size(), gravity_s.size(), gravity_s2.size(),
                            gyro_bias.shape(0), accel_bias.shape(0), by_bias.shape(0), covariance.shape(0)})
    if (size != n) throw std::invalid_argument("one of everything a motion is needed");
  if (stamps.size() == 0 || gyro.shape(0) != stamps.size() || accel.shape(0) != stamps.size() || model.size() != kImuModelNumbers)
    throw std::invalid_argument("one rate and one specific force a stamp are needed, at least one, and the model's numbers");
  const ImuSamples samples{span_of(stamps), gyro.data(), accel.data()};
  const MotionArrays motions{n, starts_ns.data(), ends_ns.data(), R.data(), p.data(), v.data(),
                             {duration.data(), gravity_s.data(), gravity_s2.data()}, gyro_bias.data(), accel_bias.data(),
                             by_bias.data(), covariance.data(), model.data()};
  const size_t rows = keep_samples ? sample_rows(samples, motions) : 0;
  const size_t width = MotionRow::kSize + gravity.size() + kSampleNumbers * rows;
  std::vector<double> out(n * width);
  const bool finite = unlocked([&] { return pack_motions(samples, motions, span_of(gravity), share, rows, out.data()); });
  static TupleType type{"MotionMeasurements", "measurement finite"};
  return named(type, to_numpy<double>(std::move(out), {n, width}), finite);
}

// States (N, 5, 5) at the ends of motions that begin at X, with biases changed by `change` from the motions' own.
nb::ndarray<nb::numpy, double, nb::ndim<3>> predict_states(const Rotations& R, const Vectors& p, const Vectors& v, const Column& duration,
                                                           const Column& gravity_s, const Column& gravity_s2,
                                                           const Array<const double, nb::shape<-1, 9, 6>>& by_bias,
                                                           const Array<const double, nb::shape<-1, 6>>& change,
                                                           const Array<const double, nb::shape<-1, 5, 5>>& X, const Vectors& gravity) {
  const size_t n = R.shape(0);
  for (const size_t size : {p.shape(0), v.shape(0), duration.size(), gravity_s.size(), gravity_s2.size(), by_bias.shape(0),
                            change.shape(0), X.shape(0), gravity.shape(0)})
    if (size != n) throw std::invalid_argument("one of everything a motion is needed");
  std::vector<double> out(25 * n);
  for (size_t k = 0; k < n; ++k) {
    const double* times[3] = {duration.data() + k, gravity_s.data() + k, gravity_s2.data() + k};
    predict_state(R.data() + 9 * k, p.data() + 3 * k, v.data() + 3 * k, times, by_bias.data() + 54 * k, change.data() + 6 * k,
                  X.data() + 25 * k, gravity.data() + 3 * k, out.data() + 25 * k);
  }
  return to_numpy<double, nb::ndim<3>>(std::move(out), {n, 5, 5});
}

}  // namespace

void bind_imu(nb::module_& m) {
  using namespace nb::literals;
  m.def("predict_states", &predict_states, "R"_a.noconvert(), "p"_a.noconvert(), "v"_a.noconvert(), "duration"_a.noconvert(),
        "gravity_s"_a.noconvert(), "gravity_s2"_a.noconvert(), "by_bias"_a.noconvert(), "change"_a.noconvert(), "X"_a.noconvert(),
        "gravity"_a.noconvert());
  m.def("motion_measurements", &motion_measurements, "stamps_ns"_a.noconvert(), "gyro"_a.noconvert(), "accel"_a.noconvert(),
        "starts_ns"_a.noconvert(), "ends_ns"_a.noconvert(), "R"_a.noconvert(), "p"_a.noconvert(), "v"_a.noconvert(),
        "duration"_a.noconvert(), "gravity_s"_a.noconvert(), "gravity_s2"_a.noconvert(), "gyro_bias"_a.noconvert(),
        "accel_bias"_a.noconvert(), "by_bias"_a.noconvert(), "covariance"_a.noconvert(), "model"_a.noconvert(),
        "gravity"_a.noconvert(), "share"_a, "keep_samples"_a);
  m.def("propagate", &propagate_state, "stamps_ns"_a.noconvert(), "gyro"_a.noconvert(), "accel"_a.noconvert(), "t0_ns"_a,
        "t1_ns"_a, "R_odom_imu"_a.noconvert(), "vectors"_a.noconvert(), "g_basis"_a.noconvert(), "model"_a.noconvert());
  m.def("preintegrate", &preintegrate_intervals, "stamps_ns"_a.noconvert(), "gyro"_a.noconvert(), "accel"_a.noconvert(),
        "starts_ns"_a.noconvert(), "ends_ns"_a.noconvert(), "biases"_a.noconvert(), "model"_a.noconvert());
}

}  // namespace heliograph
