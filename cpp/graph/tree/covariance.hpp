// SPDX-License-Identifier: MIT
// Covariances from the Bayes tree, at the linearisation point: work for the cliques between the asked variables and the root.
#pragma once
#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "graph/tree/store.hpp"

namespace heliograph {

class TreeCovariance {
 public:
  explicit TreeCovariance(const TreeStore& store) : store_(store) {}

  // One block each, (dof, dof) row-major, one after another; zero where it is held.
  std::vector<double> blocks(std::span<const int32_t> variables) const;
  // All of them together (D, D), in their order.
  std::vector<double> joint(std::span<const int32_t> variables) const;
  // J P J' for the joint covariance P and a matrix of as many columns: a quarter of the work.
  Eigen::MatrixXd projected(std::span<const int32_t> variables, const Eigen::MatrixXd& J) const;

 private:
  std::vector<double> block(int32_t variable) const;

  const TreeStore& store_;
};

}  // namespace heliograph
