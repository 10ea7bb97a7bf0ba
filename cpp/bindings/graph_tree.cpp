// SPDX-License-Identifier: MIT
#include <nanobind/stl/vector.h>

#include "bindings/bindings.hpp"
#include "graph/tree/bayes_tree.hpp"

namespace heliograph {

namespace {

using Doubles = Array<const double, nb::ndim<1>>;
constexpr size_t kNoLimit = size_t{1} << 40;

using Indices = Array<const int32_t, nb::ndim<1>>;

auto numbers(std::vector<int32_t>&& values) {
  const size_t n = values.size();
  return to_numpy<int32_t>(std::move(values), {n});
}

auto doubles(std::vector<double>&& values) {
  const size_t n = values.size();
  return to_numpy<double>(std::move(values), {n});
}

void set_custom(BayesTree& tree, const Indices& factors, const Doubles& residual, const std::vector<Doubles>& jacobians) {
  std::vector<std::span<const double>> spans;
  for (const Doubles& J : jacobians) spans.push_back(span_of(J));
  tree.set_custom(span_of(factors), span_of(residual), spans);
}

Tuple counts(const BayesTree& tree) {
  const TreeCounts& c = tree.counts();
  return Tuple(nb::make_tuple(c.variables, c.cliques, c.factors, c.linearized, c.solved));
}

Tuple costs(const BayesTree& tree) {
  const GroupCost cost = unlocked([&] { return tree.cost(); });
  return Tuple(nb::make_tuple(cost.chi2, cost.cost));
}

// Cliques in use: their numbers, parents, counts of pivots and of variables, and the variables one clique after another.
Tuple clique_table(const BayesTree& tree) {
  std::vector<int32_t> index, parent, pivots, sizes, nodes;
  for (size_t c = 0; c < tree.all_cliques().size(); ++c) {
    const Clique& clique = tree.all_cliques()[c];
    if (clique.nodes.empty()) continue;
    index.push_back(static_cast<int32_t>(c));
    parent.push_back(clique.parent);
    pivots.push_back(clique.pivot_nodes);
    sizes.push_back(static_cast<int32_t>(clique.nodes.size()));
    nodes.insert(nodes.end(), clique.nodes.begin(), clique.nodes.end());
  }
  return Tuple(nb::make_tuple(numbers(std::move(index)), numbers(std::move(parent)), numbers(std::move(pivots)),
                              numbers(std::move(sizes)), numbers(std::move(nodes))));
}

nb::bytes save(const BayesTree& tree) {
  const std::vector<uint8_t> bytes = unlocked([&] { return tree.save(); });
  return nb::bytes(reinterpret_cast<const char*>(bytes.data()), bytes.size());
}

void load(BayesTree& tree, const nb::bytes& bytes) {
  tree.load({reinterpret_cast<const uint8_t*>(bytes.c_str()), bytes.size()});
}

}  // namespace

void bind_graph_tree(nb::module_& m) {
  using namespace nb::literals;
  nb::class_<BayesTree>(m, "BayesTree")
      .def(nb::init<>())
      .def("add_variables", [](BayesTree& t, int manifold, int dof, const Doubles& packed) {
             return numbers(t.add_variables(static_cast<Manifold>(manifold), dof, span_of(packed)));
           }, "manifold"_a, "dof"_a, "packed"_a.noconvert())
      .def("hold", [](BayesTree& t, const Indices& v) { t.hold(span_of(v)); }, "variables"_a.noconvert())
      .def("add_kind", [](BayesTree& t, int type, const Indices& manifolds, const Indices& dofs, int rows, int noise, int kernel,
                          double width) {
             return t.add_kind(static_cast<FactorType>(type), span_of(manifolds), span_of(dofs), rows, static_cast<NoiseForm>(noise),
                               static_cast<KernelType>(kernel), width);
           }, "type"_a, "manifolds"_a.noconvert(), "dofs"_a.noconvert(), "rows"_a, "noise"_a, "kernel"_a, "width"_a)
      .def("add_factors", [](BayesTree& t, int kind, const Indices& variables, const Doubles& measurement, const Doubles& noise) {
             return numbers(t.add_factors(kind, span_of(variables), span_of(measurement), span_of(noise)));
           }, "kind"_a, "variables"_a.noconvert(), "measurement"_a.noconvert(), "sqrt_information"_a.noconvert())
      .def("remove_factors", [](BayesTree& t, const Indices& f) { t.remove_factors(span_of(f)); }, "factors"_a.noconvert())
      .def("has_factors", [](const BayesTree& t, const Indices& f) { return t.has_factors(span_of(f)); }, "factors"_a.noconvert())
      .def("weigh_factors", [](BayesTree& t, const Indices& f, const Doubles& w) { t.weigh_factors(span_of(f), span_of(w)); },
           "factors"_a.noconvert(), "weights"_a.noconvert())
      .def("relinearize", &BayesTree::relinearize, "threshold"_a, "most"_a = kNoLimit, "farthest_first"_a = true)
      .def("find_fluid", &BayesTree::find_fluid, "threshold"_a)
      .def("detach", [](BayesTree& t) { unlocked([&] { t.detach(); }); })
      .def("stale_factors", [](const BayesTree& t, int kind) { return numbers(t.stale_factors(kind)); }, "kind"_a)
      .def("set_custom", &set_custom, "factors"_a.noconvert(), "residual"_a.noconvert(), "jacobians"_a.noconvert())
      .def("reorder", [](BayesTree& t) { unlocked([&] { t.reorder(); }); })
      .def("eliminate", [](BayesTree& t, size_t most) { return unlocked([&] { return t.eliminate(most); }); },
           "most"_a = kNoLimit)
      .def("leave", [](BayesTree& t, const Indices& v) { t.leave(span_of(v)); }, "variables"_a.noconvert())
      .def("drop_left", [](BayesTree& t) { return numbers(t.drop_left()); })
      .def("held", &BayesTree::held, "variable"_a)
      .def_prop_ro("waiting", &BayesTree::waiting)
      .def("undo", &BayesTree::undo)
      .def("covariance", [](const BayesTree& t, const Indices& v) {
             return doubles(unlocked([&] { return t.covariance(span_of(v)); }));
           }, "variables"_a.noconvert())
      .def("joint_covariance", [](const BayesTree& t, const Indices& v) {
             return doubles(unlocked([&] { return t.joint_covariance(span_of(v)); }));
           }, "variables"_a.noconvert())
      .def("clique_table", &clique_table)
      .def("made", [](const BayesTree& t) { return numbers(std::vector<int32_t>(t.made())); })
      .def("save", &save)
      .def("load", &load, "state"_a)
      .def("solve", [](BayesTree& t, double wildfire, double threshold, size_t most, size_t later) {
        return unlocked([&] { return t.solve(wildfire, threshold, most, later); });
      }, "wildfire"_a, "threshold"_a, "most"_a, "later"_a)
      .def("finish_steps", [](BayesTree& t) { unlocked([&] { t.finish_steps(); }); })
      .def_prop_ro("deferred", &BayesTree::deferred)
      .def("counts", &counts)
      .def_prop_ro("work", [](const BayesTree& t) { return t.counts().work; })
      .def("estimate", [](BayesTree& t, const Indices& v) { return doubles(t.estimate(span_of(v))); }, "variables"_a.noconvert())
      .def("linearization_point", [](const BayesTree& t, const Indices& v) { return doubles(t.linearization_point(span_of(v))); },
           "variables"_a.noconvert())
      .def_prop_ro("pending", &BayesTree::pending)
      .def_prop_ro("idle", &BayesTree::idle)
      .def("delta", [](const BayesTree& t) { return doubles({t.delta().begin(), t.delta().end()}); })
      .def("largest_step", &BayesTree::largest_step)
      .def("cost", &costs)
      .def("bytes", &BayesTree::bytes)
      .def_prop_ro("fluid", &BayesTree::fluid)
      .def_prop_ro("slots", &BayesTree::slots)
      .def_prop_ro("variables", &BayesTree::variables)
      .def_prop_ro("cliques", &BayesTree::cliques)
      .def_prop_ro("factors", &BayesTree::factors);
}

}  // namespace heliograph
