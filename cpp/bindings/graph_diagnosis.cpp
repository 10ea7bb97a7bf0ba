// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"
#include "graph/diagnosis/diagnosis.hpp"

namespace heliograph {

namespace {

using Indices = Array<const int32_t, nb::ndim<1>>;

template <typename T>
auto moved(std::vector<T>&& values) {
  const size_t size = values.size();
  return to_numpy<T>(std::move(values), {size});
}

Tuple find_free(const GraphProblem& problem, const Indices& assumed, int most_columns) {
  FreeSpace space;
  {
    nb::gil_scoped_release release;
    space = free_space(problem, span_of(assumed), most_columns);
  }
  std::vector<uint8_t> freedom;
  for (const Freedom value : space.freedom) freedom.push_back(static_cast<uint8_t>(value));
  static TupleType type{"FreeSpace",
                        "determined everywhere components component factors freedom part columns motion_of motion"};
  return named(type, space.determined, space.everywhere, space.components, moved(std::move(space.component)), moved(std::move(space.factors)),
               moved(std::move(freedom)), moved(std::move(space.part)), moved(std::move(space.columns)),
               moved(std::move(space.motion_of)), moved(std::move(space.motion)));
}

}  // namespace

void bind_graph_diagnosis(nb::module_& m) {
  using namespace nb::literals;
  m.def("graph_free_space", &find_free, "problem"_a, "assumed"_a.noconvert(), "most_columns"_a);
  m.def("graph_components", [](const GraphProblem& problem) { return unlocked([&] { return count_components(problem); }); }, "problem"_a);
  m.def("graph_least_pivot", [](const GraphProblem& problem) { return unlocked([&] { return least_pivot(problem); }); }, "problem"_a);
}

}  // namespace heliograph
