// SPDX-License-Identifier: MIT
#include "graph/factors/make_group.hpp"

#include <algorithm>
#include <stdexcept>
#include <string>

namespace heliograph {

namespace {

void require(bool holds, const std::string& message) {
  if (!holds) throw std::invalid_argument(message);
}

const FamilyBlock& family_of(std::span<const FamilyBlock> families, int32_t variable) {
  for (const FamilyBlock& family : families)
    if (variable >= 0 && static_cast<size_t>(variable) - family.first < family.count &&
        static_cast<size_t>(variable) >= family.first)
      return family;
  throw std::invalid_argument("variable " + std::to_string(variable) + " belongs to no family");
}

// Families and value offsets of all variables of all factors.
void place(const GroupInput& input, std::span<const FamilyBlock> families, FactorGroup* group) {
  const auto arity = static_cast<size_t>(input.arity);
  group->values.resize(input.variables.size());
  for (size_t a = 0; a < arity && group->count > 0; ++a) {
    const FamilyBlock& family = family_of(families, input.variables[a]);
    group->manifold[a] = family.manifold;
    group->dof[a] = family.dof;
    group->storage[a] = family.storage;
    for (size_t k = 0; k < group->count; ++k) {
      const int32_t v = input.variables[k * arity + a];
      require(v >= 0 && static_cast<size_t>(v) >= family.first && static_cast<size_t>(v) - family.first < family.count,
              "factor " + std::to_string(k) + ": its variable " + std::to_string(a) + " is of another family");
      const size_t offset = family.value + (static_cast<size_t>(v) - family.first) * static_cast<size_t>(family.storage);
      group->values[k * arity + a] = static_cast<int64_t>(offset);
    }
  }
}

void fill_measurement(const GroupInput& input, FactorGroup* group) {
  const auto arity = static_cast<size_t>(group->arity);
  const size_t doubles = input.measurement.size() / group->count;
  const ShapeQuery query{{group->manifold.data(), arity}, {group->dof.data(), arity}, input.rows, static_cast<int>(doubles)};
  const FactorShape shape = shape_of(input.type, query);
  require(shape.known, "no residual is known for this factor type and its families");
  if (input.type != FactorType::custom) {
    require(input.rows == 0 || input.rows == shape.rows, "the residual has " + std::to_string(shape.rows) + " rows");
    group->rows = shape.rows;
  }
  require(group->rows > 0, "a residual needs at least one row");
  group->measurement_size = shape.measurement;
  require(input.measurement.size() == group->count * static_cast<size_t>(shape.measurement),
          "a measurement needs " + std::to_string(shape.measurement) + " numbers a factor");
  group->measurement.assign(input.measurement.begin(), input.measurement.end());
}

void fill_noise(const GroupInput& input, FactorGroup* group) {
  const size_t numbers = noise_numbers(input.noise, group->rows);
  require(input.sqrt_information.size() == (input.shared_noise ? 1 : group->count) * numbers,
          "the square root information needs " + std::to_string(numbers) + " numbers a factor, or once if it is shared");
  group->noise = input.noise;
  group->shared_noise = input.shared_noise;
  group->sqrt_information.assign(input.sqrt_information.begin(), input.sqrt_information.end());
  require(input.kernel == KernelType::none || input.kernel_width > 0.0, "a robust kernel's width must be positive");
  group->kernel = input.kernel;
  group->kernel_width = input.kernel_width;
}

}  // namespace

FactorGroup make_group(const GroupInput& input, std::span<const FamilyBlock> families) {
  require(input.arity >= 1 && input.arity <= kMaxArity, "a factor has 1 to " + std::to_string(kMaxArity) + " variables");
  const auto arity = static_cast<size_t>(input.arity);
  require(!input.variables.empty() && input.variables.size() % arity == 0,
          "a group needs `arity` variables a factor, and a factor");
  FactorGroup group;
  group.type = input.type;
  group.arity = input.arity;
  group.rows = input.rows;
  group.count = input.variables.size() / arity;
  group.variables.assign(input.variables.begin(), input.variables.end());
  place(input, families, &group);
  fill_measurement(input, &group);
  fill_noise(input, &group);
  if (input.type != FactorType::custom) return group;
  group.residual.resize(group.count * static_cast<size_t>(group.rows));
  for (size_t a = 0; a < arity; ++a) group.jacobian[a].resize(group.residual.size() * static_cast<size_t>(group.dof[a]));
  return group;
}

}  // namespace heliograph
