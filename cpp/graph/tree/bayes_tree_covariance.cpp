// SPDX-License-Identifier: MIT
// Covariances from the Bayes tree: work for the cliques between the asked variables and the root only.
#include <Eigen/Dense>
#include <algorithm>
#include <stdexcept>
#include <unordered_map>

#include "graph/tree/bayes_tree.hpp"

namespace heliograph {

namespace {

using Matrix = Eigen::MatrixXd;
using Columns = Eigen::Map<const Matrix, 0, Eigen::OuterStride<>>;

Columns columns_of(const Clique& clique) {
  return {clique.factor, clique.pivots + clique.rows, clique.pivots, Eigen::OuterStride<>(clique.height)};
}

// The cliques between some variables and the root, parents first.
class Paths {
 public:
  Paths(const BayesTree& tree, std::span<const int32_t> variables) : cliques_(tree.all_cliques()) {
    std::vector<int32_t> path;
    for (const int32_t v : variables) {
      path.clear();
      for (int32_t c = tree.clique_of()[static_cast<size_t>(v)]; c >= 0 && !waiting_.contains(c); c = at(c).parent) {
        waiting_.emplace(c, 0);
        path.push_back(c);
      }
      for (const int32_t c : path)
        if (at(c).parent >= 0) ++waiting_[at(c).parent];
      order_.insert(order_.end(), path.rbegin(), path.rend());
    }
  }

  const Clique& at(int32_t clique) const { return cliques_[static_cast<size_t>(clique)]; }
  const std::vector<int32_t>& order() const { return order_; }
  // Counts a child as done; true when it was the last.
  bool last_of(int32_t clique) { return --waiting_[clique] == 0; }
  bool awaited(int32_t clique) const { return waiting_.at(clique) > 0; }

 private:
  const std::vector<Clique>& cliques_;
  std::vector<int32_t> order_;
  std::unordered_map<int32_t, int32_t> waiting_;  // children on the paths that still need its block
};

// Z of a clique from the part of it, Z22, that its parent knows. With W = L21 L11^-1: Z21 = -Z22 W, Z11 = (L11 L11')^-1 - W' Z21.
Matrix clique_inverse(const Clique& clique, const Matrix& Z22) {
  const Eigen::Index K = clique.pivots, M = clique.rows;
  const Columns L = columns_of(clique);
  const Matrix inverse = L.topRows(K).triangularView<Eigen::Lower>().solve(Matrix::Identity(K, K));
  Matrix Z(K + M, K + M);
  Z.topLeftCorner(K, K).noalias() = inverse.transpose() * inverse;
  if (M == 0) return Z;
  const Matrix W = L.bottomRows(M) * inverse;
  Z.bottomRightCorner(M, M) = Z22;
  Z.bottomLeftCorner(M, K).noalias() = -Z22 * W;
  Z.topLeftCorner(K, K).noalias() -= W.transpose() * Z.bottomLeftCorner(M, K);
  Z.topRightCorner(K, M) = Z.bottomLeftCorner(M, K).transpose();
  return Z;
}

// Scalar place of each variable in a clique's block.
std::unordered_map<int32_t, Eigen::Index> places_in(const Clique& clique, const std::vector<int32_t>& dof) {
  std::unordered_map<int32_t, Eigen::Index> place;
  Eigen::Index at = 0;
  for (const int32_t v : clique.nodes) {
    place.emplace(v, at);
    at += dof[static_cast<size_t>(v)];
  }
  return place;
}

// The part of the parent's block that belongs to the rows of a child.
Matrix rows_of_parent(const Clique& clique, const Clique& parent, const Matrix& Z, const std::vector<int32_t>& dof) {
  const auto place = places_in(parent, dof);
  std::vector<Eigen::Index> from;
  for (size_t i = static_cast<size_t>(clique.pivot_nodes); i < clique.nodes.size(); ++i)
    for (int32_t k = 0; k < dof[static_cast<size_t>(clique.nodes[i])]; ++k) from.push_back(place.at(clique.nodes[i]) + k);
  return Z(from, from);
}

// Solves H X = E for a few columns, on the paths only: elsewhere L^-1 E is zero and X is not asked for.
class PathSolve {
 public:
  PathSolve(const Paths& paths, const std::vector<int32_t>& dof, Eigen::Index columns) : paths_(paths), dof_(dof) {
    Eigen::Index size = 0;
    for (const int32_t c : paths.order())
      for (int32_t i = 0; i < paths.at(c).pivot_nodes; ++i) {
        const int32_t v = paths.at(c).nodes[static_cast<size_t>(i)];
        first_.emplace(v, size);
        size += dof[static_cast<size_t>(v)];
      }
    X_ = Matrix::Zero(size, columns);
  }

  Eigen::Index first(int32_t variable) const { return first_.at(variable); }
  Matrix& X() { return X_; }

  void run() {
    const std::vector<int32_t>& order = paths_.order();
    for (size_t i = order.size(); i-- > 0;) {
      const Clique& clique = paths_.at(order[i]);
      const Columns L = columns_of(clique);
      auto pivots = X_.middleRows(first(clique.nodes.front()), clique.pivots);
      L.topRows(clique.pivots).triangularView<Eigen::Lower>().solveInPlace(pivots);
      if (clique.rows > 0) X_(rows(clique), Eigen::all) -= L.bottomRows(clique.rows) * pivots;
    }
    for (const int32_t c : order) {
      const Clique& clique = paths_.at(c);
      const Columns L = columns_of(clique);
      auto pivots = X_.middleRows(first(clique.nodes.front()), clique.pivots);
      if (clique.rows > 0) pivots -= L.bottomRows(clique.rows).transpose() * X_(rows(clique), Eigen::all);
      L.topRows(clique.pivots).triangularView<Eigen::Lower>().transpose().solveInPlace(pivots);
    }
  }

 private:
  std::vector<Eigen::Index> rows(const Clique& clique) const {
    std::vector<Eigen::Index> out;
    for (size_t i = static_cast<size_t>(clique.pivot_nodes); i < clique.nodes.size(); ++i)
      for (int32_t k = 0; k < dof_[static_cast<size_t>(clique.nodes[i])]; ++k) out.push_back(first(clique.nodes[i]) + k);
    return out;
  }

  const Paths& paths_;
  const std::vector<int32_t>& dof_;
  std::unordered_map<int32_t, Eigen::Index> first_;
  Matrix X_;
};

}  // namespace

std::vector<double> BayesTree::covariance(std::span<const int32_t> variables) const {
  std::unordered_map<int32_t, std::vector<size_t>> asked;  // of each clique: where its variables' blocks go
  std::vector<size_t> offset(variables.size() + 1, 0);
  for (size_t i = 0; i < variables.size(); ++i) {
    const auto v = static_cast<size_t>(variables[i]);
    offset[i + 1] = offset[i] + static_cast<size_t>(dof_.at(v)) * static_cast<size_t>(dof_[v]);
    if (clique_of_[v] >= 0) asked[clique_of_[v]].push_back(i);
  }
  std::vector<double> out(offset.back(), 0.0);  // held variables have none
  Paths paths(*this, variables);
  std::unordered_map<int32_t, Matrix> kept;
  for (const int32_t c : paths.order()) {
    const Clique& clique = paths.at(c);
    const bool root = clique.parent < 0;
    Matrix Z = clique_inverse(clique, root ? Matrix() : rows_of_parent(clique, paths.at(clique.parent), kept.at(clique.parent), dof_));
    const auto here = asked.find(c);
    if (here != asked.end()) {
      const auto place = places_in(clique, dof_);
      for (const size_t i : here->second) {
        const Eigen::Index first = place.at(variables[i]), d = dof_[static_cast<size_t>(variables[i])];
        Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(out.data() + offset[i], d, d) =
            Z.block(first, first, d, d);
      }
    }
    if (!root && paths.last_of(clique.parent)) kept.erase(clique.parent);
    if (paths.awaited(c)) kept.emplace(c, std::move(Z));
  }
  return out;
}

std::vector<double> BayesTree::joint_covariance(std::span<const int32_t> variables) const {
  Eigen::Index size = 0;
  for (const int32_t v : variables) size += dof_.at(static_cast<size_t>(v));
  const Paths paths(*this, variables);
  PathSolve solve(paths, dof_, size);
  std::vector<Eigen::Index> place;  // of each asked scalar; -1: held
  for (const int32_t v : variables)
    for (int32_t k = 0; k < dof_[static_cast<size_t>(v)]; ++k) {
      const bool held = clique_of_[static_cast<size_t>(v)] < 0;
      if (!held) solve.X()(solve.first(v) + k, static_cast<Eigen::Index>(place.size())) = 1.0;
      place.push_back(held ? -1 : solve.first(v) + k);
    }
  solve.run();
  std::vector<double> out(static_cast<size_t>(size * size), 0.0);
  for (size_t r = 0; r < place.size(); ++r)
    if (place[r] >= 0)
      for (Eigen::Index c = 0; c < size; ++c)
        out[r * static_cast<size_t>(size) + static_cast<size_t>(c)] = solve.X()(place[r], c);
  return out;
}

}  // namespace heliograph
