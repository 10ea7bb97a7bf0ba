// SPDX-License-Identifier: MIT
// Plan, multifrontal factorisation, solves and selected inverse of random graphs against one dense matrix.
#include <Eigen/Dense>
#include <algorithm>
#include <numeric>
#include <random>

#include "graph/factors/make_group.hpp"
#include "graph/problem/problem.hpp"
#include "graph/cholesky/selected_inverse.hpp"
#include "tests/check.hpp"

namespace {

using namespace heliograph;
using Matrix = Eigen::MatrixXd;
using Vector = Eigen::VectorXd;

constexpr double kSigma = 0.5;

// A group of factors with random residuals and Jacobians.
void add_random(GraphProblem& problem, int rows, int arity, const std::vector<int32_t>& variables, std::mt19937& random) {
  const std::vector<double> scale{kSigma};
  GroupInput input;
  input.rows = rows;
  input.arity = arity;
  input.variables = variables;
  input.sqrt_information = scale;
  FactorGroup group = make_group(input, problem.families());
  std::normal_distribution<double> normal;
  for (double& r : group.residual) r = normal(random);
  for (auto& jacobian : group.jacobian)
    for (double& x : jacobian) x = normal(random);
  problem.add_group(std::move(group));
}

// Vectors of several sizes and poses; every variable has a full-rank factor of its own, so that all is determined.
GraphProblem random_problem(std::mt19937& random, int counts, int factors, bool hold) {
  std::vector<FamilyBlock> families(4);
  for (size_t f = 0; f < families.size(); ++f) families[f].count = static_cast<size_t>(counts);
  families[0].dof = 1;
  families[1].dof = 3;
  families[2].dof = 9;
  families[3].manifold = Manifold::se2;
  families[3].dof = 3;
  GraphProblem problem(families);
  for (const FamilyBlock& family : problem.families()) {
    std::vector<int32_t> all(family.count);
    std::iota(all.begin(), all.end(), static_cast<int32_t>(family.first));
    if (!all.empty()) add_random(problem, family.dof + 1, 1, all, random);
  }
  const auto n = static_cast<int32_t>(problem.variables());
  for (int k = 0; k < factors; ++k) {
    const int arity = std::min<int>(1 + static_cast<int>(random() % 4), n);
    std::vector<int32_t> scope(static_cast<size_t>(n));
    std::iota(scope.begin(), scope.end(), 0);
    std::shuffle(scope.begin(), scope.end(), random);
    scope.resize(static_cast<size_t>(arity));
    add_random(problem, 1 + static_cast<int>(random() % 6), arity, scope, random);
  }
  if (hold) {
    std::vector<int32_t> held;
    for (int32_t v = 0; v < n; ++v)
      if (random() % 4 == 0) held.push_back(v);
    problem.hold(held);
  }
  std::vector<double> values;
  for (const FamilyBlock& family : problem.families())
    for (size_t i = 0; i < family.count * static_cast<size_t>(family.storage); ++i)
      values.push_back(family.manifold == Manifold::se2 && i % 4 == 0 ? 1.0 : 0.0);
  problem.set_values(values);
  return problem;
}

struct Dense {
  Matrix H;
  Vector g;
  std::vector<Eigen::Index> first;  // of each variable; -1 where it is held
};

Dense assemble(const GraphProblem& problem, const std::vector<int>& dof) {
  Dense dense;
  Eigen::Index size = 0;
  for (size_t v = 0; v < dof.size(); ++v) {
    const bool free = problem.nodes().node_of[v] >= 0;
    dense.first.push_back(free ? size : -1);
    if (free) size += dof[v];
  }
  dense.H = Matrix::Zero(size, size);
  dense.g = Vector::Zero(size);
  for (const FactorGroup& group : problem.groups())
    for (size_t k = 0; k < group.count; ++k) {
      Matrix J = Matrix::Zero(group.rows, size);
      for (int a = 0; a < group.arity; ++a) {
        const auto v = static_cast<size_t>(group.variables[k * static_cast<size_t>(group.arity) + static_cast<size_t>(a)]);
        if (dense.first[v] < 0) continue;
        const double* from = group.jacobian[static_cast<size_t>(a)].data() + k * static_cast<size_t>(group.rows * dof[v]);
        for (int r = 0; r < group.rows; ++r)
          for (int c = 0; c < dof[v]; ++c) J(r, dense.first[v] + c) = kSigma * *from++;
      }
      const Eigen::Map<const Vector> r(group.residual.data() + k * static_cast<size_t>(group.rows), group.rows);
      dense.H += J.transpose() * J;
      dense.g += J.transpose() * (kSigma * r);
    }
  return dense;
}

std::vector<int> dofs_of(const GraphProblem& problem) {
  std::vector<int> dof;
  for (const FamilyBlock& family : problem.families()) dof.insert(dof.end(), family.count, family.dof);
  return dof;
}

void check_inverse(const GraphProblem& problem, const Dense& dense, const std::vector<int>& dof, std::mt19937& random) {
  std::vector<int32_t> nodes(problem.nodes().weight.size());
  std::iota(nodes.begin(), nodes.end(), 0);
  std::shuffle(nodes.begin(), nodes.end(), random);
  nodes.resize(nodes.size() - nodes.size() / 3);
  const Matrix inverse = dense.H.inverse();
  SelectedInverse bounded(problem.factorization(), 200), unbounded(problem.factorization());
  const std::vector<double> blocks = unbounded.blocks(nodes);
  CHECK(unbounded.blocks(nodes) == blocks);  // from what was kept
  CHECK(bounded.blocks(nodes) == blocks);
  std::vector<double> single;
  for (const int32_t node : nodes) {
    const std::vector<double> block = bounded.blocks({&node, 1});
    single.insert(single.end(), block.begin(), block.end());
  }
  CHECK(single == blocks);
  const double* found = blocks.data();
  for (const int32_t node : nodes) {
    const auto v = static_cast<size_t>(problem.nodes().variable_of[static_cast<size_t>(node)]);
    for (int r = 0; r < dof[v]; ++r)
      for (int c = 0; c < dof[v]; ++c)
        CHECK_NEAR(*found++, inverse(dense.first[v] + r, dense.first[v] + c), 1e-9 * (1.0 + inverse.cwiseAbs().maxCoeff()));
  }
}

void check_problem(GraphProblem& problem, OrderMethod method, int threads, std::mt19937& random) {
  problem.analyze(method);
  problem.linearize(threads);
  const std::vector<int> dof = dofs_of(problem);
  Dense dense = assemble(problem, dof);
  for (const double damping : {0.0, 0.1}) {
    CHECK(problem.factorize(damping, 1e-12, threads) == -1);
    if (damping == 0.0) check_inverse(problem, dense, dof, random);
    problem.solve(damping, 1e-12);
    Matrix raised = dense.H;
    raised.diagonal() *= 1.0 + damping;
    const Vector step = -raised.llt().solve(dense.g);
    std::vector<double> right(problem.tangent_size());
    for (double& x : right) x = static_cast<double>(random() % 100) - 50.0;
    std::vector<double> solved = right;
    problem.solve_for(solved);
    Vector b(dense.g.size());
    size_t at = 0;
    for (size_t v = 0; v < dof.size(); at += static_cast<size_t>(dof[v++]))
      for (int c = 0; c < dof[v]; ++c)
        if (dense.first[v] >= 0) b[dense.first[v] + c] = right[at + static_cast<size_t>(c)];
    const Vector x = raised.llt().solve(b);
    const double scale = 1.0 + (step.size() > 0 ? step.cwiseAbs().maxCoeff() + x.cwiseAbs().maxCoeff() : 0.0);
    at = 0;
    for (size_t v = 0; v < dof.size(); at += static_cast<size_t>(dof[v++]))
      for (int c = 0; c < dof[v]; ++c) {
        const size_t i = at + static_cast<size_t>(c);
        CHECK_NEAR(problem.step()[i], dense.first[v] < 0 ? 0.0 : step[dense.first[v] + c], 1e-8 * scale);
        CHECK_NEAR(solved[i], dense.first[v] < 0 ? 0.0 : x[dense.first[v] + c], 1e-8 * scale);
      }
  }
  problem.retract();
  problem.cost(true, threads);
  CHECK(problem.factorize(std::nan(""), 1e-12, threads) != -1 || dense.g.size() == 0);
}

// One dense front of vectors with one scalar, large enough for packed products and for both sides of their edges.
void check_dense_front(int count, int threads, std::mt19937& random) {
  FamilyBlock family;
  family.dof = 1;
  family.count = static_cast<size_t>(count);
  GraphProblem problem({family});
  std::vector<int32_t> own(family.count), pairs;
  std::iota(own.begin(), own.end(), 0);
  for (int32_t i = 0; i < count; ++i)
    for (int32_t j = 0; j < i; ++j) {
      pairs.push_back(j);
      pairs.push_back(i);
    }
  add_random(problem, 2, 1, own, random);
  if (!pairs.empty()) add_random(problem, 1, 2, pairs, random);
  problem.analyze(OrderMethod::automatic);
  CHECK(problem.plan().fronts.size() == 1);
  problem.linearize(threads);
  CHECK(problem.factorize(0.0, 0.0, threads) == -1);
  problem.solve(0.0, 0.0);
  const std::vector<double> product = problem.multiply(problem.step()), gradient = problem.gradient();
  double size = 1.0;
  for (const double g : gradient) size = std::max(size, std::abs(g));
  for (size_t i = 0; i < product.size(); ++i) CHECK_NEAR(product[i], -gradient[i], 1e-7 * size);
}

}  // namespace

void check_graph_solver() {
  std::mt19937 random(11);
  for (int trial = 0; trial < 60; ++trial) {
    const int counts = trial < 3 ? trial : 1 + static_cast<int>(random() % 12);
    GraphProblem problem = random_problem(random, counts, counts == 0 ? 0 : static_cast<int>(random() % 60), trial % 2 == 1);
    check_problem(problem, static_cast<OrderMethod>(trial % 4), 1 + trial % 3, random);
  }
  for (const int count : {1, 2, 3, 4, 5, 47, 48, 49, 95, 96, 97, 143, 144, 145, 192, 193, 289, 481})
    check_dense_front(count, 1 + count % 2, random);
}
