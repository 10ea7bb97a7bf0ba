// SPDX-License-Identifier: MIT
#include "graph/cholesky/selected_inverse.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <functional>
#include <numeric>

namespace heliograph {

namespace {

using Matrix = Eigen::MatrixXd;
using Columns = Eigen::Map<const Matrix, 0, Eigen::OuterStride<>>;

}  // namespace

class SelectedInverse::Fronts {
 public:
  Fronts(const Multifrontal& factorization, size_t most_doubles)
      : plan_(factorization.plan()), factor_(factorization.factor()), kept_(plan_.fronts.size()),
        waiting_(plan_.fronts.size(), 0), wanted_(plan_.fronts.size(), 0), loaned_(plan_.fronts.size(), 0),
        room_(most_doubles) {}

  const Plan& plan() const { return plan_; }

  // Calls found(front, its block of the inverse: pivots, then rows) for the fronts of the nodes, from the roots down.
  template <typename Found>
  void run(std::span<const int32_t> nodes, Found&& found) {
    std::vector<size_t> path;
    for (const int32_t node : nodes)
      for (int32_t front = plan_.front_of[at(node)]; front >= 0 && wanted_[at(front)] == 0; front = plan_.fronts[at(front)].parent) {
        wanted_[at(front)] = 1;
        path.push_back(at(front));
        if (kept_[at(front)]) break;  // and so are those above it, or they are not needed
      }
    std::sort(path.begin(), path.end(), std::greater<>());
    for (const size_t s : path)
      if (!kept_[s] && plan_.fronts[s].parent >= 0) ++waiting_[at(plan_.fronts[s].parent)];
    for (const size_t s : path) {
      wanted_[s] = 0;
      const FrontView& front = plan_.fronts[s];
      const bool there = kept_[s] != nullptr;
      auto fresh = there ? nullptr : std::make_unique<Matrix>(front_inverse(front));
      found(s, there ? *kept_[s] : *fresh);
      if (there) continue;
      const auto size = static_cast<size_t>(fresh->size());
      const bool stays = size <= room_;
      if (stays) room_ -= size;
      if (stays || waiting_[s] > 0) kept_[s] = std::move(fresh);
      loaned_[s] = !stays && waiting_[s] > 0;
      if (front.parent < 0) continue;
      const size_t parent = at(front.parent);
      if (--waiting_[parent] == 0 && loaned_[parent] != 0) {
        kept_[parent].reset();
        loaned_[parent] = 0;
      }
    }
  }

 private:
  static size_t at(int32_t i) { return static_cast<size_t>(i); }

  // With W = L21 L11^-1: Z21 = -Z22 W and Z11 = (L11 L11')^-1 - W' Z21.
  Matrix front_inverse(const FrontView& front) const {
    const Eigen::Index K = front.pivots, M = front.rows;
    const Columns L(factor_.data() + front.factor, K + M, K, Eigen::OuterStride<>(front.height));
    const auto L11 = L.topRows(K).triangularView<Eigen::Lower>();
    Matrix Z(K + M, K + M);
    const Matrix inverse = L11.solve(Matrix::Identity(K, K));
    Z.topLeftCorner(K, K).noalias() = inverse.transpose() * inverse;
    if (M == 0) return Z;
    const Matrix W = L.bottomRows(M) * inverse;
    const Matrix Z22 = rows_of_parent(front);
    Z.bottomRightCorner(M, M) = Z22;
    Z.bottomLeftCorner(M, K).noalias() = -Z22 * W;
    Z.topLeftCorner(K, K).noalias() -= W.transpose() * Z.bottomLeftCorner(M, K);
    Z.topRightCorner(K, M) = Z.bottomLeftCorner(M, K).transpose();
    return Z;
  }

  Matrix rows_of_parent(const FrontView& front) const {
    const Matrix& parent = *kept_[at(front.parent)];
    Matrix Z(front.rows, front.rows);
    const RunView* runs = plan_.runs.data() + front.run_begin;
    for (int32_t a = 0; a < front.runs; ++a)
      for (int32_t b = 0; b < front.runs; ++b)
        Z.block(runs[a].from, runs[b].from, runs[a].count, runs[b].count) =
            parent.block(runs[a].to, runs[b].to, runs[a].count, runs[b].count);
    return Z;
  }

  const Plan& plan_;
  std::span<const double> factor_;
  std::vector<std::unique_ptr<Matrix>> kept_;  // (fronts)
  std::vector<int32_t> waiting_;               // (fronts) children on the present paths that still need this one's block
  std::vector<uint8_t> wanted_;                // (fronts) on the present paths
  std::vector<uint8_t> loaned_;                // (fronts) kept for the children on the present paths alone
  size_t room_;                                // doubles that may still be kept
};

SelectedInverse::SelectedInverse(const Multifrontal& factorization, size_t most_doubles)
    : fronts_(std::make_unique<Fronts>(factorization, most_doubles)) {}

SelectedInverse::~SelectedInverse() = default;

std::vector<double> SelectedInverse::blocks(std::span<const int32_t> nodes) {
  const Plan& plan = fronts_->plan();
  std::vector<size_t> offset(nodes.size() + 1, 0);
  for (size_t i = 0; i < nodes.size(); ++i) {
    const auto d = static_cast<size_t>(plan.weight[static_cast<size_t>(nodes[i])]);
    offset[i + 1] = offset[i] + d * d;
  }
  // Which of the asked nodes each front eliminates, front by front.
  std::vector<size_t> asked(nodes.size());
  std::iota(asked.begin(), asked.end(), size_t{0});
  const auto front_of = [&](size_t i) { return plan.front_of[static_cast<size_t>(nodes[i])]; };
  std::stable_sort(asked.begin(), asked.end(), [&](size_t a, size_t b) { return front_of(a) < front_of(b); });
  std::vector<double> out(offset.back());
  fronts_->run(nodes, [&](size_t s, const Matrix& Z) {
    const FrontView& front = plan.fronts[s];
    auto at = std::lower_bound(asked.begin(), asked.end(), static_cast<int32_t>(s),
                               [&](size_t i, int32_t f) { return front_of(i) < f; });
    for (; at != asked.end() && front_of(*at) == static_cast<int32_t>(s); ++at) {
      const auto node = static_cast<size_t>(nodes[*at]);
      const int32_t first = plan.scalar_of[node] - front.first_pivot, d = plan.weight[node];
      for (int32_t r = 0; r < d; ++r)
        for (int32_t c = 0; c < d; ++c) out[offset[*at] + static_cast<size_t>(r * d + c)] = Z(first + r, first + c);
    }
  });
  return out;
}

}  // namespace heliograph
