// SPDX-License-Identifier: MIT
// The factors of a Bayes tree, by kind, with their linearised blocks and the cliques that they were assembled in.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "graph/cholesky/block_pool.hpp"
#include "graph/factors/residual_kind.hpp"
#include "graph/tree/variables.hpp"

namespace heliograph {

struct TreeFactor {
  int32_t kind = -1;
  int32_t index = 0;     // in its kind
  int32_t clique = -1;   // -1: not assembled yet
  int32_t next = -1;     // in its clique's list
  double* block = nullptr;
  uint8_t stale = 0;     // has to be linearised
  uint8_t removed = 0;   // by the update that is under way
  uint8_t let_go = 0;    // keeps its number and says nothing: it is in no clique, and joins nothing in the ordering

  bool speaks() const { return removed == 0 && let_go == 0; }
};

// Same residual, families, noise form and kernel: what factors of one kind share.
struct FactorKind {
  FactorType type = FactorType::custom;
  std::span<const int32_t> manifolds, dofs;
  int rows = 0;
  NoiseForm noise = NoiseForm::scalar;
  KernelType kernel = KernelType::none;
  double width = 1.0;
  int measurement = kAnySize;  // doubles of one
};

// Numbers of factors, and rows in their kinds, are given again when a factor has left.
class TreeFactors {
 public:
  int32_t add_kind(const FactorKind& kind);
  // Stale, and in no clique. One `sqrt_information` each, or one for all.
  std::vector<int32_t> add(int32_t kind, std::span<const int32_t> scopes, std::span<const double> measurement,
                           std::span<const double> sqrt_information, const TreeVariables& variables);
  void drop(int32_t factor);

  bool has(std::span<const int32_t> factors) const;
  size_t count() const { return factors_.size() - free_.size(); }
  bool has_kinds() const { return !kinds_.empty(); }
  const std::vector<FactorGroup>& kinds() const { return kinds_; }
  const std::vector<TreeFactor>& all() const { return factors_; }  // those of no kind are not in use
  TreeFactor& operator[](int32_t factor) { return factors_[at(factor)]; }
  const TreeFactor& operator[](int32_t factor) const { return factors_[at(factor)]; }
  const FactorGroup& kind_of(const TreeFactor& factor) const { return kinds_[at(factor.kind)]; }
  std::span<const int32_t> scope(const TreeFactor& factor) const {
    const auto arity = static_cast<size_t>(kind_of(factor).arity);
    return {kind_of(factor).variables.data() + at(factor.index) * arity, arity};
  }
  size_t block_doubles(const TreeFactor& factor) const { return block_size(kind_of(factor)); }

  void linearize(int32_t factor, const double* theta);
  double set_weight(int32_t factor, double weight);  // returns the old one
  void set_custom(std::span<const int32_t> factors, std::span<const double> residual,
                  const std::vector<std::span<const double>>& jacobians);
  GroupCost cost(const double* values) const;  // of those that are not let go
  // A factor alone, of weight one and without kernel, whose values lie one after another.
  FactorGroup alone(int32_t factor) const;
  size_t bytes() const;

  struct Stored {
    std::vector<FactorGroup>& kinds;
    std::vector<std::vector<int32_t>>& free_rows;
    std::vector<TreeFactor>& factors;
    std::vector<int32_t>& free;
    BlockPool& blocks;
  };
  Stored stored() { return {kinds_, free_rows_, factors_, free_, blocks_}; }

 private:
  static size_t at(int32_t index) { return static_cast<size_t>(index); }
  int32_t next_number();

  std::vector<FactorGroup> kinds_;
  std::vector<std::vector<int32_t>> free_rows_;  // by kind
  std::vector<TreeFactor> factors_;
  std::vector<int32_t> free_;
  BlockPool blocks_;
};

}  // namespace heliograph
