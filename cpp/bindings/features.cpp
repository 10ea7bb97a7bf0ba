// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"
#include "bindings/state_bytes.hpp"
#include "cloud/scan_features.hpp"
#include "cloud/scan_lines.hpp"
#include "maps/feature_map.hpp"
#include "registration/feature_rows.hpp"

namespace heliograph {

namespace {

using Rows = Array<const uint16_t, nb::shape<-1>>;
using Shares = Array<const float, nb::shape<-1>>;

// The lines or planes that points were matched to, kept for the sums of several iterations.
struct FeatureMatches {
  FeatureKind kind;
  std::vector<FeatureMatch> found;
};

auto indices(std::vector<int32_t>&& values) {
  const size_t count = values.size();
  return to_numpy<int32_t>(std::move(values), {count});
}

FeatureKind kind_of(bool edges) { return edges ? FeatureKind::edge : FeatureKind::plane; }

Tuple lines(const Points& points, const Offsets& offsets, const Rows& rows) {
  if (offsets.size() != points.shape(0) || rows.size() != points.shape(0)) throw std::invalid_argument("one time and one row a point are needed");
  ScanLines found = unlocked([&] { return scan_lines(span_of(points), span_of(offsets), span_of(rows)); });
  static TupleType type{"Lines", "order starts doubles"};
  return named(type, indices(std::move(found.order)), indices(std::move(found.starts)), found.doubles);
}

Tuple by_elevation(const Points& points, double row_height) {
  ElevationRows found = unlocked([&] { return elevation_rows(span_of(points), row_height); });
  const size_t count = found.rows.size();
  static TupleType type{"ElevationRows", "rows discrete"};
  return named(type, to_numpy<uint16_t>(std::move(found.rows), {count}), found.discrete);
}

Tuple features(const Points& points, const Offsets& order, const Offsets& starts, int window, int region, double edge_curvature,
               double plane_curvature, double noise, int edges, int planes, int map_edges, int map_stride, double gap,
               double grazing, int threads) {
  if (window < 1 || region < 1 || map_stride < 1) throw std::invalid_argument("window, region and map_stride must be positive");
  const ScanFeatureSettings s{window, region, edge_curvature, plane_curvature, noise, edges, planes, map_edges, map_stride, gap, grazing};
  ScanFeatures found = unlocked([&] { return scan_features(span_of(points), span_of(order), span_of(starts), s, threads); });
  static TupleType type{"Features", "edges planes map_edges map_planes"};
  return named(type, indices(std::move(found.edges)), indices(std::move(found.planes)), indices(std::move(found.map_edges)),
               indices(std::move(found.map_planes)));
}

FeatureMatches matched(const FeatureMap& map, const Points& points, const Matrix4& T, double sigma, int threads) {
  return unlocked([&] {
    return FeatureMatches{map.kind(), match_features(map, {span_of(points), T.data()}, sigma, threads)};
  });
}

Tuple summed(const FeatureMatches& matches, const Points& points, const Matrix4& T, const Shares& shares, double gate,
             double kernel, double sigma, int threads) {
  if (matches.found.size() != points.shape(0)) throw std::invalid_argument("one match a point is needed");
  if (shares.size() != 0 && shares.size() != points.shape(0)) throw std::invalid_argument("one share a point is needed, or none");
  const NormalEquations sums = unlocked([&] {
    return sum_features(matches.kind, matches.found, {span_of(points), T.data()}, span_of(shares), gate, kernel, sigma, threads);
  });
  std::vector<double> information(sums.information, sums.information + 36), gradient(sums.gradient, sums.gradient + 6);
  std::vector<double> feigned(sums.feigned, sums.feigned + 36);
  static TupleType type{"FeatureSums", "information gradient feigned feigned_square weight robust_weight square cost matches"};
  return named(type, to_numpy<double>(std::move(information), {6, 6}), to_numpy<double>(std::move(gradient), {6}),
               to_numpy<double>(std::move(feigned), {6, 6}), sums.feigned_square, sums.weight, sums.robust_weight, sums.square,
               sums.cost, sums.matches);
}

// One row a point: found (0 or 1), axis 3, point 3, variance, tilt.
auto table(const FeatureMatches& matches) {
  std::vector<double> rows;
  for (const FeatureMatch& m : matches.found) {
    rows.push_back(m.found ? 1.0 : 0.0);
    rows.insert(rows.end(), m.axis, m.axis + 3);
    rows.insert(rows.end(), m.point, m.point + 3);
    rows.push_back(m.variance);
    rows.push_back(m.tilt);
  }
  return to_numpy<double>(std::move(rows), {matches.found.size(), 9});
}

}  // namespace

void bind_features(nb::module_& m) {
  using namespace nb::literals;
  m.def("scan_lines", &lines, "points"_a.noconvert(), "offsets_ns"_a.noconvert(), "rows"_a.noconvert());
  m.def("elevation_rows", &by_elevation, "points"_a.noconvert(), "row_height"_a);
  m.def("step_angle", [](const Points& points, size_t stride) { return unlocked([&] { return step_angle(span_of(points), stride); }); },
        "points"_a.noconvert(), "stride"_a);
  m.def("scan_features", &features, "points"_a.noconvert(), "order"_a.noconvert(), "starts"_a.noconvert(), "window"_a, "region"_a,
        "edge_curvature"_a, "plane_curvature"_a, "noise"_a, "edges"_a, "planes"_a, "map_edges"_a, "map_stride"_a, "gap"_a,
        "grazing"_a, "threads"_a);
  nb::class_<FeatureMatches>(m, "FeatureMatches")
      .def("__len__", [](const FeatureMatches& matches) { return matches.found.size(); })
      .def("table", &table)
      .def("sum", &summed, "points_body"_a.noconvert(), "T_odom_body"_a.noconvert(), "shares"_a.noconvert(), "gate"_a, "kernel"_a,
           "sigma"_a, "threads"_a);
  nb::class_<FeatureMap>(m, "FeatureMap")
      .def("__init__",
           [](FeatureMap* self, bool edges, double voxel, int max_points, int neighbours, double reach, double max_thickness, double min_spread) {
             new (self) FeatureMap({kind_of(edges), voxel, max_points, neighbours, reach, max_thickness, min_spread});
           },
           "edges"_a, "voxel"_a, "max_points"_a, "neighbours"_a, "reach"_a, "max_thickness"_a, "min_spread"_a)
      .def("insert",
           [](FeatureMap& map, const Points& points, const Matrix4& T) { return unlocked([&] { return map.insert(span_of(points), T.data()); }); },
           "points_body"_a.noconvert(), "T_odom_body"_a.noconvert())
      .def("prune",
           [](FeatureMap& map, const Vector3& centre, double radius, size_t max_cells) {
             unlocked([&] { map.prune(centre.data(), radius, max_cells); });
           },
           "centre"_a.noconvert(), "radius"_a, "max_cells"_a)
      .def("clear", &FeatureMap::clear)
      .def("match", &matched, "points_body"_a.noconvert(), "T_odom_body"_a.noconvert(), "sigma"_a, "threads"_a)
      .def("cells", [](const FeatureMap& map) { return to_numpy<double>(map.cells(), {map.size(), 4}); })
      .def("save", [](const FeatureMap& map) { return to_bytes(map.save()); })
      .def("load", [](FeatureMap& map, const nb::bytes& state) { map.load(bytes_of(state)); }, "state"_a)
      .def("__len__", &FeatureMap::size)
      .def("bytes", &FeatureMap::bytes);
}

}  // namespace heliograph
