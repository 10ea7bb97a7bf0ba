// SPDX-License-Identifier: MIT
#include <nanobind/stl/vector.h>

#include <mutex>

#include "bindings/bindings.hpp"
#include "graph/factors/make_group.hpp"
#include "graph/problem/problem.hpp"
#include "graph/cholesky/selected_inverse.hpp"

namespace heliograph {

namespace {

using Doubles = Array<const double, nb::ndim<1>>;
using Indices = Array<const int32_t, nb::ndim<1>>;
using Scopes = Array<const int32_t, nb::ndim<2>>;
using Rows = Array<const double, nb::ndim<2>>;
using Cubes = Array<const double, nb::ndim<3>>;

std::vector<FamilyBlock> families_of(const Indices& code, const Indices& dof, const Stamps& count) {
  if (code.size() != dof.size() || code.size() != count.size()) throw std::invalid_argument("one code, dof and count a family");
  std::vector<FamilyBlock> families(code.size());
  for (size_t i = 0; i < families.size(); ++i) {
    families[i].manifold = static_cast<Manifold>(code.data()[i]);
    families[i].dof = dof.data()[i];
    families[i].count = static_cast<size_t>(count.data()[i]);
  }
  return families;
}

auto copied(std::span<const double> values) {
  return to_numpy<double>(std::vector<double>(values.begin(), values.end()), {values.size()});
}

Tuple costs(const GroupCost& cost) {
  static TupleType type{"Costs", "chi2 cost"};
  return named(type, cost.chi2, cost.cost);
}

size_t add_group(GraphProblem& problem, int type, const Scopes& variables, int rows, const Rows& measurement, int noise, bool shared,
                 const Doubles& sqrt_information, int kernel, double width) {
  GroupInput input;
  input.type = static_cast<FactorType>(type);
  input.arity = static_cast<int>(variables.shape(1));
  input.rows = rows;
  input.variables = span_of(variables);
  input.measurement = span_of(measurement);
  input.noise = static_cast<NoiseForm>(noise);
  input.shared_noise = shared;
  input.sqrt_information = span_of(sqrt_information);
  input.kernel = static_cast<KernelType>(kernel);
  input.kernel_width = width;
  return unlocked([&] { return problem.add_group(make_group(input, problem.families())); });
}

void copy_into(std::vector<double>& to, std::span<const double> from, size_t expected, const char* what, bool or_none = false) {
  if (from.size() != expected && !(or_none && from.empty())) throw std::invalid_argument(what);
  to.assign(from.begin(), from.end());
}

void set_custom(GraphProblem& problem, size_t index, const Rows& residual, const std::vector<Cubes>& jacobians) {
  FactorGroup& group = problem.group(index);
  const size_t size = group.count * static_cast<size_t>(group.rows);
  copy_into(group.residual, span_of(residual), size, "residuals of another shape");
  for (size_t a = 0; a < jacobians.size(); ++a)
    copy_into(group.jacobian.at(a), span_of(jacobians[a]), size * static_cast<size_t>(group.dof.at(a)), "Jacobians of another shape");
}

Tuple residuals(const GraphProblem& problem, size_t index) {
  const FactorGroup& group = problem.groups().at(index);
  std::vector<double> residual(group.count * static_cast<size_t>(group.rows)), squared(group.count);
  unlocked([&] { residuals_of_group(group, 0, group.count, problem.values().data(), residual.data(), squared.data()); });
  static TupleType type{"Residuals", "residual squared"};
  return named(type, to_numpy<double>(std::move(residual), {group.count, static_cast<size_t>(group.rows)}),
               to_numpy<double>(std::move(squared), {group.count}));
}

nb::typed<nb::tuple, nb::any, nb::ellipsis> jacobians(const GraphProblem& problem, size_t index) {
  const FactorGroup& group = problem.groups().at(index);
  std::vector<std::vector<double>> all(static_cast<size_t>(group.arity));
  std::vector<double*> pointers;
  for (size_t a = 0; a < all.size(); ++a) {
    all[a].resize(group.count * static_cast<size_t>(group.rows * group.dof[a]));
    pointers.push_back(all[a].data());
  }
  unlocked([&] { jacobians_of_group(group, 0, group.count, problem.values().data(), pointers.data()); });
  nb::list out;
  for (size_t a = 0; a < all.size(); ++a)
    out.append(to_numpy<double>(std::move(all[a]), {group.count, static_cast<size_t>(group.rows), static_cast<size_t>(group.dof[a])}));
  return Tuple(nb::tuple(out));
}

auto solve_for(const GraphProblem& problem, const Rows& right) {
  if (right.shape(1) != problem.tangent_size()) throw std::invalid_argument("right-hand sides of another size");
  std::vector<double> x(right.data(), right.data() + right.size());
  unlocked([&] { problem.solve_for(x); });
  return to_numpy<double>(std::move(x), {right.shape(0), right.shape(1)});
}

// The inverse of a problem's factor as it stands, asked for again and again.
struct GraphInverse {
  explicit GraphInverse(const GraphProblem& of) : problem(of), inverse(of.factorization()) {}
  const GraphProblem& problem;
  SelectedInverse inverse;
  std::mutex mutex;  // what it keeps grows with every call, and Python may call from several threads
};

// Blocks of the variables, one after another; all of them must be free.
auto covariance_blocks(GraphInverse& self, const Indices& variables) {
  const GraphProblem& problem = self.problem;
  std::vector<int32_t> nodes;
  for (const int32_t v : span_of(variables)) nodes.push_back(problem.nodes().node_of.at(static_cast<size_t>(v)));
  for (const int32_t node : nodes)
    if (node < 0) throw std::invalid_argument("a held variable has no block");
  std::vector<double> blocks = unlocked([&] {
    const std::scoped_lock lock(self.mutex);
    return self.inverse.blocks(nodes);
  });
  const size_t size = blocks.size();
  return to_numpy<double>(std::move(blocks), {size});
}

nb::typed<nb::dict, nb::str, nb::any> plan_facts(const GraphProblem& problem) {
  const Plan& plan = problem.plan();
  nb::typed<nb::dict, nb::str, nb::any> facts;
  facts["fronts"] = plan.fronts.size();
  facts["scalars"] = plan.scalars;
  facts["factor_doubles"] = plan.factor_size;
  facts["flops"] = plan.flops;
  facts["largest_rows"] = plan.largest_rows;
  facts["order"] = static_cast<int>(problem.order_used());
  return facts;
}

}  // namespace

void bind_graph_problem(nb::module_& m) {
  using namespace nb::literals;
  nb::class_<GraphProblem>(m, "GraphProblem")
      .def("__init__", [](GraphProblem* self, const Indices& code, const Indices& dof, const Stamps& count) {
             new (self) GraphProblem(families_of(code, dof, count));
           }, "code"_a.noconvert(), "dof"_a.noconvert(), "count"_a.noconvert())
      .def("add_group", &add_group, "type"_a, "variables"_a.noconvert(), "rows"_a, "measurement"_a.noconvert(), "noise"_a,
           "shared"_a, "sqrt_information"_a.noconvert(), "kernel"_a, "width"_a)
      .def("set_custom", &set_custom, "group"_a, "residual"_a.noconvert(), "jacobians"_a.noconvert())
      .def("set_weights", [](GraphProblem& p, size_t g, const Doubles& w) {
             copy_into(p.group(g).weight, span_of(w), p.group(g).count, "one weight a factor, or none", true);
           }, "group"_a, "weights"_a.noconvert())
      .def("set_shift", [](GraphProblem& p, size_t g, const Doubles& s) {
             copy_into(p.group(g).shift, span_of(s), p.group(g).count * static_cast<size_t>(p.group(g).rows), "one shift a row, or none", true);
           }, "group"_a, "shift"_a.noconvert())
      .def("set_noise", [](GraphProblem& p, size_t g, const Doubles& s) {
             copy_into(p.group(g).sqrt_information, span_of(s), p.group(g).sqrt_information.size(), "noise of another size");
           }, "group"_a, "sqrt_information"_a.noconvert())
      .def("hold", [](GraphProblem& p, const Indices& v) { p.hold(span_of(v)); }, "variables"_a.noconvert())
      .def("set_values", [](GraphProblem& p, const Doubles& x) { p.set_values(span_of(x)); }, "values"_a.noconvert())
      .def("values", [](const GraphProblem& p) { return copied(p.values()); })
      .def("candidate", [](const GraphProblem& p) { return copied(p.candidate()); })
      .def("step", [](const GraphProblem& p) { return copied(p.step()); })
      .def("set_step", [](GraphProblem& p, const Doubles& x) { p.set_step(span_of(x)); }, "step"_a.noconvert())
      .def("analyze", [](GraphProblem& p, int method) { unlocked([&] { p.analyze(static_cast<OrderMethod>(method)); }); }, "method"_a)
      .def("analyze_in", [](GraphProblem& p, const Indices& v) { unlocked([&] { p.analyze_in(span_of(v)); }); }, "variables"_a.noconvert())
      .def("elimination_order", [](const GraphProblem& p) {
             std::vector<int32_t> order = p.elimination_order();
             const size_t n = order.size();
             return to_numpy<int32_t>(std::move(order), {n});
           })
      .def("linearize", [](GraphProblem& p, int threads) { return costs(unlocked([&] { return p.linearize(threads); })); }, "threads"_a)
      .def("cost", [](const GraphProblem& p, bool candidate, int threads) {
             return costs(unlocked([&] { return p.cost(candidate, threads); }));
           }, "candidate"_a, "threads"_a)
      .def("factorize", [](GraphProblem& p, double damping, double floor, int threads) {
             return unlocked([&] { return p.factorize(damping, floor, threads); });
           }, "damping"_a, "floor"_a, "threads"_a)
      .def("solve", [](GraphProblem& p, double damping, double floor) { return unlocked([&] { return p.solve(damping, floor); }); },
           "damping"_a, "floor"_a)
      .def("solve_for", &solve_for, "right"_a.noconvert())
      .def("gradient", [](const GraphProblem& p) { return copied(p.gradient()); })
      .def("diagonal", [](const GraphProblem& p) { return copied(p.diagonal()); })
      .def("multiply", [](const GraphProblem& p, const Doubles& v) { return copied(unlocked([&] { return p.multiply(span_of(v)); })); }, "v"_a.noconvert())
      .def("retract", [](GraphProblem& p) { unlocked([&] { p.retract(); }); })
      .def("accept", &GraphProblem::accept)
      .def("residuals", &residuals, "group"_a)
      .def("jacobians", &jacobians, "group"_a)
      .def("blocks", [](const GraphProblem& p) { return copied(p.blocks()); })
      .def("plan", &plan_facts);
  nb::class_<GraphInverse>(m, "GraphInverse")
      .def(nb::init<const GraphProblem&>(), "problem"_a, nb::keep_alive<1, 2>())
      .def("covariance_blocks", &covariance_blocks, "variables"_a.noconvert());
}

}  // namespace heliograph
