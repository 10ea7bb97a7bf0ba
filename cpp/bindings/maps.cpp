// SPDX-License-Identifier: MIT
#include <nanobind/stl/optional.h>

#include "bindings/bindings.hpp"
#include "bindings/state_bytes.hpp"
#include "maps/global_map.hpp"
#include "maps/voxel_map.hpp"

namespace heliograph {

namespace {

using Cubes = Array<const int32_t, nb::shape<-1, 3>>;

void insert_global(GlobalMap& map, const Points& points, const Floats& intensity, const Matrix4& T) {
  if (intensity.size() != 0 && intensity.size() != points.shape(0))
    throw std::invalid_argument("intensity needs one value a point, or none");
  nb::gil_scoped_release release;
  map.insert(span_of(points), span_of(intensity), T.data());
}

void merge_global(GlobalMap& map, const Cubes& cubes, const Points& sums, const Floats& intensity, const Floats& counts,
                  const std::optional<Matrix4>& T) {
  const size_t count = counts.size();
  if (cubes.shape(0) != count || sums.shape(0) != count || intensity.size() != count)
    throw std::invalid_argument("cubes, sums, intensity and counts need one row a cell");
  nb::gil_scoped_release release;
  map.merge({{cubes.data(), 3 * count}, span_of(sums), span_of(intensity), span_of(counts)}, T ? T->data() : nullptr);
}

Tuple surfaces(GlobalMap& map, double thickness, int threads) {
  SurfacePoints found;
  {
    nb::gil_scoped_release release;
    found = map.surfaces(thickness, threads);
  }
  const size_t count = found.counts.size();
  static TupleType type{"Surfaces", "points intensity counts"};
  return named(type, to_numpy<float>(std::move(found.points), {count, 3}), to_numpy<float>(std::move(found.intensity), {count}),
               to_numpy<float>(std::move(found.counts), {count}));
}

auto voxel_planes(const VoxelMap& map) {
  std::vector<double> rows;
  for (size_t id = 0; id < map.size(); ++id) {
    const Moments& m = map.moments()[id];
    const Plane& plane = map.planes()[id];
    const uint64_t level = key_level(m.key);
    const Cube cube = unpack(m.key);
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
  nb::class_<GlobalMap>(m, "GlobalMap")
      .def(nb::init<double>(), "voxel"_a)
      .def("insert", &insert_global, "points_body"_a.noconvert(), "intensity"_a.noconvert(), "T_map_body"_a.noconvert())
      .def("__len__", &GlobalMap::size)
      .def("bytes", &GlobalMap::bytes)
      .def("points", [](const GlobalMap& map) { return to_numpy<float>(map.points(), {map.size(), 3}); })
      .def("intensity", [](const GlobalMap& map) { return to_numpy<float>(map.intensity(), {map.size()}); })
      .def("counts", [](const GlobalMap& map) { return to_numpy<float>(map.counts(), {map.size()}); })
      .def("merge", &merge_global, "cubes"_a.noconvert(), "sums"_a.noconvert(), "intensity"_a.noconvert(),
           "counts"_a.noconvert(), "T_map_odom"_a.noconvert().none())
      .def("surfaces", &surfaces, "thickness"_a, "threads"_a)
      .def("clear", &GlobalMap::clear)
      .def("cubes", [](const GlobalMap& map) { return to_numpy<int32_t>(map.cubes(), {map.size(), 3}); })
      .def("sums", [](const GlobalMap& map) { return to_numpy<float>(map.sums(), {map.size(), 3}); })
      .def("intensity_sums", [](const GlobalMap& map) { return to_numpy<float>(map.intensity_sums(), {map.size()}); });
}

}  // namespace heliograph
