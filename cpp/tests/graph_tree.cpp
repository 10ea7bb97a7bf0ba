// SPDX-License-Identifier: MIT
// A Bayes tree that grows, shrinks, refuses, is saved and loaded, against one dense matrix; the factors are linear.
#include <Eigen/Dense>
#include <algorithm>
#include <map>
#include <random>
#include <stdexcept>

#include "graph/tree/bayes_tree.hpp"
#include "tests/check.hpp"

namespace {

using namespace heliograph;
using Matrix = Eigen::MatrixXd;
using Vector = Eigen::VectorXd;

constexpr double kRoot = 2.0;  // square root of every information
constexpr size_t kAll = size_t{1} << 40;

struct Linear {  // residual x_j - F x_i - u, or x_j - u where i < 0
  int32_t number = -1, i = -1, j = 0;
  std::vector<double> measurement;
  bool spare = false;  // without it all is still determined
};

// The tree, and what it should hold.
class Pair {
 public:
  // At most about `max_steps` variables solved in an update; the rest is deferred.
  explicit Pair(unsigned seed, size_t max_steps = kAll) : random_(seed), max_steps_(max_steps) {}

  int32_t variable(bool held) {
    const int d = 1 + static_cast<int>(random_() % 4);
    const std::vector<double> start = numbers(static_cast<size_t>(d));
    const int32_t v = tree.add_variables(Manifold::vector, d, start).front();
    CHECK(static_cast<size_t>(v) == dof.size());
    if (held) tree.hold({&v, 1});
    dof.push_back(d);
    value.push_back(start);
    is_held.push_back(held);
    return v;
  }

  void add(int32_t i, int32_t j, bool spare) {
    Linear factor{-1, i, j, {}, spare};
    const int di = i < 0 ? 0 : dof[static_cast<size_t>(i)], dj = dof[static_cast<size_t>(j)];
    factor.measurement = numbers(static_cast<size_t>(dj) * static_cast<size_t>(di + 1));
    std::vector<int32_t> scope;
    if (i >= 0) scope.push_back(i);
    scope.push_back(j);
    factor.number = tree.add_factors(kind(di, dj), scope, factor.measurement, {&kRoot, 1}, false).front();
    factors.push_back(factor);
  }

  void remove(size_t index) {
    tree.remove_factors({&factors[index].number, 1});
    factors.erase(factors.begin() + static_cast<std::ptrdiff_t>(index));
  }

  int32_t update() {
    if (max_steps_ == kAll) tree.relinearize(0.0, kAll, true);  // or all cliques would be made again, and no step could wait
    tree.detach();
    tree.reorder();
    const int32_t failed = tree.eliminate(kAll);
    if (failed < 0) tree.solve({0.0, 0.0, max_steps_, max_steps_ / 2});
    deferred += tree.deferred();
    return failed;
  }

  void check() {
    const auto [H, b, first] = dense();
    const Vector x = H.size() > 0 ? Vector(H.ldlt().solve(b)) : Vector();
    std::vector<int32_t> all;
    for (size_t v = 0; v < dof.size(); ++v) {
      const auto number = static_cast<int32_t>(v);
      all.push_back(number);
      const std::vector<double> found = tree.estimate({&number, 1});
      for (int k = 0; k < dof[v]; ++k)
        CHECK_NEAR(found[static_cast<size_t>(k)], first[v] < 0 ? value[v][static_cast<size_t>(k)] : x[first[v] + k],
                   1e-9 * (1.0 + std::abs(found[static_cast<size_t>(k)])));
    }
    check_covariance(H.inverse(), first, all);
  }

  std::vector<size_t> spares() const {
    std::vector<size_t> out;
    for (size_t f = 0; f < factors.size(); ++f)
      if (factors[f].spare) out.push_back(f);
    return out;
  }

  unsigned draw(unsigned below) { return static_cast<unsigned>(random_()) % below; }

  BayesTree tree;
  size_t deferred = 0;
  std::vector<int> dof;
  std::vector<std::vector<double>> value;
  std::vector<bool> is_held;
  std::vector<Linear> factors;

 private:
  struct Dense {
    Matrix H;
    Vector b;
    std::vector<Eigen::Index> first;  // -1: held
  };

  Dense dense() const {
    Dense out;
    Eigen::Index size = 0;
    for (size_t v = 0; v < dof.size(); ++v) {
      out.first.push_back(is_held[v] ? -1 : size);
      if (!is_held[v]) size += dof[v];
    }
    out.H = Matrix::Zero(size, size);
    out.b = Vector::Zero(size);
    for (const Linear& factor : factors) {
      const auto j = static_cast<size_t>(factor.j);
      const int dj = dof[j], di = factor.i < 0 ? 0 : dof[static_cast<size_t>(factor.i)];
      const Eigen::Map<const Eigen::Matrix<double, -1, -1, Eigen::RowMajor>> F(factor.measurement.data(), dj, di);
      Vector u = Eigen::Map<const Vector>(factor.measurement.data() + dj * di, dj);
      Matrix J = Matrix::Zero(dj, size);
      if (is_held[j]) u -= Eigen::Map<const Vector>(value[j].data(), dj);
      else J.middleCols(out.first[j], dj).setIdentity();
      if (factor.i >= 0 && is_held[static_cast<size_t>(factor.i)])
        u += F * Eigen::Map<const Vector>(value[static_cast<size_t>(factor.i)].data(), di);
      else if (factor.i >= 0)
        J.middleCols(out.first[static_cast<size_t>(factor.i)], di) -= F;
      out.H += kRoot * kRoot * J.transpose() * J;
      out.b += kRoot * kRoot * J.transpose() * u;
    }
    return out;
  }

  void check_covariance(const Matrix& P, const std::vector<Eigen::Index>& first, const std::vector<int32_t>& all) const {
    const std::vector<double> joint = tree.joint_covariance(all), blocks = tree.covariance(all);
    const double* block = blocks.data();
    std::vector<Eigen::Index> place;
    for (size_t v = 0; v < dof.size(); ++v)
      for (int k = 0; k < dof[v]; ++k) place.push_back(first[v] < 0 ? -1 : first[v] + k);
    const auto expected = [&](size_t r, size_t c) { return place[r] < 0 || place[c] < 0 ? 0.0 : P(place[r], place[c]); };
    for (size_t r = 0; r < place.size(); ++r)
      for (size_t c = 0; c < place.size(); ++c) CHECK_NEAR(joint[r * place.size() + c], expected(r, c), 1e-9);
    size_t at = 0;
    for (const int d : dof) {
      for (size_t r = 0; r < static_cast<size_t>(d); ++r)
        for (size_t c = 0; c < static_cast<size_t>(d); ++c) CHECK_NEAR(*block++, expected(at + r, at + c), 1e-9);
      at += static_cast<size_t>(d);
    }
  }

  int32_t kind(int di, int dj) {
    const auto known = kinds_.find({di, dj});
    if (known != kinds_.end()) return known->second;
    const std::vector<int32_t> dofs = di == 0 ? std::vector<int32_t>{dj} : std::vector<int32_t>{di, dj};
    const std::vector<int32_t> manifolds(dofs.size(), static_cast<int32_t>(Manifold::vector));
    const FactorType type = di == 0 ? FactorType::prior : FactorType::linear_motion;
    const int32_t made = tree.add_kind({type, manifolds, dofs, dj, NoiseForm::scalar, KernelType::none, 1.0});
    kinds_.emplace(std::pair{di, dj}, made);
    return made;
  }

  std::vector<double> numbers(size_t count) {
    std::normal_distribution<double> normal(0.0, 0.7);
    std::vector<double> out(count);
    for (double& x : out) x = normal(random_);
    return out;
  }

  std::mt19937 random_;
  size_t max_steps_;
  std::map<std::pair<int, int>, int32_t> kinds_;
};

// A variable without information of its own: refused, and all is as it was, to the bit.
void check_refusal(Pair& pair) {
  const std::vector<double> theta(pair.tree.theta().begin(), pair.tree.theta().end());
  const std::vector<double> delta(pair.tree.delta().begin(), pair.tree.delta().end());
  const size_t known = pair.dof.size(), factors = pair.factors.size();
  const int32_t lonely = pair.variable(false);
  if (known > 0) pair.add(-1, static_cast<int32_t>(pair.draw(static_cast<unsigned>(known))), false);
  const std::vector<int32_t> gone{pair.factors.front().number};
  pair.tree.remove_factors(gone);
  CHECK(pair.update() == lonely || known > 0);
  pair.dof.resize(known);
  pair.value.resize(known);
  pair.is_held.resize(known);
  pair.factors.resize(factors);
  CHECK(pair.tree.variables() == known && pair.tree.factors() == factors && pair.tree.idle());
  CHECK(std::ranges::equal(pair.tree.theta(), theta) && std::ranges::equal(pair.tree.delta(), delta));
}

void check_saved(const BayesTree& tree) {
  const std::vector<uint8_t> bytes = tree.save();
  BayesTree other;
  other.load(bytes);
  CHECK(std::ranges::equal(other.theta(), tree.theta()) && std::ranges::equal(other.delta(), tree.delta()));
  CHECK(other.cliques() == tree.cliques() && other.factors() == tree.factors());
  std::vector<uint8_t> damaged = bytes;
  damaged[damaged.size() / 2] ^= 1;
  for (const std::span<const uint8_t> bad : {std::span<const uint8_t>(damaged), std::span<const uint8_t>(bytes).first(bytes.size() / 3),
                                             std::span<const uint8_t>(bytes).first(0)}) {
    BayesTree third;
    bool refused = false;
    try {
      third.load(bad);
    } catch (const std::invalid_argument&) {
      refused = true;
    }
    CHECK(refused);
  }
}

void grow(unsigned seed, int steps, size_t max_steps) {
  Pair pair(seed, max_steps);
  for (int step = 0; step < steps; ++step) {
    for (unsigned n = 1 + pair.draw(3); n > 0; --n) {
      const auto before = static_cast<unsigned>(pair.dof.size());
      const int32_t v = pair.variable(pair.draw(6) == 0);
      const bool alone = before == 0 || pair.draw(8) == 0;
      pair.add(alone ? -1 : static_cast<int32_t>(before - 1 - pair.draw(std::min(before, 5U))), v, false);
      if (before > 3 && pair.draw(3) == 0) pair.add(static_cast<int32_t>(pair.draw(before)), v, true);
    }
    const std::vector<size_t> spares = pair.spares();
    if (spares.size() > 2 && pair.draw(3) == 0) pair.remove(spares[pair.draw(static_cast<unsigned>(spares.size()))]);
    CHECK(pair.update() < 0);
    CHECK(pair.update() < 0);  // nothing is left to do
    if (step % 5 == 4) pair.check();
    if (step % 7 == 3) check_refusal(pair);
    if (step % 11 == 10) check_saved(pair.tree);
  }
  pair.check();
  CHECK((max_steps < kAll) == (pair.deferred > 0));
}

}  // namespace

void check_graph_tree() {
  for (unsigned seed = 1; seed <= 6; ++seed) grow(seed, 30, kAll);
  for (unsigned seed = 7; seed <= 10; ++seed) grow(seed, 30, 3);
  check_saved(BayesTree());
}
