// SPDX-License-Identifier: MIT
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "graph/factors/make_group.hpp"
#include "tests/check.hpp"

using namespace heliograph;

namespace {

struct World {
  std::vector<FamilyBlock> families;
  std::vector<double> x, delta;
};

// `count` variables of each family, one block behind the other, at random places.
World world(std::initializer_list<std::pair<Manifold, int>> kinds, size_t count) {
  World w;
  size_t first = 0;
  double angle = 0.1;
  for (const auto& [manifold, dof] : kinds) {
    FamilyBlock block{manifold, dof, storage_of(manifold, dof), count, first, w.x.size(), w.delta.size()};
    std::vector<double> one(static_cast<size_t>(block.storage), 0.0);
    if (manifold == Manifold::s2 || manifold == Manifold::so2 || manifold == Manifold::se2) one[0] = 1.0;
    if (manifold == Manifold::so3 || manifold == Manifold::se3 || manifold == Manifold::nav) one[0] = one[4] = one[8] = 1.0;
    for (size_t i = 0; i < count; ++i) {
      w.x.insert(w.x.end(), one.begin(), one.end());
      for (int d = 0; d < dof; ++d) w.delta.push_back(std::sin(angle += 0.7));
    }
    first += count;
    w.families.push_back(block);
  }
  for (const FamilyBlock& block : w.families) retract_block(block, w.x.data(), w.delta.data(), w.x.data());
  return w;
}

// Blocks lie side by side without a number more or less, whatever range they are asked for.
void check_ranges(FactorType type, Manifold a, int dof_a, Manifold b, int dof_b) {
  constexpr size_t kCount = 5;
  const bool same = a == b && dof_a == dof_b;
  const World w = same ? world({{a, dof_a}}, 2 * kCount) : world({{a, dof_a}, {b, dof_b}}, kCount);
  std::vector<int32_t> variables;
  for (int32_t k = 0; k < static_cast<int32_t>(kCount); ++k) variables.insert(variables.end(), {k, k + static_cast<int32_t>(kCount)});
  const Manifold manifolds[2] = {a, b};
  const int dofs[2] = {dof_a, dof_b};
  const FactorShape shape = shape_of(type, {manifolds, dofs});
  CHECK(shape.known);
  std::vector<double> z(kCount * static_cast<size_t>(shape.measurement), 0.6);
  if (type == FactorType::between && a != Manifold::vector) z.assign(w.x.begin(), w.x.begin() + static_cast<long>(z.size()));
  const double S[1] = {2.0};
  GroupInput input;
  input.type = type;
  input.arity = 2;
  input.variables = variables;
  input.measurement = z;
  input.sqrt_information = S;
  const FactorGroup group = make_group(input, w.families);
  const size_t size = block_size(group);
  std::vector<double> all(kCount * size), part(kCount * size);
  const GroupCost cost = linearize_group(group, 0, kCount, w.x.data(), all.data());
  double sum = 0.0;
  for (size_t k = 0; k < kCount; ++k) {
    std::vector<double> exact(size);  // the sanitizer watches its end
    sum += linearize_group(group, k, k + 1, w.x.data(), exact.data()).cost;
    for (size_t i = 0; i < size; ++i) CHECK(exact[i] == all[k * size + i] && std::isfinite(exact[i]));
  }
  CHECK(sum == cost.cost);
  CHECK_NEAR(cost_of_group(group, 0, kCount, w.x.data()).cost, cost.cost, 1e-12 * cost.cost);
}

void check_all_ranges() {
  for (const auto& [manifold, dof] : {std::pair{Manifold::so2, 1}, {Manifold::so3, 3}, {Manifold::se2, 3}, {Manifold::se3, 6},
                                      {Manifold::nav, 9}, {Manifold::vector, 4}})
    check_ranges(FactorType::between, manifold, dof, manifold, dof);
  for (const FactorType type : {FactorType::range, FactorType::bearing, FactorType::landmark}) {
    check_ranges(type, Manifold::se2, 3, Manifold::vector, 2);
    check_ranges(type, Manifold::se3, 6, Manifold::vector, 3);
    check_ranges(type, Manifold::se3, 6, Manifold::nav, 9);
  }
  check_ranges(FactorType::linear_motion, Manifold::vector, 3, Manifold::vector, 2);
}

template <typename Function>
bool refuses(Function&& function) {
  try {
    function();
  } catch (const std::invalid_argument&) {
    return true;
  }
  return false;
}

void check_refusals() {
  const World w = world({{Manifold::se2, 3}, {Manifold::s2, 2}}, 3);
  const double S[1] = {1.0}, z[4] = {1.0, 0.0, 0.0, 0.0};
  const auto made = [&](std::vector<int32_t> variables, FactorType type) {
    GroupInput input;
    input.type = type;
    input.arity = 2;
    input.variables = variables;
    input.measurement = z;
    input.sqrt_information = S;
    return make_group(input, w.families);
  };
  CHECK(made({0, 2}, FactorType::between).rows == 3);
  CHECK(refuses([&] { made({0, 3}, FactorType::between); }));
  CHECK(refuses([&] { made({3, 4}, FactorType::between); }));
  CHECK(refuses([&] { made({0, 6}, FactorType::between); }));
  CHECK(refuses([&] { made({-1, 0}, FactorType::between); }));
  CHECK(refuses([&] { made({0, 1, 2}, FactorType::between); }));
  CHECK(refuses([&] { made({}, FactorType::between); }));
}

// A number that is none stays within its own factor.
void check_nan() {
  World w = world({{Manifold::se3, 6}}, 4);
  w.x[0] = std::numeric_limits<double>::quiet_NaN();
  const int32_t variables[4] = {0, 1, 2, 3};
  const std::vector<double> z(w.x.begin() + 12, w.x.begin() + 36);
  const double S[1] = {1.0};
  GroupInput input;
  input.type = FactorType::between;
  input.arity = 2;
  input.variables = variables;
  input.measurement = z;
  input.sqrt_information = S;
  const FactorGroup group = make_group(input, w.families);
  std::vector<double> blocks(2 * block_size(group));
  CHECK(std::isnan(linearize_group(group, 0, 2, w.x.data(), blocks.data()).chi2));
  CHECK(std::isnan(blocks[0]));
  for (size_t i = block_size(group); i < blocks.size(); ++i) CHECK(std::isfinite(blocks[i]));
}

// A kind that a room above brings: linearised in ranges as any other, by its code alone; unknown codes and shapes are refused.
void check_brought_kinds() {
  const World w = world({{Manifold::nav, 9}, {Manifold::vector, 6}, {Manifold::vector, 3}}, 4);
  const std::vector<double> one(1, 1.0);
  size_t seen = 0;
  for (const ResidualKind& kind : brought_residuals()) {
    CHECK(static_cast<int32_t>(kind.type) >= kFirstBrought && brought_residual(kind.type) == &kind);
    const Manifold manifolds[2] = {Manifold::nav, Manifold::vector};
    const int dofs[2] = {9, 3};
    const FactorShape shape = shape_of(kind.type, {manifolds, dofs});
    if (!shape.known) continue;
    ++seen;
    const std::vector<int32_t> variables = {0, 8, 1, 9, 2, 10};
    const std::vector<double> z(3 * static_cast<size_t>(shape.measurement), 0.3);
    GroupInput input;
    input.type = kind.type;
    input.arity = 2;
    input.variables = variables;
    input.measurement = z;
    input.sqrt_information = one;
    const FactorGroup group = make_group(input, w.families);
    const size_t size = block_size(group);
    std::vector<double> all(3 * size);
    linearize_group(group, 0, 3, w.x.data(), all.data());
    for (size_t k = 0; k < 3; ++k) {
      std::vector<double> exact(size);
      linearize_group(group, k, k + 1, w.x.data(), exact.data());
      for (size_t i = 0; i < size; ++i) CHECK(exact[i] == all[k * size + i] && std::isfinite(exact[i]));
    }
    input.measurement = std::span(z).first(2);
    CHECK(refuses([&] { make_group(input, w.families); }));
  }
  CHECK(seen == 1);  // a point on a body, at the end of a variable lever
  CHECK(brought_residual(FactorType::between) == nullptr);
  CHECK(!shape_of(static_cast<FactorType>(kFirstBrought + 999), {}).known);
}

// Parts of motions, by the number of rows.
void check_parts() {
  const Manifold manifolds[2] = {Manifold::nav, Manifold::se3};
  const int dofs[2] = {9, 6};
  for (const int rows : {0, 3, 6}) {
    const FactorShape shape = shape_of(FactorType::between, {manifolds, dofs, rows});
    CHECK(shape.known && shape.rows == (rows == 0 ? 6 : rows) && shape.measurement == shape.rows + 6);
  }
  for (const int rows : {1, 5, 9}) CHECK(!shape_of(FactorType::between, {manifolds, dofs, rows}).known);
  for (const int rows : {0, 3, 6, 9}) CHECK(shape_of(FactorType::prior, {std::span(manifolds).first(1), dofs, rows}).known);
  for (const int rows : {-3, 4, 12}) CHECK(!shape_of(FactorType::prior, {std::span(manifolds).first(1), dofs, rows}).known);
}

}  // namespace

void check_graph_factors() {
  check_brought_kinds();
  check_parts();
  check_all_ranges();
  check_refusals();
  check_nan();
}
