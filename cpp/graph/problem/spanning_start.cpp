// SPDX-License-Identifier: MIT
#include "graph/problem/spanning_start.hpp"

#include <Eigen/Core>
#include <cmath>

namespace heliograph {

namespace {

// Edges at each pose, in the order of the edges.
struct Incidence {
  std::vector<int64_t> offset;
  std::vector<int32_t> edge;
};

Incidence incidence_of(size_t n, std::span<const int32_t> i, std::span<const int32_t> j) {
  Incidence out;
  out.offset.assign(n + 1, 0);
  for (size_t e = 0; e < i.size(); ++e) {
    ++out.offset[static_cast<size_t>(i[e]) + 1];
    if (i[e] != j[e]) ++out.offset[static_cast<size_t>(j[e]) + 1];
  }
  for (size_t v = 0; v < n; ++v) out.offset[v + 1] += out.offset[v];
  out.edge.resize(static_cast<size_t>(out.offset[n]));
  std::vector<int64_t> at(out.offset.begin(), out.offset.end() - 1);
  for (size_t e = 0; e < i.size(); ++e) {
    out.edge[static_cast<size_t>(at[static_cast<size_t>(i[e])]++)] = static_cast<int32_t>(e);
    if (i[e] != j[e]) out.edge[static_cast<size_t>(at[static_cast<size_t>(j[e])]++)] = static_cast<int32_t>(e);
  }
  return out;
}

template <int D>
using Pose = Eigen::Matrix<double, D + 1, D + 1, Eigen::RowMajor>;

// A product of a million rotations drifts off the group; one Newton step towards R'R = 1 a product keeps it there.
template <int D>
void orthonormalise(Pose<D>* T) {
  const Eigen::Matrix<double, D, D> R = T->template topLeftCorner<D, D>();
  const Eigen::Matrix<double, D, D> correction = 1.5 * Eigen::Matrix<double, D, D>::Identity() - 0.5 * (R.transpose() * R);
  T->template topLeftCorner<D, D>().noalias() = R * correction;
}

template <int D>
Pose<D> inverse(const Pose<D>& T) {
  Pose<D> out = Pose<D>::Identity();
  const Eigen::Matrix<double, D, D> R = T.template topLeftCorner<D, D>().transpose();
  out.template topLeftCorner<D, D>() = R;
  out.template topRightCorner<D, 1>().noalias() = -R * T.template topRightCorner<D, 1>();
  return out;
}

template <int D>
class Spanning {
 public:
  Spanning(size_t n, std::span<const int32_t> i, std::span<const int32_t> j, std::span<const double> relative)
      : n_(n), i_(i), j_(j), relative_(relative), incidence_(incidence_of(n, i, j)) {
    out_.pose.resize(n * kSize);
    out_.root.assign(n, -1);
    out_.parent.assign(n, -1);
  }

  SpanningStart run() {
    std::vector<int32_t> queue;
    queue.reserve(n_);
    for (size_t root = 0; root < n_; ++root) {
      if (out_.root[root] >= 0) continue;
      Eigen::Map<Pose<D>>(pose(root)).setIdentity();
      out_.root[root] = out_.parent[root] = static_cast<int32_t>(root);
      queue.assign(1, static_cast<int32_t>(root));
      for (size_t v = root + 1; v < n_ && out_.root[v] < 0 && follow(v); ++v) queue.push_back(static_cast<int32_t>(v));
      for (size_t head = 0; head < queue.size(); ++head) spread(static_cast<size_t>(queue[head]), &queue);
    }
    return std::move(out_);
  }

 private:
  static constexpr size_t kSize = (D + 1) * (D + 1);

  double* pose(size_t v) { return out_.pose.data() + v * kSize; }

  // Places v from v - 1, if an edge joins them.
  bool follow(size_t v) {
    for (int64_t k = incidence_.offset[v]; k < incidence_.offset[v + 1]; ++k) {
      const auto e = static_cast<size_t>(incidence_.edge[static_cast<size_t>(k)]);
      if (other(e, v) == v - 1) return place(e, v - 1, v), true;
    }
    return false;
  }

  void spread(size_t v, std::vector<int32_t>* queue) {
    for (int64_t k = incidence_.offset[v]; k < incidence_.offset[v + 1]; ++k) {
      const auto e = static_cast<size_t>(incidence_.edge[static_cast<size_t>(k)]);
      const size_t w = other(e, v);
      if (out_.root[w] >= 0) continue;
      place(e, v, w);
      queue->push_back(static_cast<int32_t>(w));
    }
  }

  size_t other(size_t e, size_t v) const { return static_cast<size_t>(static_cast<size_t>(i_[e]) == v ? j_[e] : i_[e]); }

  void place(size_t e, size_t from, size_t to) {
    const Eigen::Map<const Pose<D>> Z(relative_.data() + e * kSize), T_from(pose(from));
    const Pose<D> step = static_cast<size_t>(i_[e]) == from ? Pose<D>(Z) : inverse<D>(Pose<D>(Z));
    Pose<D> T = T_from * step;
    orthonormalise<D>(&T);
    Eigen::Map<Pose<D>> placed(pose(to));
    placed = T;
    out_.root[to] = out_.root[from];
    out_.parent[to] = static_cast<int32_t>(from);
  }

  size_t n_;
  std::span<const int32_t> i_, j_;
  std::span<const double> relative_;
  Incidence incidence_;
  SpanningStart out_;
};

}  // namespace

SpanningStart spanning_start(int dimension, size_t n, std::span<const int32_t> i, std::span<const int32_t> j,
                             std::span<const double> relative) {
  if (dimension == 2) return Spanning<2>(n, i, j, relative).run();
  return Spanning<3>(n, i, j, relative).run();
}

}  // namespace heliograph
