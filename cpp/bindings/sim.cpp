// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"
#include "sim/raycast.hpp"

namespace heliograph {

namespace {

using Directions = Array<const double, nb::shape<-1, -1, 3>>;
using Packed = Array<const double, nb::shape<-1, 18>>;
using Shapes = Array<const int32_t, nb::shape<-1>>;

// Columns of a packed primitive: rotation (row-major), centre, half-extents, reflectivity, contrast, period.
void make_scene(sim::Scene* self, const Packed& packed, const Shapes& shapes) {
  if (packed.shape(0) != shapes.shape(0)) throw nb::value_error("packed and shapes differ in length");
  std::vector<sim::Primitive> primitives(shapes.shape(0));
  for (size_t i = 0; i < primitives.size(); ++i) {
    const double* row = packed.data() + 18 * i;
    sim::Primitive& p = primitives[i];
    p.R_world_local = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(row);
    p.center = Eigen::Map<const Eigen::Vector3d>(row + 9);
    p.half = Eigen::Map<const Eigen::Vector3d>(row + 12);
    p.reflectivity = row[15];
    p.contrast = row[16];
    p.period = row[17];
    p.shape = static_cast<sim::Shape>(shapes.data()[i]);
  }
  new (self) sim::Scene(std::move(primitives));
}

Tuple cast(const sim::Scene& scene, const Directions& directions, const Poses& T_world_sensor, double min_range,
               double max_range, int threads) {
  const size_t rows = directions.shape(0), columns = directions.shape(1), n = rows * columns;
  if (T_world_sensor.shape(0) != columns) throw nb::value_error("one pose a column is needed");
  std::vector<double> range(n);
  std::vector<float> brightness(n);
  std::vector<int32_t> id(n);
  {
    nb::gil_scoped_release release;
    const sim::Sweep sweep{.rows = rows,
                           .columns = columns,
                           .directions = {directions.data(), 3 * n},
                           .T_world_sensor = {T_world_sensor.data(), 16 * columns},
                           .min_range = min_range,
                           .max_range = max_range};
    sim::cast_sweep(scene, sweep, threads, range, brightness, id);
  }
  static TupleType type{"Returns", "range brightness primitive"};
  return named(type, to_numpy<double, nb::ndim<2>>(std::move(range), {rows, columns}),
               to_numpy<float, nb::ndim<2>>(std::move(brightness), {rows, columns}),
               to_numpy<int32_t, nb::ndim<2>>(std::move(id), {rows, columns}));
}

}  // namespace

void bind_sim(nb::module_& m) {
  nb::class_<sim::Scene>(m, "Scene")
      .def("__init__", &make_scene, nb::arg("packed").noconvert(), nb::arg("shapes").noconvert())
      .def("__len__", &sim::Scene::size)
      .def("cast", &cast, nb::arg("directions").noconvert(), nb::arg("T_world_sensor").noconvert(),
           nb::arg("min_range"), nb::arg("max_range"), nb::arg("threads"),
           nb::sig("def cast(self, directions: NDArray[numpy.float64], T_world_sensor: NDArray[numpy.float64], "
                   "min_range: float, max_range: float, threads: int) -> tuple[NDArray[numpy.float64], "
                   "NDArray[numpy.float32], NDArray[numpy.int32]]"));
}

}  // namespace heliograph
