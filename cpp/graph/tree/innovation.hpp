// SPDX-License-Identifier: MIT
// How far a factor is from what all other factors say of its variables.
#pragma once
#include <Eigen/Core>
#include <vector>

#include "graph/factors/factor_group.hpp"

namespace heliograph {

// A factor's residual and Jacobian in units of its noise.
struct WhitenedFactor {
  Eigen::VectorXd r;
  Eigen::MatrixXd J;
};

struct Innovation {
  double squared = 0.0;  // r' (1 + J P J')^-1 r, whitened, where P is the covariance that the others leave
  double left = 0.0;     // squared residual when all have had their say
};

WhitenedFactor whitened(const FactorGroup& alone, const std::vector<double>& x);

// `said` is J P J'. With `apart` the factor is not in P; else it is, with weight one, and is taken out of it. Where nothing
// else speaks the innovation is zero.
Innovation innovation(const Eigen::VectorXd& r, const Eigen::MatrixXd& said, bool apart);

}  // namespace heliograph
