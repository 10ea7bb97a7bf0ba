// SPDX-License-Identifier: MIT
// A graph flattened for solving: stacked values, stacked factors, their linearisation, and the plan and factor of its normal
// equations. What to do with it, and when to stop, is the caller's policy.
#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "graph/factors/factor_group.hpp"
#include "graph/cholesky/multifrontal.hpp"
#include "graph/cholesky/plan.hpp"

namespace heliograph {

enum class OrderMethod : int32_t { automatic = 0, minimum_degree = 1, nested_dissection = 2, natural = 3 };

class GraphProblem {
 public:
  // Families whose `first`, `value` and `tangent` offsets this fills in.
  explicit GraphProblem(std::vector<FamilyBlock> families);

  size_t add_group(FactorGroup group);
  FactorGroup& group(size_t index) { return groups_.at(index); }
  const std::vector<FactorGroup>& groups() const { return groups_; }
  const std::vector<FamilyBlock>& families() const { return families_; }
  size_t variables() const { return variable_tangent_.size(); }
  size_t tangent_size() const { return tangent_size_; }
  bool held(size_t variable) const { return held_[variable] != 0; }
  int dof_of(size_t variable) const { return variable_dof_[variable]; }
  int64_t tangent_of(size_t variable) const { return variable_tangent_[variable]; }

  // Holds variables at their values: they are not estimated.
  void hold(std::span<const int32_t> variables);
  void set_values(std::span<const double> values);
  std::span<const double> values() const { return values_; }
  std::span<const double> candidate() const { return candidate_; }

  // Orders the elimination and plans the fronts. Factors, families and held variables must not change afterwards.
  void analyze(OrderMethod method);
  // In an order that is known already, such as a problem's of the same structure; free variables missing from it come last.
  void analyze_in(std::span<const int32_t> variables);
  // Free variables by elimination.
  std::vector<int32_t> elimination_order() const;
  const Plan& plan() const;
  const Nodes& nodes() const { return nodes_; }
  OrderMethod order_used() const { return order_used_; }

  // Residuals, robust weights and Gauss-Newton blocks at the values.
  GroupCost linearize(int threads);
  // Costs alone, at the candidate or at the values.
  GroupCost cost(bool at_candidate, int threads) const;

  // Factorises H + damping diag(H). Returns the variable at which it is not positive definite, or -1.
  int64_t factorize(double damping, double damping_floor, int threads);
  // The step of the last factorisation, by variable; returns what the quadratic model says that the cost falls by.
  double solve(double damping, double damping_floor);
  // X of H X = B for right-hand sides of one tangent vector each, in place.
  void solve_for(std::span<double> columns) const;
  // Gradient J' W r and diagonal of H, by variable; H v.
  std::vector<double> gradient() const;
  std::vector<double> diagonal() const;
  std::vector<double> multiply(std::span<const double> v) const;

  std::span<const double> step() const { return step_; }
  void set_step(std::span<const double> step);
  // candidate = values retracted by the step; `accept` makes the candidate the values.
  void retract();
  void accept() { values_.swap(candidate_); }

  const Multifrontal& factorization() const;
  std::span<const double> blocks() const { return blocks_; }


 private:
  void number_nodes();
  void make_plan_for(const Adjacency& graph, std::span<const int32_t> order);
  void scatter(std::span<const double> by_elimination, std::span<double> by_variable) const;
  void gather(std::span<const double> by_variable, std::span<double> by_elimination) const;

  std::vector<FamilyBlock> families_;
  std::vector<FactorGroup> groups_;
  std::vector<int64_t> variable_tangent_;
  std::vector<int32_t> variable_dof_;
  std::vector<uint8_t> held_;
  size_t tangent_size_ = 0;
  size_t block_doubles_ = 0;
  size_t factors_ = 0;
  std::vector<double> values_, candidate_, step_, blocks_, elimination_;
  Nodes nodes_;
  std::unique_ptr<Plan> plan_;
  std::optional<Multifrontal> multifrontal_;
  OrderMethod order_used_ = OrderMethod::natural;
};

}  // namespace heliograph
