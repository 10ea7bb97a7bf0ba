// SPDX-License-Identifier: MIT
#include <cmath>

#include "bindings/bindings.hpp"
#include "graph/ordering/fill.hpp"
#include "graph/ordering/ordering.hpp"

namespace heliograph {

namespace {

using Numbers = Array<const int32_t, nb::shape<-1>>;

// The kernels index by these numbers unchecked, so a graph from outside is checked here, once.
Adjacency adjacency_of(const Stamps& offset, const Numbers& neighbour) {
  if (offset.size() == 0 || offset.data()[0] != 0) throw std::invalid_argument("offset needs one number a node and one more, from 0");
  const size_t n = offset.size() - 1;
  const int64_t* row = offset.data();
  for (size_t i = 0; i < n; ++i)
    if (row[i + 1] < row[i]) throw std::invalid_argument("offset must not descend");
  if (row[n] != static_cast<int64_t>(neighbour.size())) throw std::invalid_argument("offset must end at the number of neighbours");
  for (size_t i = 0; i < n; ++i)
    for (int64_t p = row[i]; p < row[i + 1]; ++p) {
      const int32_t j = neighbour.data()[p];
      if (j < 0 || static_cast<size_t>(j) >= n || static_cast<size_t>(j) == i)
        throw std::invalid_argument("a neighbour must be another node of the graph");
      if (p > row[i] && neighbour.data()[p - 1] >= j) throw std::invalid_argument("the neighbours of a node must ascend");
    }
  return {{row, row + n + 1}, {neighbour.data(), neighbour.data() + neighbour.size()}};
}

auto minimum_degree_order(const Stamps& offset, const Numbers& neighbour, const Numbers& weight, const Numbers& group) {
  const Adjacency graph = unlocked([&] { return adjacency_of(offset, neighbour); });
  std::vector<int32_t> order;
  {
    nb::gil_scoped_release release;
    order = minimum_degree(graph, span_of(weight), span_of(group));
  }
  const size_t count = order.size();
  return to_numpy<int32_t>(std::move(order), {count});
}

auto nested_dissection_order(const Stamps& offset, const Numbers& neighbour, const Numbers& weight) {
  const Adjacency graph = unlocked([&] { return adjacency_of(offset, neighbour); });
  std::vector<int32_t> order;
  {
    nb::gil_scoped_release release;
    order = nested_dissection(graph, span_of(weight));
  }
  const size_t count = order.size();
  return to_numpy<int32_t>(std::move(order), {count});
}

Tuple fill(const Stamps& offset, const Numbers& neighbour, const Numbers& weight, const Numbers& order) {
  const Adjacency graph = unlocked([&] { return adjacency_of(offset, neighbour); });
  std::vector<uint8_t> seen(graph.size(), 0);
  bool valid = order.size() == graph.size() && weight.size() == graph.size();
  for (size_t k = 0; valid && k < order.size(); ++k) {
    const auto node = static_cast<size_t>(order.data()[k]);  // a negative number becomes a large one
    valid = node < graph.size() && !seen[node];
    if (valid) seen[node] = 1;
  }
  if (!valid) throw std::invalid_argument("the order must name every node once, and each needs a weight");
  const std::vector<int32_t> parent = elimination_tree(graph, span_of(order));
  std::vector<int64_t> count = column_counts(graph, span_of(weight), span_of(order), parent);
  const Fill cost = fill_of_order(graph, span_of(weight), span_of(order));
  const size_t n = count.size();
  static TupleType type{"Fill", "nonzeros flops parent column_counts"};
  return named(type, cost.nonzeros, cost.flops, to_numpy<int32_t>(std::vector<int32_t>(parent), {n}), to_numpy<int64_t>(std::move(count), {n}));
}

}  // namespace

void bind_graph_ordering(nb::module_& m) {
  using namespace nb::literals;
  m.def("order_minimum_degree", &minimum_degree_order, "offset"_a.noconvert(), "neighbour"_a.noconvert(), "weight"_a.noconvert(),
        "group"_a.noconvert());
  m.def("order_nested_dissection", &nested_dissection_order, "offset"_a.noconvert(), "neighbour"_a.noconvert(), "weight"_a.noconvert());
  m.def("order_fill", &fill, "offset"_a.noconvert(), "neighbour"_a.noconvert(), "weight"_a.noconvert(), "order"_a.noconvert());
}

}  // namespace heliograph
