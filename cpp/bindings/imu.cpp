// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"
#include "imu/motion_factor.hpp"
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

// Residuals, and with derivatives those by both poses, the bias and gravity.
Tuple motion_residuals(const Array<const double, nb::shape<-1, 5, 5>>& X_i, const Array<const double, nb::shape<-1, 5, 5>>& X_j,
                       const Array<const double, nb::shape<-1, 6>>& bias, const Vectors& gravity,
                       const Array<const double, nb::shape<-1, static_cast<nb::ssize_t>(MotionRow::kSize)>>& motion,
                       const Array<const double, nb::shape<-1, -1, static_cast<nb::ssize_t>(kSampleNumbers)>>& sampled,
                       bool jacobians) {
  const size_t n = motion.shape(0), samples = sampled.shape(1);
  if (X_i.shape(0) != n || X_j.shape(0) != n || bias.shape(0) != n || gravity.shape(0) != n || sampled.shape(0) != n)
    throw std::invalid_argument("one of everything a motion is needed");
  const double* rows = motion.data();
  for (size_t k = 0; k < n && samples > 0; ++k)
    if (const double kept = rows[MotionRow::kSize * k + MotionRow::kCount]; !(kept >= 1.0 && kept <= static_cast<double>(samples)))
      throw std::invalid_argument("a motion counts more samples than it has");
  std::vector<double> r(9 * n), by_i, by_j, by_bias, by_gravity;
  const MotionFactors factors{n, samples, X_i.data(), X_j.data(), bias.data(), gravity.data(), rows, sampled.data()};
  unlocked([&] {
    MotionJacobians out;
    if (jacobians) {
      by_i.resize(81 * n), by_j.resize(81 * n), by_bias.resize(54 * n), by_gravity.resize(27 * n);
      out = {by_i.data(), by_j.data(), by_bias.data(), by_gravity.data()};
    }
    evaluate_motions(factors, r.data(), out);
  });
  static TupleType type{"MotionResiduals", "residual by_i by_j by_bias by_gravity"};
  auto residual = to_numpy<double>(std::move(r), {n, 9});
  if (!jacobians) return named(type, residual, nb::none(), nb::none(), nb::none(), nb::none());
  return named(type, residual, to_numpy<double>(std::move(by_i), {n, 9, 9}), to_numpy<double>(std::move(by_j), {n, 9, 9}),
               to_numpy<double>(std::move(by_bias), {n, 9, 6}), to_numpy<double>(std::move(by_gravity), {n, 9, 3}));
}

}  // namespace

void bind_imu(nb::module_& m) {
  using namespace nb::literals;
  m.def("propagate", &propagate_state, "stamps_ns"_a.noconvert(), "gyro"_a.noconvert(), "accel"_a.noconvert(), "t0_ns"_a,
        "t1_ns"_a, "R_odom_imu"_a.noconvert(), "vectors"_a.noconvert(), "g_basis"_a.noconvert(), "model"_a.noconvert());
  m.def("preintegrate", &preintegrate_intervals, "stamps_ns"_a.noconvert(), "gyro"_a.noconvert(), "accel"_a.noconvert(),
        "starts_ns"_a.noconvert(), "ends_ns"_a.noconvert(), "biases"_a.noconvert(), "model"_a.noconvert());
  m.def("motion_residuals", &motion_residuals, "X_i"_a.noconvert(), "X_j"_a.noconvert(), "bias"_a.noconvert(),
        "gravity"_a.noconvert(), "motion"_a.noconvert(), "sampled"_a.noconvert(), "jacobians"_a);
}

}  // namespace heliograph
