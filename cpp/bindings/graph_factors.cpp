// SPDX-License-Identifier: MIT
// Factors and retractions one kind at a time, for the tests.
#include <string>

#include "bindings/bindings.hpp"
#include "graph/factors/covariance_root.hpp"
#include "graph/factors/make_group.hpp"
#include "graph/factors/pack.hpp"

namespace heliograph {

namespace {

using Doubles = Array<const double, nb::shape<-1>>;
using Rows = Array<const double, nb::ndim<2>>;
using Families = Array<const int64_t, nb::shape<-1, 3>>;  // (families, [manifold, dof, count])
using Indices = Array<const int32_t, nb::ndim<2>>;

void require(bool holds, const char* message) {
  if (!holds) throw std::invalid_argument(message);
}

FamilyBlock family(int64_t manifold, int64_t dof, int64_t count) {
  constexpr int kDof[] = {0, 1, 3, 3, 6, 2, 9};
  require(manifold >= 0 && manifold <= 6, "no such manifold");
  require(dof >= 1 && dof <= kMaxDof && (manifold == 0 || dof == kDof[manifold]), "the family has another dimension");
  FamilyBlock block;
  block.manifold = static_cast<Manifold>(manifold);
  block.dof = static_cast<int>(dof);
  block.storage = storage_of(block.manifold, block.dof);
  block.count = static_cast<size_t>(count);
  return block;
}

// Blocks one behind the other, in the order given.
std::vector<FamilyBlock> stack(const Families& families, size_t values) {
  std::vector<FamilyBlock> blocks;
  size_t first = 0, value = 0, tangent = 0;
  for (size_t i = 0; i < families.shape(0); ++i) {
    const int64_t* f = families.data() + 3 * i;
    FamilyBlock block = family(f[0], f[1], f[2]);
    block.first = first;
    block.value = value;
    block.tangent = tangent;
    first += block.count;
    value += block.count * static_cast<size_t>(block.storage);
    tangent += block.count * static_cast<size_t>(block.dof);
    blocks.push_back(block);
  }
  require(value == values, "the values do not fill the families");
  return blocks;
}

std::vector<double> optional(const Doubles& values, size_t size) {
  require(values.size() == 0 || values.size() == size, "weights or shifts do not match the factors");
  return {values.data(), values.data() + values.size()};
}

// Rows of [r J_0 J_1 ...] side by side, as custom factors hand them in.
void fill_custom(const Doubles& custom, FactorGroup* group) {
  size_t columns = 1;
  for (size_t a = 0; a < static_cast<size_t>(group->arity); ++a) columns += static_cast<size_t>(group->dof[a]);
  require(custom.size() == group->residual.size() * columns, "custom residuals and Jacobians have the wrong size");
  const double* from = custom.data();
  for (size_t i = 0; i < group->residual.size(); ++i) {
    group->residual[i] = *from++;
    for (size_t a = 0; a < static_cast<size_t>(group->arity); ++a) {
      const auto dof = static_cast<size_t>(group->dof[a]);
      for (size_t q = 0; q < dof; ++q) group->jacobian[a][i * dof + q] = *from++;
    }
  }
}

// Everything that a group evaluates to: residuals, squared lengths, Jacobians by variable, blocks, and chi2 and cost as
// linearisation and as cost alone give them.
Tuple evaluate(const FactorGroup& group, const double* x) {
  const size_t n = group.count, rows = static_cast<size_t>(group.rows), size = block_size(group);
  std::vector<double> residual(n * rows), squared(n), blocks(n * size), jacobians[kMaxArity];
  double* jacobian[kMaxArity] = {};
  for (size_t a = 0; a < static_cast<size_t>(group.arity); ++a) {
    jacobians[a].resize(n * rows * static_cast<size_t>(group.dof[a]));
    jacobian[a] = jacobians[a].data();
  }
  GroupCost linearized, cost;
  {
    nb::gil_scoped_release release;
    residuals_of_group(group, 0, n, x, residual.data(), squared.data());
    jacobians_of_group(group, 0, n, x, jacobian);
    linearized = linearize_group(group, 0, n, x, blocks.data());
    cost = cost_of_group(group, 0, n, x);
  }
  nb::list by_variable;
  for (size_t a = 0; a < static_cast<size_t>(group.arity); ++a)
    by_variable.append(to_numpy<double>(std::move(jacobians[a]), {n, rows, static_cast<size_t>(group.dof[a])}));
  static TupleType type{"Evaluation", "residual squared jacobians blocks linearized_chi2 linearized_cost chi2 cost"};
  return named(type, to_numpy<double>(std::move(residual), {n, rows}), to_numpy<double>(std::move(squared), {n}),
               by_variable, to_numpy<double>(std::move(blocks), {n, size}), linearized.chi2, linearized.cost,
               cost.chi2, cost.cost);
}

Tuple evaluate_factors(int type, const Families& families, const Doubles& x, const Indices& variables, int rows,
                       const Doubles& measurement, int noise, bool shared_noise, const Doubles& sqrt_information, int kernel,
                       double kernel_width, const Doubles& weight, const Doubles& shift, const Doubles& custom) {
  require(noise >= 0 && noise <= 2 && kernel >= 0 && kernel <= 6, "no such code");
  GroupInput input;
  input.type = static_cast<FactorType>(type);
  input.arity = static_cast<int>(variables.shape(1));
  input.rows = rows;
  input.variables = span_of(variables);
  input.measurement = span_of(measurement);
  input.noise = static_cast<NoiseForm>(noise);
  input.shared_noise = shared_noise;
  input.sqrt_information = span_of(sqrt_information);
  input.kernel = static_cast<KernelType>(kernel);
  input.kernel_width = kernel_width;
  FactorGroup group = make_group(input, stack(families, x.size()));
  group.weight = optional(weight, group.count);
  group.shift = optional(shift, group.count * static_cast<size_t>(group.rows));
  fill_custom(custom, &group);
  return evaluate(group, x.data());
}

nb::ndarray<nb::numpy, double, nb::ndim<2>> retract(int manifold, const Rows& x, const Rows& delta) {
  FamilyBlock block = family(manifold, static_cast<int64_t>(delta.shape(1)), static_cast<int64_t>(delta.shape(0)));
  require(x.shape(0) == delta.shape(0) && x.shape(1) == static_cast<size_t>(block.storage), "one tangent a value is needed");
  std::vector<double> out(x.size());
  {
    nb::gil_scoped_release release;
    retract_block(block, x.data(), delta.data(), out.data());
  }
  return to_numpy<double, nb::ndim<2>>(std::move(out), {x.shape(0), x.shape(1)});
}

using Single = nb::ndarray<const double, nb::device::cpu>;

// One value into `out`, if there is room for it; false where it is not on its manifold.
bool pack_into(int manifold, const Single& x, double* out, size_t room) {
  const auto family = static_cast<Manifold>(manifold);
  const bool matrix = family != Manifold::vector && family != Manifold::s2;
  require(x.ndim() == (matrix ? 2U : 1U), "a value of another shape");
  const int dof = matrix ? 0 : static_cast<int>(x.shape(0)), storage = storage_of(family, dof);
  const size_t needed = matrix ? (family == Manifold::so2 ? 2U : 3U) + (storage == 12 ? 1U : 0U) + (storage == 15 ? 2U : 0U) : 0U;
  require(!matrix || (x.shape(0) == needed && x.shape(1) == needed), "a value of another shape");
  require(room == 0 || room == static_cast<size_t>(storage), "room of another size");
  double own[kMaxDof];
  require(storage <= kMaxDof, "a vector of more than 16 numbers");
  return pack_single(family, dof, x.data(), x.stride(0), matrix ? x.stride(1) : 0, room == 0 ? own : out);
}

// Roots (N, rows, rows) of covariances, and the first that has none, or -1.
Tuple covariance_roots(const Array<const double, nb::ndim<3>>& P) {
  const size_t n = P.shape(0), rows = P.shape(1);
  require(P.shape(2) == rows, "covariances are square");
  std::vector<double> S(P.size());
  const int64_t failed = unlocked([&] {
    for (size_t k = 0; k < n; ++k)
      if (!covariance_root(P.data() + k * rows * rows, static_cast<int>(rows), S.data() + k * rows * rows)) return static_cast<int64_t>(k);
    return int64_t{-1};
  });
  static TupleType type{"CovarianceRoots", "roots failed"};
  return named(type, to_numpy<double>(std::move(S), {n, rows, rows}), failed);
}

}  // namespace

void bind_graph_retraction(nb::module_& m) {
  using namespace nb::literals;
  m.def("retract_values", &retract, "manifold"_a, "values"_a.noconvert(), "delta"_a.noconvert());
}

void bind_graph_factors(nb::module_& m) {
  using namespace nb::literals;
  m.def("covariance_roots", &covariance_roots, "P"_a.noconvert());
  m.def("pack_single", [](int manifold, const Single& x, const Array<double, nb::ndim<2>>& out) {
    return pack_into(manifold, x, out.data(), out.size());
  }, "manifold"_a, "value"_a.noconvert(), "out"_a.noconvert());
  m.def("is_sound", [](int manifold, const Single& x) { return pack_into(manifold, x, nullptr, 0); }, "manifold"_a,
        "value"_a.noconvert());
  m.def("evaluate_factors", &evaluate_factors, "type"_a, "families"_a.noconvert(), "values"_a.noconvert(),
        "variables"_a.noconvert(), "rows"_a, "measurement"_a.noconvert(), "noise"_a, "shared_noise"_a,
        "sqrt_information"_a.noconvert(), "kernel"_a, "kernel_width"_a, "weight"_a.noconvert(), "shift"_a.noconvert(),
        "custom"_a.noconvert());
}

}  // namespace heliograph
