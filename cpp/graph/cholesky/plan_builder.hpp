// SPDX-License-Identifier: MIT
// Lays out fronts, places factors in them and links children to parents.
#pragma once
#include <algorithm>
#include <numeric>
#include <span>
#include <utility>
#include <vector>

#include "graph/cholesky/plan.hpp"
#include "graph/ordering/supernodes.hpp"

namespace heliograph {

inline int32_t round_up_four(int32_t n) { return (n + 3) & ~3; }

// `EachFactor` calls visit(kind, linearised block, nodes of its variables) for every factor; -1 is a variable that is held.
template <typename EachFactor>
class PlanBuilder {
 public:
  // `whole`: all blocks of a factor go into the front that eliminates its first variable, even those that it hands on, so that
  // a front can be made again without what lies above it. Otherwise each goes where its own first variable is eliminated.
  PlanBuilder(EachFactor each, std::span<const int32_t> weight, Supernodes supernodes, bool whole = false)
      : each_(std::move(each)), weight_(weight), super_(std::move(supernodes)), local_(weight.size(), -1), whole_(whole) {}

  // `elements` are fronts of an earlier elimination, only their rows known: they follow the new fronts, and their remainders
  // go into the fronts that take them.
  Plan build(const Elements& elements = {}) {
    lay_out_fronts();
    append_elements(elements);
    place_factors();
    link_children();
    resolve_places();
    if (elements.size() == 0) lay_out_arenas();
    return std::move(plan_);
  }

 private:
  int32_t weight(int32_t node) const { return plan_.weight[static_cast<size_t>(node)]; }

  void lay_out_fronts() {
    plan_.weight.assign(weight_.begin(), weight_.end());
    plan_.scalar_of.resize(weight_.size());
    plan_.front_of.resize(weight_.size());
    plan_.fronts.resize(super_.size());
    for (size_t s = 0; s < super_.size(); ++s) {
      FrontView& front = plan_.fronts[s];
      front.parent = super_.parent[s];
      front.first_pivot = plan_.scalars;
      front.node_begin = static_cast<int32_t>(plan_.nodes.size());
      for (int64_t i = super_.pivot_begin[s]; i < super_.pivot_begin[s + 1]; ++i) {
        const int32_t node = super_.pivots[static_cast<size_t>(i)];
        plan_.nodes.push_back(node);
        plan_.scalar_of[static_cast<size_t>(node)] = plan_.scalars;
        plan_.front_of[static_cast<size_t>(node)] = static_cast<int32_t>(s);
        plan_.scalars += weight(node);
      }
      front.pivots = plan_.scalars - front.first_pivot;
      front.node_pivots = static_cast<int32_t>(plan_.nodes.size()) - front.node_begin;
      for (int64_t i = super_.row_begin[s]; i < super_.row_begin[s + 1]; ++i) {
        const int32_t node = super_.rows[static_cast<size_t>(i)];
        plan_.nodes.push_back(node);
        front.rows += weight(node);
      }
      front.node_end = static_cast<int32_t>(plan_.nodes.size());
      front.update_height = round_up_four(front.rows + 1);
      front.height = round_up_four(front.pivots + front.update_height);
      front.factor = plan_.factor_size;
      plan_.factor_size += int64_t{front.height} * front.pivots;
      plan_.largest_rows = std::max(plan_.largest_rows, front.rows);
      const double k = front.pivots, m = front.rows;
      plan_.flops += k * k * k / 3.0 + k * k * (m + 1.0) + k * (m + 1.0) * (m + 1.0);
    }
  }

  void append_elements(const Elements& elements) {
    for (size_t e = 0; e < elements.size(); ++e) {
      FrontView front;
      front.parent = super_.taker[e];
      front.node_begin = static_cast<int32_t>(plan_.nodes.size());
      for (int32_t i = elements.begin[e]; i < elements.begin[e + 1]; ++i) {
        const int32_t node = elements.nodes[static_cast<size_t>(i)];
        plan_.nodes.push_back(node);
        front.rows += weight(node);
      }
      front.node_end = static_cast<int32_t>(plan_.nodes.size());
      front.update_height = round_up_four(front.rows + 1);
      plan_.fronts.push_back(front);
    }
  }

  // The front in which the earlier of two nodes is eliminated holds their block.
  bool before(int32_t a, int32_t b) const {
    return super_.position[static_cast<size_t>(a)] < super_.position[static_cast<size_t>(b)];
  }

  // The node in whose front the block of nodes a and b is placed.
  int32_t place_of(int32_t a, int32_t b, int32_t first) const {
    if (whole_) return first;
    return before(b, a) ? b : a;
  }

  int32_t first_of(const int32_t* scope, int arity) const {
    int32_t first = -1;
    for (int a = 0; a < arity; ++a)
      if (scope[a] >= 0 && (first < 0 || before(scope[a], first))) first = scope[a];
    return first;
  }

  FrontView& front_of(int32_t node) {
    return plan_.fronts[static_cast<size_t>(plan_.front_of[static_cast<size_t>(node)])];
  }

  // Counts, then fills; until `resolve_places` the row and column of a part hold node numbers.
  void place_factors() {
    each_([&](const FactorGroup& group, const double*, const int32_t* scope) {
      const int32_t first = first_of(scope, group.arity);
      for (int a = 0; a < group.arity; ++a) {
        if (scope[a] < 0) continue;
        ++front_of(place_of(scope[a], scope[a], first)).gradient_end;
        for (int b = a; b < group.arity; ++b)
          if (scope[b] >= 0) ++front_of(place_of(scope[a], scope[b], first)).block_end;
      }
    });
    int64_t blocks = 0, gradients = 0;
    for (FrontView& front : plan_.fronts) {
      front.block_begin = std::exchange(blocks, blocks + front.block_end);
      front.gradient_begin = std::exchange(gradients, gradients + front.gradient_end);
      front.block_end = front.block_begin;
      front.gradient_end = front.gradient_begin;
    }
    plan_.blocks.resize(static_cast<size_t>(blocks));
    plan_.gradients.resize(static_cast<size_t>(gradients));
    each_([&](const FactorGroup& group, const double* source, const int32_t* scope) { place_factor(group, source, scope); });
  }

  void place_factor(const FactorGroup& group, const double* source, const int32_t* scope) {
    const int32_t first = first_of(scope, group.arity);
    for (int a = 0; a < group.arity; ++a)
      for (int b = a; b < group.arity; ++b) {
        const int rows = group.dof[static_cast<size_t>(a)], columns = group.dof[static_cast<size_t>(b)];
        if (scope[a] >= 0 && scope[b] >= 0) {
          const bool swap = before(scope[b], scope[a]);  // then H_ab lies below the diagonal as it is
          FrontView& front = front_of(place_of(scope[a], scope[b], first));
          BlockView& part = plan_.blocks[static_cast<size_t>(front.block_end++)];
          part.source = source;
          part.row = swap ? scope[a] : scope[b];
          part.column = swap ? scope[b] : scope[a];
          part.rows = static_cast<int16_t>(swap ? rows : columns);
          part.columns = static_cast<int16_t>(swap ? columns : rows);
          part.transposed = swap ? 1 : 0;
        }
        source += rows * columns;
      }
    for (int a = 0; a < group.arity; ++a) {
      const int count = group.dof[static_cast<size_t>(a)];
      if (scope[a] >= 0) {
        FrontView& front = front_of(place_of(scope[a], scope[a], first));
        plan_.gradients[static_cast<size_t>(front.gradient_end++)] = {source, scope[a], count};
      }
      source += count;
    }
  }

  void link_children() {
    std::vector<int32_t> count(plan_.fronts.size() + 1, 0);
    for (const FrontView& front : plan_.fronts)
      if (front.parent >= 0) ++count[static_cast<size_t>(front.parent) + 1];
    std::partial_sum(count.begin(), count.end(), count.begin());
    plan_.children.resize(static_cast<size_t>(count.back()));
    for (size_t s = 0; s < plan_.fronts.size(); ++s)
      plan_.fronts[s].child_begin = plan_.fronts[s].child_end = count[s];
    for (size_t s = 0; s < plan_.fronts.size(); ++s)
      if (plan_.fronts[s].parent >= 0) {
        FrontView& parent = plan_.fronts[static_cast<size_t>(plan_.fronts[s].parent)];
        plan_.children[static_cast<size_t>(parent.child_end++)] = static_cast<int32_t>(s);
      }
  }

  void resolve_places() {
    for (FrontView& front : plan_.fronts) {
      int32_t scalar = 0;
      for (int32_t i = front.node_begin; i < front.node_end; ++i) {
        const int32_t node = plan_.nodes[static_cast<size_t>(i)];
        local_[static_cast<size_t>(node)] = scalar;
        scalar += weight(node);
      }
      for (int64_t i = front.block_begin; i < front.block_end; ++i) {
        BlockView& part = plan_.blocks[static_cast<size_t>(i)];
        part.row = local_[static_cast<size_t>(part.row)];
        part.column = local_[static_cast<size_t>(part.column)];
      }
      for (int64_t i = front.gradient_begin; i < front.gradient_end; ++i) {
        GradientView& part = plan_.gradients[static_cast<size_t>(i)];
        part.column = local_[static_cast<size_t>(part.column)];
      }
      for (int32_t i = front.child_begin; i < front.child_end; ++i)
        make_runs(plan_.fronts[static_cast<size_t>(plan_.children[static_cast<size_t>(i)])]);
    }
  }

  void make_runs(FrontView& child) {
    child.run_begin = static_cast<int64_t>(plan_.runs.size());
    int32_t from = 0;
    for (int32_t i = child.node_begin + child.node_pivots; i < child.node_end; ++i) {
      const int32_t node = plan_.nodes[static_cast<size_t>(i)];
      const int32_t to = local_[static_cast<size_t>(node)];
      if (child.runs > 0 && plan_.runs.back().to + plan_.runs.back().count == to) {
        plan_.runs.back().count += weight(node);
      } else {
        plan_.runs.push_back({from, weight(node), to});
        ++child.runs;
      }
      from += weight(node);
    }
  }

  // Two stacks by the parity of depth: a front's remainder goes on one side while its children's lie on top of the other.
  void lay_out_arenas() {
    std::vector<int32_t> depth(plan_.fronts.size(), 0);
    for (size_t s = plan_.fronts.size(); s-- > 0;)
      if (plan_.fronts[s].parent >= 0) depth[s] = depth[static_cast<size_t>(plan_.fronts[s].parent)] + 1;
    int64_t top[2] = {0, 0};
    for (size_t s = 0; s < plan_.fronts.size(); ++s) {
      FrontView& front = plan_.fronts[s];
      front.side = depth[s] & 1;
      front.update = top[front.side];
      top[front.side] += int64_t{front.update_height} * front.rows;
      plan_.arena_size[front.side] = std::max(plan_.arena_size[front.side], top[front.side]);
      if (front.child_begin < front.child_end)
        top[1 - front.side] = plan_.fronts[static_cast<size_t>(plan_.children[static_cast<size_t>(front.child_begin)])].update;
    }
  }

  EachFactor each_;
  std::span<const int32_t> weight_;
  Supernodes super_;
  Plan plan_;
  std::vector<int32_t> local_;
  bool whole_;
};

}  // namespace heliograph
