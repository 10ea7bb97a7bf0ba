// SPDX-License-Identifier: MIT
#include "graph/tree/innovation.hpp"

#include <Eigen/Dense>
#include <array>

namespace heliograph {

namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// S of r_white = S r.
Eigen::MatrixXd root_of(const FactorGroup& alone) {
  const double* S = alone.sqrt_information.data();
  const Eigen::Index rows = alone.rows;
  if (alone.noise == NoiseForm::full) return Eigen::Map<const RowMajor>(S, rows, rows);
  if (alone.noise == NoiseForm::diagonal) return Eigen::Map<const Eigen::VectorXd>(S, rows).asDiagonal();
  return S[0] * Eigen::MatrixXd::Identity(rows, rows);
}

}  // namespace

WhitenedFactor whitened(const FactorGroup& alone, const std::vector<double>& x) {
  const auto rows = static_cast<Eigen::Index>(alone.rows);
  std::array<std::vector<double>, kMaxArity> blocks;
  std::array<double*, kMaxArity> pointers{};
  Eigen::Index size = 0;
  for (size_t a = 0; a < static_cast<size_t>(alone.arity); ++a) {
    blocks[a].resize(static_cast<size_t>(alone.rows * alone.dof[a]));
    pointers[a] = blocks[a].data();
    size += alone.dof[a];
  }
  jacobians_of_group(alone, 0, 1, x.data(), pointers.data());
  Eigen::MatrixXd J(rows, size);
  Eigen::Index at = 0;
  for (size_t a = 0; a < static_cast<size_t>(alone.arity); at += alone.dof[a++])
    J.middleCols(at, alone.dof[a]) = Eigen::Map<const RowMajor>(pointers[a], rows, alone.dof[a]);
  Eigen::VectorXd r(rows);
  double squared = 0.0;
  residuals_of_group(alone, 0, 1, x.data(), r.data(), &squared);
  const Eigen::MatrixXd S = root_of(alone);
  return {S * r, S * J};
}

// Where P knows of the factor, the residual is what it has left of the innovation: of that, r' (1 - J P J')^-1 r.
Innovation innovation(const Eigen::VectorXd& r, const Eigen::MatrixXd& said, bool apart) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(0.5 * (said + said.transpose()));
  const Eigen::VectorXd along = eigen.eigenvectors().transpose() * r;
  constexpr double kAlone = 1e-6;  // where the others say less than this part, there is nothing to compare with
  Innovation out;
  for (Eigen::Index i = 0; i < r.size(); ++i) {
    const double variance = apart ? 1.0 + eigen.eigenvalues()[i] : 1.0 - eigen.eigenvalues()[i], squared = along[i] * along[i];
    if (variance > kAlone) out.squared += squared / variance;
    out.left += apart ? squared / (variance * variance) : squared;
  }
  return out;
}

}  // namespace heliograph
