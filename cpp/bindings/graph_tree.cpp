// SPDX-License-Identifier: MIT
#include <nanobind/stl/vector.h>

#include <array>
#include <mutex>

#include "bindings/bindings.hpp"
#include "graph/factors/pack.hpp"
#include "graph/tree/bayes_tree.hpp"

namespace heliograph {

namespace {

using Doubles = Array<const double, nb::ndim<1>>;
using Indices = Array<const int32_t, nb::ndim<1>>;

// A tree that several threads may hold: one call at a time, and the interpreter is free for others meanwhile.
class SharedTree {
 public:
  template <typename Work>
  auto call(Work&& work) {
    nb::gil_scoped_release release;
    const std::lock_guard lock(mutex_);
    return work(tree_);
  }

  // For what takes no time: the interpreter is given up only where another thread is at work.
  template <typename Work>
  auto look(Work&& work) {
    std::unique_lock lock(mutex_, std::try_to_lock);
    if (!lock.owns_lock()) {
      nb::gil_scoped_release release;
      lock.lock();
    }
    return work(tree_);
  }

 private:
  BayesTree tree_;
  std::mutex mutex_;
};

// Cliques in use; the variables of all of them one after another, pivots first.
struct CliqueTable {
  std::vector<int32_t> number, parent, pivots, sizes, variables, made;
};

template <typename T>
auto to_array(std::vector<T>&& values) {
  const size_t n = values.size();
  return to_numpy<T>(std::move(values), {n});
}

CliqueTable clique_table(const BayesTree& tree) {
  CliqueTable table;
  for (size_t c = 0; c < tree.all_cliques().size(); ++c) {
    const Clique& clique = tree.all_cliques()[c];
    if (clique.nodes.empty()) continue;
    table.number.push_back(static_cast<int32_t>(c));
    table.parent.push_back(clique.parent);
    table.pivots.push_back(clique.pivot_nodes);
    table.sizes.push_back(clique.node_count());
    table.variables.insert(table.variables.end(), clique.nodes.begin(), clique.nodes.end());
  }
  table.made = tree.made();
  return table;
}

int32_t add_kind(SharedTree& t, int type, const Indices& manifolds, const Indices& dofs, int rows, int noise, int kernel,
                 double width, int measurement) {
  const FactorKind kind{static_cast<FactorType>(type), span_of(manifolds), span_of(dofs), rows, static_cast<NoiseForm>(noise),
                        static_cast<KernelType>(kernel), width, measurement};
  return t.look([&](BayesTree& tree) { return tree.add_kind(kind); });
}

void set_custom(SharedTree& t, const Indices& factors, const Doubles& residual, const std::vector<Doubles>& jacobians) {
  std::vector<std::span<const double>> spans;
  for (const Doubles& J : jacobians) spans.push_back(span_of(J));
  t.call([&](BayesTree& tree) { tree.set_custom(span_of(factors), span_of(residual), spans); });
}

size_t solve(SharedTree& t, double wildfire, double relinearize, size_t max, size_t max_deferred) {
  return t.call([&](BayesTree& tree) { return tree.solve({wildfire, relinearize, max, max_deferred}); });
}

PassReport advance(SharedTree& t, double threshold, size_t relinearize, bool farthest_first, size_t eliminate, double wildfire,
                   double fluid_threshold, size_t steps, size_t deferred_steps) {
  const PassLimits limits{threshold, relinearize, farthest_first, eliminate, {wildfire, fluid_threshold, steps, deferred_steps}};
  return t.call([&](BayesTree& tree) { return tree.advance(limits); });
}

constexpr int kMaxStorage = 16;  // doubles of a packed value

// A factor of its own kind, as Python stages it: (..., kind, scope, family of a measurement that is not packed or -1, measurement,
// square root of information, data of the user's own, whether it is let go).
struct SingleFactor {
  int32_t kind = -1;
  size_t arity = 0;
  std::array<int32_t, kMaxArity> scope{};
  std::array<double, kMaxStorage> packed{};
  std::span<const double> measurement, root;
  bool let_go = false;
};

void read_single(nb::handle staged, SingleFactor* to) {
  const auto item = nb::borrow<nb::tuple>(staged);
  SingleFactor& out = *to;
  out.kind = nb::cast<int32_t>(item[1]);
  for (const nb::handle variable : nb::borrow<nb::list>(item[2])) {
    if (out.arity == out.scope.size()) throw std::invalid_argument("a factor of too many variables");
    out.scope[out.arity++] = nb::cast<int32_t>(variable);
  }
  // The arrays live in the tuples that the caller holds.
  const int family = nb::cast<int>(item[3]);
  if (family < 0) {
    out.measurement = span_of(nb::cast<Doubles>(item[4], false));
  } else {
    const auto x = nb::cast<nb::ndarray<const double, nb::device::cpu>>(item[4], false);
    const auto manifold = static_cast<Manifold>(family);
    const int storage = storage_of(manifold, 0);
    if (manifold == Manifold::vector || x.ndim() == 0 || storage > kMaxStorage) throw std::invalid_argument("not a single value");
    pack_single(manifold, 0, x.data(), x.stride(0), x.ndim() > 1 ? x.stride(1) : 0, out.packed.data());
    out.measurement = {out.packed.data(), static_cast<size_t>(storage)};
  }
  out.root = span_of(nb::cast<Doubles>(item[5], false));
  out.let_go = nb::cast<bool>(item[7]);
}

// Factors of any kinds, one each: a single call for an update of a few. Returns their numbers.
auto add_single_factors(SharedTree& t, const nb::list& staged) {
  std::vector<SingleFactor> factors(staged.size());
  for (size_t i = 0; i < factors.size(); ++i) read_single(staged[i], &factors[i]);
  return to_array(t.call([&](BayesTree& tree) {
    std::vector<int32_t> numbers;
    for (const SingleFactor& f : factors) {
      const std::vector<int32_t> added = tree.add_factors(f.kind, {f.scope.data(), f.arity}, f.measurement, f.root, f.let_go);
      numbers.insert(numbers.end(), added.begin(), added.end());
    }
    return numbers;
  }));
}

// What a saved state is compared with. Families are (manifold, dof) pairs; a kind is (type, rows, form of noise, kernel, doubles of a
// measurement, arity), then its families, up to the largest arity.
constexpr size_t kKindNumbers = 6 + 2 * kMaxArity;

std::vector<int32_t> variable_families(const BayesTree& tree) {
  std::vector<int32_t> out;
  for (int32_t v = 0; static_cast<size_t>(v) < tree.slots(); ++v) {
    const auto [manifold, dof] = tree.family(v);
    out.insert(out.end(), {static_cast<int32_t>(manifold), dof});
  }
  return out;
}

std::vector<int32_t> kind_table(const BayesTree& tree) {
  std::vector<int32_t> out;
  for (const FactorGroup& kind : tree.all_kinds()) {
    const size_t begin = out.size();
    out.insert(out.end(), {static_cast<int32_t>(kind.type), kind.rows, static_cast<int32_t>(kind.noise),
                           static_cast<int32_t>(kind.kernel), kind.measurement_size, kind.arity});
    for (size_t a = 0; a < static_cast<size_t>(kind.arity); ++a)
      out.insert(out.end(), {static_cast<int32_t>(kind.manifold[a]), kind.dof[a]});
    out.resize(begin + kKindNumbers, -1);
  }
  return out;
}

nb::bytes save(SharedTree& t) {
  const std::vector<uint8_t> bytes = t.call([](BayesTree& tree) { return tree.save(); });
  return nb::bytes(reinterpret_cast<const char*>(bytes.data()), bytes.size());
}

void load(SharedTree& t, const nb::bytes& bytes) {
  const std::span state(reinterpret_cast<const uint8_t*>(bytes.c_str()), bytes.size());
  t.call([&](BayesTree& tree) { tree.load(state); });
}

// A getter of one number.
template <typename Get>
auto number(Get get) {
  return [get](SharedTree& t) { return t.look([&](BayesTree& tree) { return (tree.*get)(); }); };
}

void bind_records(nb::module_& m) {
  nb::class_<TreeCounts>(m, "TreeCounts")
      .def_ro("variables", &TreeCounts::variables)
      .def_ro("cliques", &TreeCounts::cliques)
      .def_ro("factors", &TreeCounts::factors)
      .def_ro("linearized", &TreeCounts::linearized)
      .def_ro("solved", &TreeCounts::solved)
      .def_ro("work", &TreeCounts::work);
  nb::class_<PassReport>(m, "PassReport")
      .def_ro("relinearized", &PassReport::relinearized)
      .def_ro("caught_up", &PassReport::caught_up)
      .def_ro("undetermined", &PassReport::undetermined)
      .def_prop_ro("seconds", [](const PassReport& r) { return std::vector<double>(r.seconds.begin(), r.seconds.end()); });
  const auto list = [](std::vector<int32_t> CliqueTable::*member) {
    return [member](const CliqueTable& table) { return to_array(std::vector<int32_t>(table.*member)); };
  };
  nb::class_<CliqueTable>(m, "CliqueTable")
      .def_prop_ro("number", list(&CliqueTable::number), nb::rv_policy::move)
      .def_prop_ro("parent", list(&CliqueTable::parent), nb::rv_policy::move)
      .def_prop_ro("pivots", list(&CliqueTable::pivots), nb::rv_policy::move)
      .def_prop_ro("sizes", list(&CliqueTable::sizes), nb::rv_policy::move)
      .def_prop_ro("variables", list(&CliqueTable::variables), nb::rv_policy::move)
      .def_prop_ro("made", list(&CliqueTable::made), nb::rv_policy::move);
}

// What the tree is of.
void bind_contents(nb::class_<SharedTree>& bound) {
  using namespace nb::literals;
  bound.def(nb::init<>())
      .def("add_variables", [](SharedTree& t, int manifold, int dof, const Doubles& packed) {
             return to_array(t.call([&](BayesTree& tree) {
               return tree.add_variables(static_cast<Manifold>(manifold), dof, span_of(packed));
             }));
           }, "manifold"_a, "dof"_a, "packed"_a.noconvert())
      .def("hold", [](SharedTree& t, const Indices& v) { t.call([&](BayesTree& tree) { tree.hold(span_of(v)); }); },
           "variables"_a.noconvert())
      .def("add_kind", &add_kind, "type"_a, "manifolds"_a.noconvert(), "dofs"_a.noconvert(), "rows"_a, "noise"_a, "kernel"_a,
           "width"_a, "measurement"_a)
      .def("add_factors", [](SharedTree& t, int kind, const Indices& variables, const Doubles& measurement, const Doubles& noise,
                             bool let_go) {
             return to_array(t.call([&](BayesTree& tree) {
               return tree.add_factors(kind, span_of(variables), span_of(measurement), span_of(noise), let_go);
             }));
           }, "kind"_a, "variables"_a.noconvert(), "measurement"_a.noconvert(), "sqrt_information"_a.noconvert(), "let_go"_a = false)
      .def("add_single_factors", &add_single_factors, "staged"_a)
      .def("remove_factors", [](SharedTree& t, const Indices& f) {
             t.call([&](BayesTree& tree) { tree.remove_factors(span_of(f)); });
           }, "factors"_a.noconvert())
      .def("has_factors", [](SharedTree& t, const Indices& f) {
             return t.call([&](BayesTree& tree) { return tree.has_factors(span_of(f)); });
           }, "factors"_a.noconvert())
      .def("weigh_factors", [](SharedTree& t, const Indices& f, const Doubles& w) {
             t.call([&](BayesTree& tree) { tree.weigh_factors(span_of(f), span_of(w)); });
           }, "factors"_a.noconvert(), "weights"_a.noconvert())
      .def("let_go", [](SharedTree& t, const Indices& f) { t.call([&](BayesTree& tree) { tree.let_go(span_of(f)); }); },
           "factors"_a.noconvert())
      .def("take_back", [](SharedTree& t, const Indices& f) { t.call([&](BayesTree& tree) { tree.take_back(span_of(f)); }); },
           "factors"_a.noconvert());
}

// One update, step by step, and what leaves.
void bind_update(nb::class_<SharedTree>& bound) {
  using namespace nb::literals;
  bound.def("relinearize", [](SharedTree& t, double threshold, size_t max, bool farthest_first) {
             return t.call([&](BayesTree& tree) { return tree.relinearize(threshold, max, farthest_first); });
           }, "threshold"_a, "max"_a, "farthest_first"_a)
      .def("find_fluid", [](SharedTree& t, double threshold) {
             t.call([&](BayesTree& tree) { tree.find_fluid(threshold); });
           }, "threshold"_a)
      .def("detach", [](SharedTree& t) { t.call([](BayesTree& tree) { tree.detach(); }); })
      .def("stale_factors", [](SharedTree& t, int kind) {
             return to_array(t.call([&](BayesTree& tree) { return tree.stale_factors(kind); }));
           }, "kind"_a)
      .def("set_custom", &set_custom, "factors"_a.noconvert(), "residual"_a.noconvert(), "jacobians"_a.noconvert())
      .def("reorder", [](SharedTree& t) { t.call([](BayesTree& tree) { tree.reorder(); }); })
      .def("eliminate", [](SharedTree& t, size_t max) {
             return t.call([&](BayesTree& tree) { return tree.eliminate(max); });
           }, "max"_a)
      .def("advance", &advance, "threshold"_a, "relinearize"_a, "farthest_first"_a, "eliminate"_a, "wildfire"_a,
           "fluid_threshold"_a, "steps"_a, "deferred_steps"_a)
      .def("undo", [](SharedTree& t) { t.call([](BayesTree& tree) { tree.undo(); }); })
      .def("solve", &solve, "wildfire"_a, "relinearize"_a, "max"_a, "max_deferred"_a)
      .def("finish_steps", [](SharedTree& t) { t.call([](BayesTree& tree) { tree.finish_steps(); }); })
      .def("leave", [](SharedTree& t, const Indices& v) { t.call([&](BayesTree& tree) { tree.leave(span_of(v)); }); },
           "variables"_a.noconvert())
      .def("drop_left", [](SharedTree& t) { return to_array(t.call([](BayesTree& tree) { return tree.drop_left(); })); })
      .def("counts", [](SharedTree& t) { return t.look([](BayesTree& tree) { return tree.counts(); }); });
}

// What the tree says.
void bind_answers(nb::class_<SharedTree>& bound) {
  using namespace nb::literals;
  bound.def("factors_of", [](SharedTree& t, int32_t v) {
             return to_array(t.call([&](BayesTree& tree) { return tree.factors_of(v); }));
           }, "variable"_a)
      .def("held", [](SharedTree& t, int32_t v) { return t.look([&](BayesTree& tree) { return tree.held(v); }); },
           "variable"_a)
      .def("estimate", [](SharedTree& t, const Indices& v) {
             return to_array(t.call([&](BayesTree& tree) { return tree.estimate(span_of(v)); }));
           }, "variables"_a.noconvert())
      .def("linearization_point", [](SharedTree& t, const Indices& v) {
             return to_array(t.call([&](BayesTree& tree) { return tree.linearization_point(span_of(v)); }));
           }, "variables"_a.noconvert())
      .def("delta", [](SharedTree& t) {  // steps as they are, old ones included
             return to_array(t.call([](BayesTree& tree) {
               return std::vector<double>(tree.delta().begin(), tree.delta().end());
             }));
           })
      .def("covariance", [](SharedTree& t, const Indices& v) {
             return to_array(t.call([&](BayesTree& tree) { return tree.covariance(span_of(v)); }));
           }, "variables"_a.noconvert())
      .def("joint_covariance", [](SharedTree& t, const Indices& v) {
             return to_array(t.call([&](BayesTree& tree) { return tree.joint_covariance(span_of(v)); }));
           }, "variables"_a.noconvert())
      .def("clique_table", [](SharedTree& t) { return t.call([](BayesTree& tree) { return clique_table(tree); }); })
      .def("largest_step", [](SharedTree& t) { return t.call([](BayesTree& tree) { return tree.largest_step(); }); })
      .def("cost", [](SharedTree& t) { return t.call([](BayesTree& tree) { return tree.cost().cost; }); })
      .def("factor_data", [](SharedTree& t, int32_t f) {  // variables, measurement, form of noise, its numbers
             auto [scope, alone] = t.call([&](BayesTree& tree) { return tree.factor_alone(f); });
             return nb::make_tuple(to_array(std::move(scope)), to_array(std::move(alone.measurement)),
                                   static_cast<int>(alone.noise), to_array(std::move(alone.sqrt_information)));
           }, "factor"_a)
      .def("squared", [](SharedTree& t, const Indices& f, uint32_t since) {
             return to_array(t.call([&](BayesTree& tree) { return tree.squared(span_of(f), since); }));
           }, "factors"_a.noconvert(), "since"_a)
      .def("innovations", [](SharedTree& t, const Indices& f) {
             return to_array(t.call([&](BayesTree& tree) { return tree.innovations(span_of(f)); }));
           }, "factors"_a.noconvert())
      .def_prop_ro("solves", number(&BayesTree::solves))
      .def("save", &save)
      .def("load", &load, "state"_a)
      .def("variable_families", [](SharedTree& t) {
             auto flat = t.call([](BayesTree& tree) { return variable_families(tree); });
             const size_t n = flat.size() / 2;
             return to_numpy<int32_t>(std::move(flat), {n, 2});
           })
      .def("kind_table", [](SharedTree& t) {
             auto flat = t.call([](BayesTree& tree) { return kind_table(tree); });
             const size_t n = flat.size() / kKindNumbers;
             return to_numpy<int32_t>(std::move(flat), {n, kKindNumbers});
           })
      .def("factor_kinds", [](SharedTree& t) {  // by number: the kind, -1 where there is none, and whether it is let go
             auto flat = t.call([](BayesTree& tree) {
               std::vector<int32_t> kinds;
               for (const TreeFactor& factor : tree.all_factors()) kinds.insert(kinds.end(), {factor.kind, factor.let_go});
               return kinds;
             });
             const size_t n = flat.size() / 2;
             return to_numpy<int32_t>(std::move(flat), {n, 2});
           })
      .def("bytes", [](SharedTree& t) { return t.call([](BayesTree& tree) { return tree.bytes(); }); })
      .def_prop_ro("variables", number(&BayesTree::variables))
      .def_prop_ro("slots", number(&BayesTree::slots))
      .def_prop_ro("cliques", number(&BayesTree::cliques))
      .def_prop_ro("factors", number(&BayesTree::factors))
      .def_prop_ro("waiting", number(&BayesTree::waiting))
      .def_prop_ro("fluid", number(&BayesTree::fluid))
      .def_prop_ro("longest_fluid", number(&BayesTree::longest_fluid))
      .def_prop_ro("deferred", number(&BayesTree::deferred));
}

}  // namespace

void bind_graph_tree(nb::module_& m) {
  bind_records(m);
  nb::class_<SharedTree> bound(m, "BayesTree");
  bind_contents(bound);
  bind_update(bound);
  bind_answers(bound);
}

}  // namespace heliograph
