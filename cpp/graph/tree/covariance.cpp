// SPDX-License-Identifier: MIT
#include "graph/tree/covariance.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <unordered_map>
#include <utility>

#include "graph/cholesky/front_view.hpp"
#include "graph/tree/kernels.hpp"

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
  Paths(const TreeStore& store, std::span<const int32_t> variables) : cliques_(store.cliques) {
    std::vector<int32_t> path;
    for (const int32_t v : variables) {
      path.clear();
      for (int32_t c = store.variables.clique_of(v); c >= 0 && !waiting_.contains(c); c = at(c).parent) {
        waiting_.emplace(c, 0);
        path.push_back(c);
      }
      for (const int32_t c : path)
        if (at(c).parent >= 0) ++waiting_[at(c).parent];
      order_.insert(order_.end(), path.rbegin(), path.rend());
    }
  }

  const Clique& at(int32_t clique) const { return cliques_[clique]; }
  const std::vector<int32_t>& order() const { return order_; }
  // Counts a child as done; true when it was the last.
  bool last_of(int32_t clique) { return --waiting_[clique] == 0; }
  bool awaited(int32_t clique) const { return waiting_.at(clique) > 0; }

 private:
  const TreeCliques& cliques_;
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
std::unordered_map<int32_t, Eigen::Index> places_in(const Clique& clique, const TreeVariables& variables) {
  std::unordered_map<int32_t, Eigen::Index> place;
  Eigen::Index at = 0;
  for (const int32_t v : clique.nodes) {
    place.emplace(v, at);
    at += variables.dof(v);
  }
  return place;
}

// The part of the parent's block that belongs to the rows of a child.
Matrix rows_of_parent(const Clique& clique, const Clique& parent, const Matrix& Z, const TreeVariables& variables) {
  const auto place = places_in(parent, variables);
  std::vector<Eigen::Index> from;
  for (int32_t i = clique.first_row(); i < clique.node_count(); ++i)
    for (int32_t k = 0; k < variables.dof(clique.node(i)); ++k) from.push_back(place.at(clique.node(i)) + k);
  return Z(from, from);
}

// L Y = E for the columns E of one variable, clique by clique from its own to the root, where alone Y has rows.
class PathForward {
 public:
  PathForward(const TreeStore& store, int32_t variable)
      : store_(store), dof_(static_cast<size_t>(store.variables.dof(variable))), width_((dof_ + 3) / 4 * 4),
        clique_(store.variables.clique_of(variable)) {
    const Clique& own = store_.cliques[clique_];
    rows_.assign(static_cast<size_t>(own.pivots + own.rows) * width_, 0.0);
    from_ = place_in(own, variable);
    for (size_t k = 0; k < dof_; ++k) rows_[(from_ + k) * width_ + k] = 1.0;
  }

  // Y'Y, which is the variable's block of H^-1, row-major.
  std::vector<double> product() {
    std::vector<double> sum(dof_ * width_, 0.0);
    while (true) {
      eliminate(store_.cliques[clique_], sum);
      const int32_t parent = store_.cliques[clique_].parent;
      if (parent < 0) break;
      climb(store_.cliques[clique_], store_.cliques[parent]);
      clique_ = parent;
    }
    std::vector<double> out(dof_ * dof_);
    for (size_t r = 0; r < dof_; ++r)
      for (size_t c = 0; c < dof_; ++c) out[r * dof_ + c] = sum[std::min(r, c) * width_ + std::max(r, c)];
    return out;
  }

 private:
  size_t place_in(const Clique& clique, int32_t variable) const {
    size_t place = 0;
    for (const int32_t v : clique.nodes) {
      if (v == variable) break;
      place += static_cast<size_t>(store_.variables.dof(v));
    }
    return place;
  }

  void eliminate(const Clique& clique, std::vector<double>& sum) {
    FrontView front;
    front.pivots = clique.pivots;
    front.rows = clique.rows;
    front.height = clique.height;
    kernels_.forward_columns(front, clique.factor, static_cast<int>(from_), static_cast<int>(dof_), rows_.data(), sum.data());
  }

  // What is left of the clique's rows, at their places in the parent.
  void climb(const Clique& clique, const Clique& parent) {
    std::vector<double> above(static_cast<size_t>(parent.pivots + parent.rows) * width_, 0.0);
    const double* row = rows_.data() + static_cast<size_t>(clique.pivots) * width_;
    from_ = static_cast<size_t>(parent.pivots);
    for (int32_t i = clique.first_row(); i < clique.node_count(); ++i) {
      const size_t place = place_in(parent, clique.node(i)), doubles = static_cast<size_t>(store_.variables.dof(clique.node(i))) * width_;
      std::copy_n(row, doubles, above.begin() + static_cast<std::ptrdiff_t>(place * width_));
      row += doubles;
      from_ = std::min(from_, place);  // above it Y is zero
    }
    rows_ = std::move(above);
  }

  const TreeStore& store_;
  FrontKernels kernels_ = front_kernels();
  size_t dof_, width_;  // width: whole vectors
  int32_t clique_;
  std::vector<double> rows_;  // of the clique's pivots and rows, `width_` each
  size_t from_ = 0;           // first that is not zero
};

// Solves H X = E for a few columns, on the paths only: elsewhere L^-1 E is zero and X is not asked for.
class PathSolve {
 public:
  PathSolve(const Paths& paths, const TreeVariables& variables, Eigen::Index columns) : paths_(paths), variables_(variables) {
    Eigen::Index size = 0;
    for (const int32_t c : paths.order())
      for (int32_t i = 0; i < paths.at(c).pivot_nodes; ++i) {
        const int32_t v = paths.at(c).node(i);
        first_.emplace(v, size);
        size += variables.dof(v);
      }
    X_ = Matrix::Zero(size, columns);
  }

  Eigen::Index first(int32_t variable) const { return first_.at(variable); }
  Matrix& X() { return X_; }

  // L^-1 X.
  void forward() {
    const std::vector<int32_t>& order = paths_.order();
    for (size_t i = order.size(); i-- > 0;) {
      const Clique& clique = paths_.at(order[i]);
      const Columns L = columns_of(clique);
      auto pivots = X_.middleRows(first(clique.nodes.front()), clique.pivots);
      L.topRows(clique.pivots).triangularView<Eigen::Lower>().solveInPlace(pivots);
      if (clique.rows > 0) X_(rows(clique), Eigen::all) -= L.bottomRows(clique.rows) * pivots;
    }
  }

  void run() {
    forward();
    for (const int32_t c : paths_.order()) {
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
    for (int32_t i = clique.first_row(); i < clique.node_count(); ++i)
      for (int32_t k = 0; k < variables_.dof(clique.node(i)); ++k) out.push_back(first(clique.node(i)) + k);
    return out;
  }

  const Paths& paths_;
  const TreeVariables& variables_;
  std::unordered_map<int32_t, Eigen::Index> first_;
  Matrix X_;
};

}  // namespace

std::vector<double> TreeCovariance::block(int32_t variable) const {
  const auto dof = static_cast<size_t>(store_.variables.dof(variable));
  if (store_.variables.clique_of(variable) < 0) return std::vector<double>(dof * dof, 0.0);  // held: it has none
  return PathForward(store_, variable).product();
}

std::vector<double> TreeCovariance::blocks(std::span<const int32_t> asked) const {
  if (asked.size() == 1) return block(asked.front());
  const TreeVariables& variables = store_.variables;
  std::unordered_map<int32_t, std::vector<size_t>> asked_of;  // a clique: where its variables' blocks go
  std::vector<size_t> offset(asked.size() + 1, 0);
  for (size_t i = 0; i < asked.size(); ++i) {
    const auto dof = static_cast<size_t>(variables.dof(asked[i]));
    offset[i + 1] = offset[i] + dof * dof;
    if (const int32_t c = variables.clique_of(asked[i]); c >= 0) asked_of[c].push_back(i);
  }
  std::vector<double> out(offset.back(), 0.0);  // held variables have none
  Paths paths(store_, asked);
  std::unordered_map<int32_t, Matrix> kept;
  for (const int32_t c : paths.order()) {
    const Clique& clique = paths.at(c);
    const int32_t parent = clique.parent;
    const Matrix above = parent < 0 ? Matrix() : rows_of_parent(clique, paths.at(parent), kept.at(parent), variables);
    Matrix Z = clique_inverse(clique, above);
    if (const auto here = asked_of.find(c); here != asked_of.end()) {
      const auto place = places_in(clique, variables);
      for (const size_t i : here->second) {
        const Eigen::Index first = place.at(asked[i]), d = variables.dof(asked[i]);
        Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(out.data() + offset[i], d, d) =
            Z.block(first, first, d, d);
      }
    }
    if (parent >= 0 && paths.last_of(parent)) kept.erase(parent);
    if (paths.awaited(c)) kept.emplace(c, std::move(Z));
  }
  return out;
}

std::vector<double> TreeCovariance::joint(std::span<const int32_t> asked) const {
  const TreeVariables& variables = store_.variables;
  Eigen::Index size = 0;
  for (const int32_t v : asked) size += variables.dof(v);
  const Paths paths(store_, asked);
  PathSolve solve(paths, variables, size);
  std::vector<Eigen::Index> place;  // of each asked scalar; -1: held
  for (const int32_t v : asked)
    for (int32_t k = 0; k < variables.dof(v); ++k) {
      const bool held = variables.clique_of(v) < 0;
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

Eigen::MatrixXd TreeCovariance::projected(std::span<const int32_t> of, const Eigen::MatrixXd& J) const {
  const TreeVariables& variables = store_.variables;
  const Paths paths(store_, of);
  PathSolve solve(paths, variables, J.rows());
  Eigen::Index column = 0;
  for (const int32_t v : of) {
    const Eigen::Index d = variables.dof(v);
    if (variables.clique_of(v) >= 0) solve.X().middleRows(solve.first(v), d) += J.middleCols(column, d).transpose();
    column += d;
  }
  solve.forward();
  return solve.X().transpose() * solve.X();
}

}  // namespace heliograph
