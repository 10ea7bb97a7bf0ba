// SPDX-License-Identifier: MIT
#include "graph/tree/factors.hpp"

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "graph/factors/make_group.hpp"

namespace heliograph {

namespace {

// Writes row `index` of a stacked array, one past its end included.
template <typename T>
void put(std::vector<T>& stack, size_t index, const T* row, size_t width) {
  if (stack.size() < (index + 1) * width) stack.resize((index + 1) * width);
  std::copy_n(row, width, stack.begin() + static_cast<std::ptrdiff_t>(index * width));
}

void require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(message);
}

}  // namespace

int32_t TreeFactors::add_kind(const FactorKind& input) {
  const size_t arity = input.manifolds.size();
  require(arity > 0 && arity <= kMaxArity && arity == input.dofs.size(), "one family a variable");
  FactorGroup kind;
  kind.type = input.type;
  kind.arity = static_cast<int>(arity);
  for (size_t a = 0; a < arity; ++a) {
    kind.manifold[a] = static_cast<Manifold>(input.manifolds[a]);
    kind.dof[a] = input.dofs[a];
    kind.storage[a] = storage_of(kind.manifold[a], input.dofs[a]);
  }
  const ShapeQuery query{{kind.manifold.data(), arity}, {kind.dof.data(), arity}, input.rows, input.measurement};
  const FactorShape shape = shape_of(input.type, query);
  require(shape.known, "no residual is known for this factor type and its families");
  kind.rows = shape.rows;
  kind.measurement_size = shape.measurement;
  kind.noise = input.noise;
  kind.kernel = input.kernel;
  kind.kernel_width = input.width;
  kinds_.push_back(std::move(kind));
  free_rows_.emplace_back();
  return static_cast<int32_t>(kinds_.size()) - 1;
}

int32_t TreeFactors::next_number() {
  if (free_.empty()) {
    factors_.emplace_back();
    return static_cast<int32_t>(factors_.size()) - 1;
  }
  const int32_t number = free_.back();
  free_.pop_back();
  return number;
}

std::vector<int32_t> TreeFactors::add(int32_t index, std::span<const int32_t> scopes, std::span<const double> measurement,
                                      std::span<const double> sqrt_information, const TreeVariables& variables) {
  require(index >= 0 && at(index) < kinds_.size(), "a kind that there is not");
  FactorGroup& kind = kinds_[at(index)];
  const auto arity = static_cast<size_t>(kind.arity), size = static_cast<size_t>(kind.measurement_size);
  const size_t numbers = noise_numbers(kind.noise, kind.rows), count = scopes.size() / arity;
  require(scopes.size() == count * arity && measurement.size() == count * size, "factors of another size");
  require(sqrt_information.size() == count * numbers || sqrt_information.size() == numbers, "noise of another size");
  const bool shared = sqrt_information.size() == numbers;
  for (const int32_t v : scopes) require(variables.has_slot(v), "a variable that there is not");
  std::vector<int32_t> added;
  std::vector<int32_t>& free_rows = free_rows_[at(index)];
  for (size_t i = 0; i < count; ++i) {
    const size_t row = free_rows.empty() ? kind.count++ : at(free_rows.back());
    if (!free_rows.empty()) free_rows.pop_back();
    const int32_t* scope = scopes.data() + i * arity;
    std::array<int64_t, kMaxArity> offsets{};
    for (size_t a = 0; a < arity; ++a) offsets[a] = variables.theta_offset(scope[a]);
    put(kind.variables, row, scope, arity);
    put(kind.values, row, offsets.data(), arity);
    put(kind.measurement, row, measurement.data() + i * size, size);
    put(kind.sqrt_information, row, sqrt_information.data() + (shared ? 0 : i * numbers), numbers);
    const double one = 1.0;
    if (!kind.weight.empty()) put(kind.weight, row, &one, 1);
    added.push_back(next_number());
    factors_[at(added.back())] = {index, static_cast<int32_t>(row), -1, -1, blocks_.take(block_size(kind)), 1, 0, 0};
  }
  return added;
}

void TreeFactors::drop(int32_t number) {
  TreeFactor& factor = factors_[at(number)];
  if (factor.kind < 0) return;
  blocks_.give_back(factor.block, block_doubles(factor));
  free_rows_[at(factor.kind)].push_back(factor.index);
  factor = TreeFactor{};
  free_.push_back(number);
}

bool TreeFactors::has(std::span<const int32_t> numbers) const {
  return std::all_of(numbers.begin(), numbers.end(),
                     [&](int32_t f) { return f >= 0 && at(f) < factors_.size() && factors_[at(f)].kind >= 0; });
}

void TreeFactors::linearize(int32_t number, const double* theta) {
  TreeFactor& factor = factors_[at(number)];
  const size_t index = at(factor.index);
  linearize_group(kind_of(factor), index, index + 1, theta, factor.block);
  factor.stale = 0;
}

double TreeFactors::set_weight(int32_t number, double weight) {
  const TreeFactor& factor = factors_[at(number)];
  FactorGroup& kind = kinds_[at(factor.kind)];
  if (kind.weight.empty()) kind.weight.assign(kind.count, 1.0);
  return std::exchange(kind.weight[at(factor.index)], weight);
}

void TreeFactors::set_custom(std::span<const int32_t> numbers, std::span<const double> residual,
                             const std::vector<std::span<const double>>& jacobians) {
  require(has(numbers), "a factor that there is not");
  for (size_t i = 0; i < numbers.size(); ++i) {
    const TreeFactor& factor = factors_[at(numbers[i])];
    FactorGroup& kind = kinds_[at(factor.kind)];
    const auto row = static_cast<size_t>(factor.index), rows = static_cast<size_t>(kind.rows);
    require(residual.size() >= (i + 1) * rows && jacobians.size() <= kMaxArity, "residuals of another size");
    put(kind.residual, row, residual.data() + i * rows, rows);
    for (size_t a = 0; a < jacobians.size(); ++a) {
      const size_t size = rows * static_cast<size_t>(kind.dof[a]);
      require(jacobians[a].size() >= (i + 1) * size, "Jacobians of another size");
      put(kind.jacobian[a], row, jacobians[a].data() + i * size, size);
    }
  }
}

GroupCost TreeFactors::cost(const double* values) const {
  GroupCost total;
  for (const TreeFactor& factor : factors_) {
    if (factor.kind < 0 || factor.let_go != 0) continue;
    const GroupCost cost = cost_of_group(kind_of(factor), at(factor.index), at(factor.index) + 1, values);
    total.chi2 += cost.chi2;
    total.cost += cost.cost;
  }
  return total;
}

FactorGroup TreeFactors::alone(int32_t number) const {
  const TreeFactor& factor = factors_[at(number)];
  const FactorGroup& kind = kind_of(factor);
  require(kind.type != FactorType::custom, "a factor that is not evaluated here");
  FactorGroup out;
  out.type = kind.type;
  out.arity = kind.arity;
  out.rows = kind.rows;
  out.manifold = kind.manifold;
  out.dof = kind.dof;
  out.storage = kind.storage;
  out.count = 1;
  out.measurement_size = kind.measurement_size;
  out.noise = kind.noise;
  const auto row = [&](const std::vector<double>& stack, size_t width) {
    const auto first = stack.begin() + static_cast<std::ptrdiff_t>(at(factor.index) * width);
    return std::vector<double>(first, first + static_cast<std::ptrdiff_t>(width));
  };
  out.measurement = row(kind.measurement, static_cast<size_t>(kind.measurement_size));
  out.sqrt_information = row(kind.sqrt_information, noise_numbers(kind.noise, kind.rows));
  int64_t offset = 0;
  for (int a = 0; a < kind.arity; ++a) {
    out.variables.push_back(a);
    out.values.push_back(offset);
    offset += kind.storage[static_cast<size_t>(a)];
  }
  return out;
}

size_t TreeFactors::bytes() const {
  size_t doubles = blocks_.held(), other = factors_.capacity() * sizeof(TreeFactor);
  for (const FactorGroup& kind : kinds_) {
    doubles += kind.measurement.capacity() + kind.sqrt_information.capacity() + kind.weight.capacity() + kind.values.capacity();
    other += kind.variables.capacity() * sizeof(int32_t);
  }
  return doubles * sizeof(double) + other;
}

}  // namespace heliograph
