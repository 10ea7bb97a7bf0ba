// SPDX-License-Identifier: MIT
// Array types that cross the boundary and one registration function a room.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <memory>
#include <span>
#include <stdexcept>
#include <vector>

namespace heliograph {

namespace nb = nanobind;

template <typename T, typename... Extra>
using Array = nb::ndarray<T, nb::c_contig, nb::device::cpu, Extra...>;
using Points = Array<const float, nb::shape<-1, 3>>;   // (N, 3) float32
using Vectors = Array<const double, nb::shape<-1, 3>>; // (N, 3) float64
using Matrix4 = Array<const double, nb::shape<4, 4>>;
using Poses = Array<const double, nb::shape<-1, 4, 4>>;
using Stamps = Array<const int64_t, nb::shape<-1>>;
using Offsets = Array<const int32_t, nb::shape<-1>>;

using Floats = Array<const float, nb::shape<-1>>;
using Matrix3 = Array<const double, nb::shape<3, 3>>;
using Vector3 = Array<const double, nb::shape<3>>;
using Rotations = Array<const double, nb::shape<-1, 3, 3>>;

// Several results at once, as a named tuple.
using Tuple = nb::typed<nb::tuple, nb::any, nb::ellipsis>;

// A type of named tuple, made at the first use and kept as long as the process lives. Static without a guard: what waits at
// a guard with the interpreter's lock in hand would wait for ever. Two threads at once make two equal types.
struct TupleType {
  const char* name;
  const char* fields;
  PyObject* made = nullptr;
};

template <typename... Parts>
Tuple named(TupleType& type, Parts&&... parts) {
  if (type.made == nullptr)
    type.made = nb::module_::import_("collections").attr("namedtuple")(type.name, type.fields, nb::arg("module") = "heliograph._core").release().ptr();
  return nb::borrow<Tuple>(nb::handle(type.made)(std::forward<Parts>(parts)...));
}

template <typename T, typename... Extra>
std::span<const T> span_of(const Array<const T, Extra...>& array) {
  return {array.data(), array.size()};
}

// Hands a vector's memory to NumPy without a copy.
template <typename T, typename... Extra>
nb::ndarray<nb::numpy, T, Extra...> to_numpy(std::vector<T>&& values, std::initializer_list<size_t> shape) {
  auto owned = std::make_unique<std::vector<T>>(std::move(values));
  T* data = owned->data();
  nb::capsule owner(owned.release(), [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
  return nb::ndarray<nb::numpy, T, Extra...>(data, shape, owner);
}

// Does the work with the interpreter free for other threads; the work must not touch Python.
template <typename Work>
auto unlocked(Work&& work) {
  nb::gil_scoped_release release;
  return work();
}

void bind_alignment(nb::module_& m);
void bind_cloud(nb::module_& m);
void bind_features(nb::module_& m);
void bind_global_maps(nb::module_& m);
void bind_graph_problem(nb::module_& m);
void bind_graph_diagnosis(nb::module_& m);
void bind_graph_files(nb::module_& m);
void bind_graph_ordering(nb::module_& m);
void bind_graph_factors(nb::module_& m);
void bind_graph_retraction(nb::module_& m);
void bind_graph_tree(nb::module_& m);
void bind_imu(nb::module_& m);
void bind_io(nb::module_& m);
void bind_kd_trees(nb::module_& m);
void bind_lie(nb::module_& m);
void bind_maps(nb::module_& m);
void bind_registration(nb::module_& m);
void bind_sim(nb::module_& m);

}  // namespace heliograph
