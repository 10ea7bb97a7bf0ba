// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"
#include "imu/propagate.hpp"

namespace heliograph {

namespace {

using Basis = Array<const double, nb::shape<3, 2>>;
using Doubles = Array<const double, nb::shape<-1>>;

Tuple propagate_state(const Stamps& stamps, const Vectors& gyro, const Vectors& accel, int64_t t0_ns, int64_t t1_ns,
                          const Matrix3& R, const Vectors& vectors, const Basis& g_basis, const Doubles& model) {
  if (stamps.size() == 0 || gyro.shape(0) != stamps.size() || accel.shape(0) != stamps.size())
    throw std::invalid_argument("one rate and one specific force a stamp are needed, and at least one");
  if (vectors.shape(0) != 5 || model.size() != 10) throw std::invalid_argument("state or model has the wrong length");
  if (t1_ns < t0_ns) throw std::invalid_argument("the interval runs backwards");
  const double* v = vectors.data();
  const NavState start{Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(R.data()),
                       Eigen::Vector3d(v), Eigen::Vector3d(v + 3), Eigen::Vector3d(v + 6), Eigen::Vector3d(v + 9),
                       Eigen::Vector3d(v + 12), Eigen::Map<const Eigen::Matrix<double, 3, 2, Eigen::RowMajor>>(g_basis.data())};
  const double* k = model.data();
  const ImuModel noise{k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], static_cast<int64_t>(k[8]),
                       static_cast<int64_t>(k[9])};
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
  return Tuple(nb::make_tuple(to_numpy<int64_t>(std::move(out.stamps_ns), {n}), to_numpy<double>(std::move(out.R), {n, 3, 3}),
                        to_numpy<double>(std::move(out.p), {n, 3}), to_numpy<double>(std::move(out.v), {n, 3}),
                        to_numpy<double>(std::move(transition), {kNavDim, kNavDim}),
                        to_numpy<double>(std::move(covariance), {kNavDim, kNavDim}), out.held_s));
}

}  // namespace

void bind_imu(nb::module_& m) {
  using namespace nb::literals;
  m.def("propagate", &propagate_state, "stamps_ns"_a.noconvert(), "gyro"_a.noconvert(), "accel"_a.noconvert(), "t0_ns"_a,
        "t1_ns"_a, "R_odom_imu"_a.noconvert(), "vectors"_a.noconvert(), "g_basis"_a.noconvert(), "model"_a.noconvert());
}

}  // namespace heliograph
