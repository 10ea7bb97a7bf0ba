// SPDX-License-Identifier: MIT
// Saved trees with a word changed and the checksum made right, as nobody but an enemy writes them: refused, or good for use.
#include <array>
#include <cstring>
#include <random>
#include <stdexcept>

#include "graph/tree/bayes_tree.hpp"
#include "tests/check.hpp"

namespace {

using namespace heliograph;

constexpr size_t kAll = size_t{1} << 40;
constexpr std::array<double, 12> kIdentity{1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0};
constexpr double kRoot = 2.0;

uint64_t checksum(const std::vector<uint8_t>& bytes, size_t size) {  // FNV-1a, eight bytes at a time, as archive.cpp has it
  uint64_t hash = 0xcbf29ce484222325;
  size_t i = 0;
  for (; i + 8 <= size; i += 8) {
    uint64_t word = 0;
    std::memcpy(&word, bytes.data() + i, 8);
    hash = (hash ^ word) * 0x100000001b3;
    hash ^= hash >> 29;
  }
  for (; i < size; ++i) hash = (hash ^ bytes[i]) * 0x100000001b3;
  return hash;
}

int32_t pose(BayesTree& tree, double x) {
  std::array<double, 12> start = kIdentity;
  start[9] = x;
  return tree.add_variables(Manifold::se3, 6, start).front();
}

int32_t kind(BayesTree& tree, FactorType type, size_t arity) {
  const std::array<int32_t, 2> manifolds{static_cast<int32_t>(Manifold::se3), static_cast<int32_t>(Manifold::se3)}, dofs{6, 6};
  return tree.add_kind({type, std::span(manifolds).first(arity), std::span(dofs).first(arity), 0, NoiseForm::scalar,
                        KernelType::none, 1.0, kAnySize});
}

void join(BayesTree& tree, int32_t kind, int32_t i, int32_t j) {
  const std::array<int32_t, 2> scope{i, j};
  std::array<double, 12> step = kIdentity;
  step[9] = 1.0;
  tree.add_factors(kind, scope, step, {&kRoot, 1}, false);
}

int32_t update(BayesTree& tree, size_t eliminate) {
  tree.relinearize(1e-3, kAll, true);
  tree.detach();
  tree.reorder();
  const int32_t failed = tree.eliminate(eliminate);
  if (failed < 0 && tree.waiting() == 0) tree.solve({1e-3, 1e-3, 20, 5});
  return failed;
}

// A chain with loops; some of it marginalised out, or left in the middle of an elimination.
std::vector<uint8_t> saved(bool open) {
  BayesTree tree;
  const int32_t prior = kind(tree, FactorType::prior, 1), between = kind(tree, FactorType::between, 2);
  int32_t last = pose(tree, 0.0);
  tree.add_factors(prior, {&last, 1}, kIdentity, {&kRoot, 1}, false);
  for (int k = 1; k < 40; ++k) {
    const int32_t next = pose(tree, k + 0.1 * (k % 3));
    join(tree, between, last, next);
    if (k % 9 == 8) join(tree, between, k / 2, next);
    last = next;
    CHECK(update(tree, kAll) < 0);
  }
  if (open) {
    join(tree, between, 3, last);
    CHECK(update(tree, 4) < 0 && tree.waiting() > 0);
  } else {
    const std::array<int32_t, 2> leaving{1, 2};
    tree.leave(leaving);
    tree.detach();
    tree.reorder();
    CHECK(tree.eliminate(kAll) < 0);
    tree.drop_left();
  }
  return tree.save();
}

// Everything that a user can ask of it.
void use(BayesTree& tree) {
  std::vector<int32_t> all;
  for (int32_t v = 0; static_cast<size_t>(v) < tree.slots(); ++v) all.push_back(v);
  tree.estimate(std::span(all).first(std::min<size_t>(all.size(), 3)));
  for (const int32_t v : all) tree.factors_of(v);
  if (tree.waiting() == 0 && !all.empty()) tree.covariance(std::span(all).last(1));
  tree.cost();
  const int32_t fresh = pose(tree, 40.0);
  const int32_t between = kind(tree, FactorType::between, 2);
  for (const int32_t v : {all[5], all.back()}) join(tree, between, v, fresh);
  if (update(tree, kAll) >= 0) return;
  tree.finish_steps();
  tree.estimate(all);
  if (tree.held(all[7])) return;
  const std::array<int32_t, 1> leaving{all[7]};
  tree.leave(leaving);
  tree.detach();
  tree.reorder();
  if (tree.eliminate(kAll) < 0) tree.drop_left();
  tree.save();
}

}  // namespace

void check_forged_tree() {
  constexpr std::array<uint32_t, 12> kWords{0, 1, 2, 3, 6, 17, 255, 100000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFE, 0xFFFFFFFF};
  std::mt19937 random(7);
  size_t refused = 0, used = 0;
  for (const bool open : {false, true}) {
    const std::vector<uint8_t> whole = saved(open);
    for (int n = 0; n < 3000; ++n) {
      std::vector<uint8_t> forged = whole;
      for (unsigned changes = 1 + (random() % 4 == 0 ? random() % 4 : 0); changes > 0; --changes) {
        const size_t at = 4 * (2 + random() % (whole.size() / 4 - 4));
        const uint32_t word = random() % 3 == 0 ? static_cast<uint32_t>(random()) % 64 : kWords[random() % kWords.size()];
        std::memcpy(forged.data() + at, &word, sizeof(word));
      }
      const uint64_t sum = checksum(forged, forged.size() - 8);
      std::memcpy(forged.data() + forged.size() - 8, &sum, sizeof(sum));
      BayesTree tree;
      try {
        tree.load(forged);
        ++used;
        use(tree);
      } catch (const std::invalid_argument&) {
        ++refused;
      } catch (const std::out_of_range&) {
        ++refused;
      }
    }
  }
  // Most words of a save are numbers that may be anything: both ways out are walked often, or the forger has missed its aim.
  CHECK(refused > 300 && used > 3000);
}
