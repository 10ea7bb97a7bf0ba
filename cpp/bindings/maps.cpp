// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"
#include "bindings/state_bytes.hpp"
#include "maps/voxel_map.hpp"

namespace heliograph {

namespace {

auto voxel_planes(const VoxelMap& map) {
  std::vector<double> rows;
  for (size_t id = 0; id < map.size(); ++id) {
    const Moments& m = map.moments()[id];
    const Plane& plane = map.planes()[id];
    const uint64_t level = key_level(m.key);
    const Cube cube = map.cube_of(m.key);
    const double edge = map.edge(level);
    const double c[3] = {(static_cast<double>(cube.x) + 0.5) * edge, (static_cast<double>(cube.y) + 0.5) * edge,
                         (static_cast<double>(cube.z) + 0.5) * edge};
    rows.push_back(static_cast<double>(level));
    rows.push_back(m.count);
    for (int i = 0; i < 3; ++i) rows.push_back(c[i]);
    for (int i = 0; i < 3; ++i) rows.push_back(plane.normal[i]);
    for (int i = 0; i < 3; ++i) rows.push_back(c[i] + plane.centroid[i]);
    rows.push_back(plane.variance);
    rows.push_back(plane.inv_spread);
  }
  const size_t count = map.size();
  return to_numpy<double>(std::move(rows), {count, 13});
}

}  // namespace

void bind_maps(nb::module_& m) {
  using namespace nb::literals;
  nb::class_<VoxelMap>(m, "VoxelMap")
      .def("__init__",
           [](VoxelMap* self, double voxel, int levels, int min_points, int max_points, double max_thickness,
              double min_spread, double point_spacing) {
             new (self) VoxelMap({voxel, levels, min_points, max_points, max_thickness, min_spread, point_spacing});
           },
           "voxel"_a, "levels"_a, "min_points"_a, "max_points"_a, "max_thickness"_a, "min_spread"_a, "point_spacing"_a)
      .def("insert",
           [](VoxelMap& map, const Points& points, const Matrix4& T) {
             nb::gil_scoped_release release;
             return map.insert(span_of(points), T.data());
           },
           "points_body"_a.noconvert(), "T_odom_body"_a.noconvert())
      .def("prune",
           [](VoxelMap& map, const Vector3& centre, double radius, size_t max_voxels) {
             nb::gil_scoped_release release;
             map.prune(centre.data(), radius, max_voxels);
           },
           "centre"_a.noconvert(), "radius"_a, "max_voxels"_a)
      .def("forget_unseen",
           [](VoxelMap& map, uint32_t insertions) {
             nb::gil_scoped_release release;
             map.forget_unseen(insertions);
           },
           "insertions"_a)
      .def("save", [](const VoxelMap& map) { return to_bytes(map.save()); })
      .def("load", [](VoxelMap& map, const nb::bytes& state) { map.load(bytes_of(state)); }, "state"_a)
      .def("__len__", &VoxelMap::size)
      .def("bytes", &VoxelMap::bytes)
      .def("planes", &voxel_planes);
}

}  // namespace heliograph
