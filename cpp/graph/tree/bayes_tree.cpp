// SPDX-License-Identifier: MIT
#include "graph/tree/bayes_tree.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "graph/factors/make_group.hpp"
#include "util/isa.hpp"

namespace heliograph {

namespace {

FrontKernels kernels() {
#if defined(HELIOGRAPH_HAVE_AVX2)
  if (active_isa() == Isa::avx2) return avx2_front_kernels();
#endif
  return baseline_front_kernels();
}

// Writes row `index` of a stacked array, one past its end included.
template <typename T>
void put(std::vector<T>& stack, size_t index, const T* row, size_t width) {
  if (stack.size() < (index + 1) * width) stack.resize((index + 1) * width);
  std::copy_n(row, width, stack.begin() + static_cast<std::ptrdiff_t>(index * width));
}

constexpr int kFamilies = 7 * (kMaxDof + 1);

size_t family_of(Manifold manifold, int dof) { return static_cast<size_t>(static_cast<int>(manifold) * (kMaxDof + 1) + dof); }

void require(bool condition, const char* message) {
  if (!condition) throw std::invalid_argument(message);
}

}  // namespace

BayesTree::BayesTree() : kernels_(kernels()), scratch_(static_cast<size_t>(kScratch)) {
  free_variables_.resize(static_cast<size_t>(kFamilies));
}

std::vector<int32_t> BayesTree::add_variables(Manifold manifold, int dof, std::span<const double> packed) {
  const auto storage = static_cast<size_t>(storage_of(manifold, dof));
  require(dof > 0 && dof <= kMaxDof && packed.size() % storage == 0, "values of another size");
  std::vector<int32_t> numbers, &free = free_variables_[family_of(manifold, dof)];
  for (size_t i = 0; i < packed.size() / storage; ++i) {
    if (free.empty()) {
      free.push_back(static_cast<int32_t>(dof_.size()));
      ++free_count_;
      ++grown_;
      manifold_.push_back(manifold);
      dof_.push_back(dof);
      theta_at_.push_back(static_cast<int64_t>(theta_.size()));
      delta_at_.push_back(static_cast<int64_t>(delta_.size()));
      theta_.resize(theta_.size() + storage);
      delta_.resize(delta_.size() + static_cast<size_t>(dof), 0.0);
      clique_of_.push_back(-1);
      changed_.push_back(0);
      for (std::vector<uint8_t>* flags : {&fluid_flag_, &touched_flag_, &held_, &frozen_}) flags->push_back(0);
    }
    const int32_t variable = free.back();
    free.pop_back();
    --free_count_;
    std::copy_n(packed.data() + i * storage, storage, theta_.begin() + theta_at_[static_cast<size_t>(variable)]);
    fresh_.push_back(variable);
    numbers.push_back(variable);
  }
  return numbers;
}

// Its number may be given again: nothing speaks of it any more.
void BayesTree::free_variable(int32_t variable) {
  const auto v = static_cast<size_t>(variable);
  if (std::exchange(fluid_flag_[v], 0) != 0) std::erase(fluid_, variable);
  std::fill_n(delta_.begin() + delta_at_[v], dof_[v], 0.0);
  clique_of_[v] = -1;
  changed_[v] = 0;
  held_[v] = frozen_[v] = 0;
  free_variables_[family_of(manifold_[v], dof_[v])].push_back(variable);
  ++free_count_;
}

void BayesTree::hold(std::span<const int32_t> variables) {
  for (const int32_t v : variables) {
    require(std::find(fresh_.begin(), fresh_.end(), v) != fresh_.end(), "only new variables can be held");
    held_[static_cast<size_t>(v)] = 1;
  }
}

int32_t BayesTree::add_kind(FactorType type, std::span<const int32_t> manifolds, std::span<const int32_t> dofs, int rows,
                            NoiseForm noise, KernelType kernel, double width) {
  require(!manifolds.empty() && manifolds.size() <= kMaxArity && manifolds.size() == dofs.size(), "one family a variable");
  FactorGroup kind;
  kind.type = type;
  kind.arity = static_cast<int>(manifolds.size());
  for (size_t a = 0; a < manifolds.size(); ++a) {
    kind.manifold[a] = static_cast<Manifold>(manifolds[a]);
    kind.dof[a] = dofs[a];
    kind.storage[a] = storage_of(kind.manifold[a], dofs[a]);
  }
  const FactorShape shape = shape_of(type, {kind.manifold.data(), manifolds.size()}, {kind.dof.data(), manifolds.size()});
  require(shape.known, "no residual is known for this factor type and its families");
  kind.rows = type == FactorType::custom ? rows : shape.rows;
  kind.measurement_size = shape.measurement;
  kind.noise = noise;
  kind.kernel = kernel;
  kind.kernel_width = width;
  kinds_.push_back(std::move(kind));
  free_rows_.emplace_back();
  return static_cast<int32_t>(kinds_.size()) - 1;
}

std::vector<int32_t> BayesTree::add_factors(int32_t index, std::span<const int32_t> variables,
                                            std::span<const double> measurement, std::span<const double> sqrt_information) {
  FactorGroup& kind = kinds_.at(static_cast<size_t>(index));
  const auto arity = static_cast<size_t>(kind.arity), size = static_cast<size_t>(kind.measurement_size);
  const size_t numbers = noise_numbers(kind.noise, kind.rows), count = variables.size() / arity;
  require(variables.size() == count * arity && measurement.size() == count * size, "factors of another size");
  require(sqrt_information.size() == count * numbers || sqrt_information.size() == numbers, "noise of another size");
  const bool shared = sqrt_information.size() == numbers;
  for (const int32_t v : variables) require(v >= 0 && static_cast<size_t>(v) < dof_.size(), "a variable that there is not");
  std::vector<int32_t> added;
  for (size_t i = 0; i < count; ++i) {
    std::vector<int32_t>& free_rows = free_rows_[static_cast<size_t>(index)];
    const size_t row = free_rows.empty() ? kind.count++ : static_cast<size_t>(free_rows.back());
    if (!free_rows.empty()) free_rows.pop_back();
    const int32_t* scope = variables.data() + i * arity;
    std::array<int64_t, kMaxArity> offsets{};
    for (size_t a = 0; a < arity; ++a) {
      offsets[a] = theta_at_[static_cast<size_t>(scope[a])];
      touch(scope[a]);
    }
    put(kind.variables, row, scope, arity);
    put(kind.values, row, offsets.data(), arity);
    put(kind.measurement, row, measurement.data() + i * size, size);
    put(kind.sqrt_information, row, sqrt_information.data() + (shared ? 0 : i * numbers), numbers);
    const double one = 1.0;
    if (!kind.weight.empty()) put(kind.weight, row, &one, 1);
    int32_t number = static_cast<int32_t>(factors_.size());
    if (free_factors_.empty()) {
      factors_.emplace_back();
    } else {
      number = free_factors_.back();
      free_factors_.pop_back();
    }
    factors_[static_cast<size_t>(number)] = {index, static_cast<int32_t>(row), -1, -1, factor_blocks_.take(block_size(kind)), 1, 0};
    loose_.push_back(number);
    added.push_back(number);
  }
  return added;
}

void BayesTree::remove_factors(std::span<const int32_t> numbers) {
  for (const int32_t f : numbers)
    require(has_factors({&f, 1}) && factors_[static_cast<size_t>(f)].removed == 0, "a factor that there is not");
  indivisible_ = indivisible_ || !numbers.empty();
  for (const int32_t f : numbers) {
    TreeFactor& factor = factors_[static_cast<size_t>(f)];
    factor.removed = 1;
    removed_.push_back(f);
    const FactorGroup& kind = kinds_[static_cast<size_t>(factor.kind)];
    for (int a = 0; a < kind.arity; ++a)
      touch(kind.variables[static_cast<size_t>(factor.index) * static_cast<size_t>(kind.arity) + static_cast<size_t>(a)]);
  }
}

bool BayesTree::has_factors(std::span<const int32_t> numbers) const {
  return std::all_of(numbers.begin(), numbers.end(), [&](int32_t f) {
    return f >= 0 && static_cast<size_t>(f) < factors_.size() && factors_[static_cast<size_t>(f)].kind >= 0;
  });
}

void BayesTree::weigh_factors(std::span<const int32_t> numbers, std::span<const double> weights) {
  require(numbers.size() == weights.size() && has_factors(numbers), "one weight a factor that there is");
  indivisible_ = indivisible_ || !numbers.empty();
  for (size_t i = 0; i < numbers.size(); ++i) {
    TreeFactor& factor = factors_[static_cast<size_t>(numbers[i])];
    FactorGroup& kind = kinds_[static_cast<size_t>(factor.kind)];
    if (kind.weight.empty()) kind.weight.assign(kind.count, 1.0);
    weighed_.push_back({numbers[i], kind.weight[static_cast<size_t>(factor.index)]});
    kind.weight[static_cast<size_t>(factor.index)] = weights[i];
    factor.stale = 1;
    for (int a = 0; a < kind.arity; ++a)
      touch(kind.variables[static_cast<size_t>(factor.index) * static_cast<size_t>(kind.arity) + static_cast<size_t>(a)]);
  }
}

void BayesTree::drop_factor(int32_t number) {
  TreeFactor& factor = factors_[static_cast<size_t>(number)];
  if (factor.kind < 0) return;
  FactorGroup& kind = kinds_[static_cast<size_t>(factor.kind)];
  factor_blocks_.give_back(factor.block, block_size(kind));
  free_rows_[static_cast<size_t>(factor.kind)].push_back(factor.index);
  factor = TreeFactor{};
  free_factors_.push_back(number);
}

std::vector<int32_t> BayesTree::stale_factors(int32_t kind) const {
  std::vector<int32_t> out;
  for (const int32_t f : open_factors_)
    if (factors_[static_cast<size_t>(f)].kind == kind && factors_[static_cast<size_t>(f)].stale != 0) out.push_back(f);
  return out;
}

void BayesTree::set_custom(std::span<const int32_t> numbers, std::span<const double> residual,
                           const std::vector<std::span<const double>>& jacobians) {
  for (size_t i = 0; i < numbers.size(); ++i) {
    const TreeFactor& factor = factors_.at(static_cast<size_t>(numbers[i]));
    FactorGroup& kind = kinds_.at(static_cast<size_t>(factor.kind));
    const auto row = static_cast<size_t>(factor.index), rows = static_cast<size_t>(kind.rows);
    put(kind.residual, row, residual.data() + i * rows, rows);
    for (size_t a = 0; a < jacobians.size(); ++a) {
      const size_t size = rows * static_cast<size_t>(kind.dof[a]);
      put(kind.jacobian[a], row, jacobians[a].data() + i * size, size);
    }
  }
}

std::vector<double> BayesTree::linearization_point(std::span<const int32_t> variables) const {
  std::vector<double> out;
  for (const int32_t variable : variables) {
    const auto v = static_cast<size_t>(variable);
    const auto at = theta_.begin() + theta_at_.at(v);
    out.insert(out.end(), at, at + storage_of(manifold_[v], dof_[v]));
  }
  return out;
}

double BayesTree::longest_element(int32_t variable) const {
  const auto v = static_cast<size_t>(variable);
  double longest = 0.0;
  for (int k = 0; k < dof_[v]; ++k) longest = std::max(longest, std::abs(delta_[static_cast<size_t>(delta_at_[v] + k)]));
  return longest;
}

double BayesTree::largest_step() const {
  double largest = 0.0;
  for (size_t v = 0; v < dof_.size(); ++v)  // a frozen one's step is no sign of an estimate that has yet to settle
    if (frozen_[v] == 0) largest = std::max(largest, longest_element(static_cast<int32_t>(v)));
  return largest;
}

GroupCost BayesTree::cost() const {
  std::vector<double> x(theta_);
  for (size_t v = 0; v < dof_.size(); ++v) {
    const FamilyBlock block{manifold_[v], dof_[v], storage_of(manifold_[v], dof_[v]), 1, 0, 0, 0};
    retract_block(block, theta_.data() + theta_at_[v], delta_.data() + delta_at_[v], x.data() + theta_at_[v]);
  }
  GroupCost total;
  for (const TreeFactor& factor : factors_) {
    if (factor.kind < 0) continue;
    const auto index = static_cast<size_t>(factor.index);
    const GroupCost cost = cost_of_group(kinds_[static_cast<size_t>(factor.kind)], index, index + 1, x.data());
    total.chi2 += cost.chi2;
    total.cost += cost.cost;
  }
  return total;
}

size_t BayesTree::bytes() const {
  size_t doubles = factor_blocks_.held() + clique_blocks_.held() + theta_.capacity() + delta_.capacity();
  size_t other = cliques_.capacity() * sizeof(Clique) + factors_.capacity() * sizeof(TreeFactor);
  for (const Clique& clique : cliques_) other += clique.nodes.capacity() * sizeof(int32_t);
  for (const FactorGroup& kind : kinds_) {
    doubles += kind.measurement.capacity() + kind.sqrt_information.capacity() + kind.weight.capacity() + kind.values.capacity();
    other += kind.variables.capacity() * sizeof(int32_t);
  }
  other += dof_.capacity() * (3 * sizeof(int32_t) + sizeof(Manifold) + 2 * sizeof(int64_t) + 2 + sizeof(uint32_t));
  return doubles * sizeof(double) + other;
}

}  // namespace heliograph
