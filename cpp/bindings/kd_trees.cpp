// SPDX-License-Identifier: MIT
#include <cmath>

#include "bindings/bindings.hpp"
#include "maps/incremental_kd_tree.hpp"
#include "maps/kd_tree.hpp"
#include "maps/neighbour_planes.hpp"

namespace heliograph {

namespace {

using Corner = Array<const float, nb::shape<3>>;

Tuple nearest(const KdTree& tree, const Points& queries, size_t count, double max_distance) {
  const size_t n = queries.shape(0);
  std::vector<float> square(n * count, std::numeric_limits<float>::infinity());
  std::vector<int32_t> index(n * count, -1);
  unlocked([&] {
    std::vector<Neighbour> found(count);
    for (size_t i = 0; i < n; ++i) {
      const size_t some = tree.nearest(queries.data() + 3 * i, count, static_cast<float>(max_distance * max_distance), found.data());
      for (size_t k = 0; k < some; ++k) {
        square[i * count + k] = found[k].square;
        index[i * count + k] = static_cast<int32_t>(found[k].index);
      }
    }
  });
  return Tuple(nb::make_tuple(to_numpy<float>(std::move(square), {n, count}), to_numpy<int32_t>(std::move(index), {n, count})));
}

Tuple nearest_places(const IncrementalKdTree& tree, const Points& queries, size_t count, double max_distance) {
  const size_t n = queries.shape(0);
  std::vector<float> square(n * count, std::numeric_limits<float>::infinity());
  std::vector<float> places(3 * n * count, std::nanf(""));
  unlocked([&] {
    const auto reach = static_cast<float>(max_distance * max_distance);
    for (size_t i = 0; i < n; ++i)
      tree.nearest(queries.data() + 3 * i, count, reach, square.data() + i * count, places.data() + 3 * i * count);
  });
  return Tuple(nb::make_tuple(to_numpy<float>(std::move(square), {n, count}), to_numpy<float>(std::move(places), {n, count, 3})));
}

Tuple planes(const IncrementalKdTree& tree, const Vectors& queries, size_t neighbours, double reach, double max_thickness,
             double min_spread, double gate, int threads) {
  const size_t n = queries.shape(0);
  std::vector<float> normal(3 * n), variance(n);
  std::vector<double> point(3 * n);
  std::vector<uint8_t> source(n);
  unlocked([&] {
    neighbour_planes(tree, span_of(queries), {neighbours, reach, max_thickness, min_spread, gate},
                     {normal.data(), point.data(), variance.data(), source.data()}, threads);
  });
  return Tuple(nb::make_tuple(to_numpy<float>(std::move(normal), {n, 3}), to_numpy<double>(std::move(point), {n, 3}),
                              to_numpy<float>(std::move(variance), {n}), to_numpy<uint8_t>(std::move(source), {n})));
}

}  // namespace

void bind_kd_trees(nb::module_& m) {
  using namespace nb::literals;
  nb::class_<KdTree>(m, "KdTree")
      .def("__init__", [](KdTree* self, const Points& points) { unlocked([&] { new (self) KdTree(span_of(points)); }); },
           "points"_a.noconvert())
      .def("__len__", &KdTree::size)
      .def("bytes", &KdTree::bytes)
      .def("nearest", &nearest, "queries"_a.noconvert(), "count"_a, "max_distance"_a);
  nb::class_<SeenCubes>(m, "SeenCubes")
      .def(nb::init<double>(), "edge"_a)
      .def("__len__", &SeenCubes::size)
      .def("prune", [](SeenCubes& seen, const Vector3& centre, double radius) { seen.prune(centre.data(), radius); },
           "centre"_a.noconvert(), "radius"_a)
      .def("clear", &SeenCubes::clear);
  nb::class_<IncrementalKdTree>(m, "IncrementalKdTree")
      .def(nb::init<double, double>(), "spacing"_a, "balance"_a)
      .def("__len__", &IncrementalKdTree::size)
      .def("bytes", &IncrementalKdTree::bytes)
      .def("depth", &IncrementalKdTree::depth)
      .def("clear", &IncrementalKdTree::clear)
      .def("points", [](const IncrementalKdTree& tree) { return to_numpy<float>(tree.points(), {tree.size(), 3}); })
      .def("insert", [](IncrementalKdTree& tree, const Points& points) { return unlocked([&] { return tree.insert(span_of(points)); }); },
           "points"_a.noconvert())
      .def("insert_scan",
           [](IncrementalKdTree& tree, const Points& points, const Matrix4& T, SeenCubes& seen) {
             return unlocked([&] { return insert_scan(tree, span_of(points), T.data(), seen); });
           },
           "points_body"_a.noconvert(), "T_odom_body"_a.noconvert(), "seen"_a)
      .def("forget_unseen",
           [](IncrementalKdTree& tree, SeenCubes& seen, uint32_t insertions) {
             unlocked([&] { forget_unseen(tree, seen, insertions); });
           },
           "seen"_a, "insertions"_a)
      .def("remove_box",
           [](IncrementalKdTree& tree, const Corner& low, const Corner& high) {
             return unlocked([&] { return tree.remove_box(low.data(), high.data()); });
           },
           "low"_a.noconvert(), "high"_a.noconvert())
      .def("remove_beyond",
           [](IncrementalKdTree& tree, const Corner& centre, double radius) {
             return unlocked([&] { return tree.remove_beyond(centre.data(), static_cast<float>(radius)); });
           },
           "centre"_a.noconvert(), "radius"_a)
      .def("nearest", &nearest_places, "queries"_a.noconvert(), "count"_a, "max_distance"_a)
      .def("planes", &planes, "queries"_a.noconvert(), "neighbours"_a, "reach"_a, "max_thickness"_a, "min_spread"_a,
           "gate"_a, "threads"_a);
}

}  // namespace heliograph
