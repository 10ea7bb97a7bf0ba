// SPDX-License-Identifier: MIT
#include <nanobind/stl/optional.h>

#include "bindings/bindings.hpp"
#include "maps/global_map.hpp"
#include "maps/sights.hpp"
#include "maps/tiles.hpp"

namespace heliograph {

namespace {

using Cubes = Array<const int32_t, nb::shape<-1, 3>>;
using Numbers = Array<const uint32_t, nb::shape<-1>>;
using Marks = Array<const uint8_t, nb::shape<-1>>;
using Votes = Array<uint16_t, nb::shape<-1>>;
using Way = Array<const float, nb::shape<3>>;

void insert(GlobalMap& map, const Points& points, const Floats& intensity, const Matrix4& T) {
  if (intensity.size() != 0 && intensity.size() != points.shape(0))
    throw std::invalid_argument("intensity needs one value a point, or none");
  nb::gil_scoped_release release;
  map.insert(span_of(points), span_of(intensity), T.data());
}

void merge(GlobalMap& map, const Cubes& cubes, const Points& sums, const Floats& intensity, const Floats& counts,
           const std::optional<Matrix4>& T, uint32_t visit) {
  const size_t count = counts.size();
  if (cubes.shape(0) != count || sums.shape(0) != count || intensity.size() != count)
    throw std::invalid_argument("cubes, sums, intensity and counts need one row a cell");
  nb::gil_scoped_release release;
  map.merge({{cubes.data(), 3 * count}, span_of(sums), span_of(intensity), span_of(counts)}, T ? T->data() : nullptr,
            visit);
}

Tuple surfaces(GlobalMap& map, double thickness, int threads) {
  SurfacePoints found = unlocked([&] { return map.surfaces(thickness, threads); });
  const size_t count = found.counts.size();
  static TupleType type{"Surfaces", "points intensity counts first"};
  return named(type, to_numpy<double>(std::move(found.points), {count, 3}), to_numpy<float>(std::move(found.intensity), {count}),
               to_numpy<float>(std::move(found.counts), {count}), to_numpy<uint32_t>(std::move(found.first), {count}));
}

auto normals(GlobalMap& map, const Numbers& cells) {
  return to_numpy<float>(unlocked([&] { return map.normals(span_of(cells)); }), {cells.size(), 3});
}

auto marked_around(GlobalMap& map, const Numbers& cells, const Marks& marked) {
  return to_numpy<uint32_t>(unlocked([&] { return map.marked_around(span_of(cells), span_of(marked)); }), {cells.size(), 2});
}

Tuple split(const Cubes& cubes, int32_t edge, int32_t halo) {
  TileSplit found = unlocked([&] { return split_tiles(span_of(cubes), edge, halo); });
  const size_t tiles = found.tiles.size() / 3, cells = found.cells.size();
  static TupleType type{"TileSplit", "tiles begin cells"};
  return named(type, to_numpy<int32_t>(std::move(found.tiles), {tiles, 3}), to_numpy<uint32_t>(std::move(found.begin), {tiles + 1}),
               to_numpy<uint32_t>(std::move(found.cells), {cells}));
}

void seen_through(const Points& places, const Points& normals, const Points& ends, const Way& start, float radius,
                  float reach, float margin, float grazing, const Votes& votes) {
  const SightSettings settings{radius, reach, margin, grazing};
  const std::span<uint16_t> into(votes.data(), votes.size());
  unlocked([&] { count_seen_through(span_of(places), span_of(normals), {span_of(ends), start.data()}, settings, into); });
}

}  // namespace

void bind_global_maps(nb::module_& m) {
  using namespace nb::literals;
  const auto column = [](auto values, size_t count) { return to_numpy<float>(std::move(values), {count}); };
  nb::class_<GlobalMap>(m, "GlobalMap")
      .def(nb::init<double>(), "voxel"_a)
      .def("insert", &insert, "points_body"_a.noconvert(), "intensity"_a.noconvert(), "T_map_body"_a.noconvert())
      .def("merge", &merge, "cubes"_a.noconvert(), "sums"_a.noconvert(), "intensity"_a.noconvert(),
           "counts"_a.noconvert(), "T_map_odom"_a.noconvert().none(), "visit"_a)
      .def("keep", [](GlobalMap& map, const Marks& wanted) { map.keep(span_of(wanted)); }, "wanted"_a.noconvert())
      .def("clear", &GlobalMap::clear)
      .def("__len__", &GlobalMap::size)
      .def("bytes", &GlobalMap::bytes)
      .def("points", [](const GlobalMap& map) { return to_numpy<double>(map.points(), {map.size(), 3}); })
      .def("intensity", [column](const GlobalMap& map) { return column(map.intensity(), map.size()); })
      .def("counts", [column](const GlobalMap& map) { return column(map.counts(), map.size()); })
      .def("visits", [](const GlobalMap& map) { return to_numpy<uint32_t>(map.visits(), {map.size()}); })
      .def("first", [](const GlobalMap& map) { return to_numpy<uint32_t>(map.first(), {map.size()}); })
      .def("cubes", [](const GlobalMap& map) { return to_numpy<int32_t>(map.cubes(), {map.size(), 3}); })
      .def("sums", [](const GlobalMap& map) { return to_numpy<float>(map.sums(), {map.size(), 3}); })
      .def("intensity_sums", [column](const GlobalMap& map) { return column(map.intensity_sums(), map.size()); })
      .def("surfaces", &surfaces, "thickness"_a, "threads"_a)
      .def("normals", &normals, "cells"_a.noconvert())
      .def("marked_around", &marked_around, "cells"_a.noconvert(), "marked"_a.noconvert());
  m.def("split_tiles", &split, "cubes"_a.noconvert(), "edge"_a, "halo"_a);
  m.def("count_seen_through", &seen_through, "places"_a.noconvert(), "normals"_a.noconvert(), "ends"_a.noconvert(),
        "start"_a.noconvert(), "radius"_a, "reach"_a, "margin"_a, "grazing"_a, "votes"_a.noconvert());
}

}  // namespace heliograph
