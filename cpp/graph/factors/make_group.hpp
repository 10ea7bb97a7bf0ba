// SPDX-License-Identifier: MIT
// A group of factors from arrays: sizes checked against the type, the families looked up, the storage filled.
#pragma once
#include <span>

#include "graph/factors/factor_group.hpp"
#include "graph/factors/residual_kind.hpp"

namespace heliograph {

struct GroupInput {
  FactorType type = FactorType::custom;
  int arity = 0;
  int rows = 0;                           // of the residual; 0: what is usual between such families
  std::span<const int32_t> variables;     // (count, arity) dense indices
  std::span<const double> measurement;    // (count, measurement_size(...))
  NoiseForm noise = NoiseForm::scalar;
  bool shared_noise = true;
  std::span<const double> sqrt_information;
  KernelType kernel = KernelType::none;
  double kernel_width = 1.0;
};

// All factors' variables at one place must be of one family. Weights, shifts and what custom factors evaluate to start empty
// (residual and Jacobians: zero, of the right size). Throws std::invalid_argument.
FactorGroup make_group(const GroupInput& input, std::span<const FamilyBlock> families);

FactorShape shape_of(FactorType type, const ShapeQuery& query);

// Numbers of one S.
constexpr size_t noise_numbers(NoiseForm form, int rows) {
  const auto n = static_cast<size_t>(rows);
  return form == NoiseForm::scalar ? 1 : (form == NoiseForm::diagonal ? n : n * n);
}

}  // namespace heliograph
