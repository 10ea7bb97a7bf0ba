// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"
#include "registration/point_to_plane.hpp"

namespace heliograph {

namespace {

Tuple to_tuple(const NormalEquations& sums, const MatchBlocks& blocks) {
  const auto n = static_cast<size_t>(blocks.columns());
  std::vector<double> information(sums.information, sums.information + n * n);
  std::vector<double> gradient(sums.gradient, sums.gradient + n);
  std::vector<double> feigned(sums.feigned, sums.feigned + n * n);
  static TupleType type{
      "MatchSums",
      "information gradient feigned feigned_square weight robust_weight square cost matches fallback_matches"};
  return named(type, to_numpy<double>(std::move(information), {n, n}), to_numpy<double>(std::move(gradient), {n}),
               to_numpy<double>(std::move(feigned), {n, n}), sums.feigned_square, sums.weight, sums.robust_weight, sums.square, sums.cost, sums.matches, sums.fallback_matches);
}

void check(const MatchSettings& s) {
  if (!(s.sigma > 0.0) || s.fallback_stride < 0) throw std::invalid_argument("sigma and fallback_stride must be positive");
}

MatchSettings settings(double gate, double kernel, double sigma, int stride, double range, MatchBlocks blocks) {
  const MatchSettings s{gate, kernel, sigma, stride, range, blocks};
  check(s);
  return s;
}

MatchScan match_scan(const Points& points, const Floats& before_end, const Matrix4& T_odom_body, const Matrix4& T_body_lidar,
                     const Matrix4& T_odom_body_first, const MatchBlocks& blocks) {
  if (blocks.motion && before_end.size() != points.shape(0))
    throw std::invalid_argument("the motion needs before_end, one time a point");
  return {span_of(points), span_of(before_end), T_odom_body.data(), T_body_lidar.data(), T_odom_body_first.data()};
}

Tuple planes(const VoxelMap& map, const Points& points, const Floats& before_end, const Matrix4& T_odom_body,
             const Matrix4& T_body_lidar, const Matrix4& T_odom_body_first, double gate, double kernel, double sigma,
             int fallback_stride, double fallback_range, bool motion, bool mounting, int threads) {
  const MatchSettings s = settings(gate, kernel, sigma, fallback_stride, fallback_range, {motion, mounting});
  const MatchScan scan = match_scan(points, before_end, T_odom_body, T_body_lidar, T_odom_body_first, s.blocks);
  return to_tuple(unlocked([&] { return match_planes(map, scan, s, threads); }), s.blocks);
}

Tuple nearest_points(const VoxelMap& map, const Points& points, const Floats& before_end, const Matrix4& T_odom_body,
                     const Matrix4& T_body_lidar, const Matrix4& T_odom_body_first, double gate, double kernel,
                     double sigma, bool motion, bool mounting, int threads) {
  const MatchSettings s = settings(gate, kernel, sigma, 0, gate, {motion, mounting});
  const MatchScan scan = match_scan(points, before_end, T_odom_body, T_body_lidar, T_odom_body_first, s.blocks);
  return to_tuple(unlocked([&] { return match_points(map, scan, s, threads); }), s.blocks);
}

Tuple query(const VoxelMap& map, const Vectors& points, double gate, int fallback_stride, double fallback_range) {
  const size_t n = points.shape(0);
  std::vector<float> normal(3 * n), variance(n), tilt(n), scatter(n), since(n);
  std::vector<double> point(3 * n);
  std::vector<uint8_t> source(n);
  {
    nb::gil_scoped_release release;
    query_planes(map, span_of(points), settings(gate, 0.0, 1.0, fallback_stride, fallback_range, {false, false}),
                 {normal.data(), point.data(), variance.data(), tilt.data(), scatter.data(), since.data(), source.data()});
  }
  static TupleType type{"Planes", "normal point variance tilt scatter since source"};
  return named(type, to_numpy<float>(std::move(normal), {n, 3}), to_numpy<double>(std::move(point), {n, 3}),
               to_numpy<float>(std::move(variance), {n}), to_numpy<float>(std::move(tilt), {n}),
               to_numpy<float>(std::move(scatter), {n}), to_numpy<float>(std::move(since), {n}), to_numpy<uint8_t>(std::move(source), {n}));
}

}  // namespace

void bind_registration(nb::module_& m) {
  using namespace nb::literals;
  m.def("match_planes", &planes, "map"_a, "points_body"_a.noconvert(), "before_end"_a.noconvert(),
        "T_odom_body"_a.noconvert(), "T_body_lidar"_a.noconvert(), "T_odom_body_first"_a.noconvert(), "gate"_a, "kernel"_a,
        "sigma"_a, "fallback_stride"_a, "fallback_range"_a, "motion"_a, "mounting"_a, "threads"_a);
  m.def("match_points", &nearest_points, "map"_a, "points_body"_a.noconvert(), "before_end"_a.noconvert(),
        "T_odom_body"_a.noconvert(), "T_body_lidar"_a.noconvert(), "T_odom_body_first"_a.noconvert(), "gate"_a, "kernel"_a,
        "sigma"_a, "motion"_a, "mounting"_a, "threads"_a);
  m.def("query_planes", &query, "map"_a, "points_odom"_a.noconvert(), "gate"_a, "fallback_stride"_a, "fallback_range"_a);
}

}  // namespace heliograph
