// SPDX-License-Identifier: MIT
// Square roots of information from covariance matrices.
#pragma once

namespace heliograph {

// Upper triangular S with S' S = P^-1, both n x n and row by row; false where P is not finite or not positive definite. P is
// scaled to a unit diagonal first, so that rows of very different units are judged alike; its symmetric part is meant.
bool covariance_root(const double* P, int n, double* S);

}  // namespace heliograph
