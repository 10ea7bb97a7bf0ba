// SPDX-License-Identifier: MIT
#include "graph/plan.hpp"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

#include "graph/supernodes.hpp"

namespace heliograph {

namespace {

int32_t round_up4(int32_t n) { return (n + 3) & ~3; }

// Calls visit(group, factor, nodes of its variables), -1 for a variable that is held.
template <typename Visit>
void each_factor(std::span<const FactorGroup> groups, const Nodes& nodes, Visit&& visit) {
  std::array<int32_t, kMaxArity> scope{};
  for (const FactorGroup& group : groups)
    for (size_t i = 0; i < group.count; ++i) {
      const int32_t* variables = group.variables.data() + i * static_cast<size_t>(group.arity);
      for (int a = 0; a < group.arity; ++a)
        scope[static_cast<size_t>(a)] = nodes.node_of[static_cast<size_t>(variables[a])];
      visit(group, i, scope.data());
    }
}

// Repeats and order put right row by row.
void tidy(Adjacency& graph) {
  int64_t write = 0, begin = 0;
  for (size_t i = 0; i < graph.size(); ++i) {
    const int64_t end = graph.offset[i + 1];
    const auto first = graph.neighbour.begin() + begin;
    std::sort(first, graph.neighbour.begin() + end);
    const auto last = std::unique(first, graph.neighbour.begin() + end);
    const int64_t count = last - first;
    std::copy(first, last, graph.neighbour.begin() + write);
    begin = end;
    write += count;
    graph.offset[i + 1] = write;
  }
  graph.neighbour.resize(static_cast<size_t>(write));
}

class PlanBuilder {
 public:
  PlanBuilder(std::span<const FactorGroup> groups, const double* blocks, const Nodes& nodes, Supernodes supernodes)
      : groups_(groups), blocks_(blocks), nodes_(nodes), super_(std::move(supernodes)), local_(nodes.weight.size(), -1) {}

  Plan build() {
    lay_out_fronts();
    place_factors();
    link_children();
    resolve_places();
    lay_out_arenas();
    return std::move(plan_);
  }

 private:
  int32_t weight(int32_t node) const { return plan_.weight[static_cast<size_t>(node)]; }

  void lay_out_fronts() {
    plan_.weight = nodes_.weight;
    plan_.scalar_of.resize(nodes_.weight.size());
    plan_.front_of.resize(nodes_.weight.size());
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
      front.update_height = round_up4(front.rows + 1);
      front.height = round_up4(front.pivots + front.update_height);
      front.factor = plan_.factor_size;
      plan_.factor_size += int64_t{front.height} * front.pivots;
      plan_.largest_rows = std::max(plan_.largest_rows, front.rows);
      const double k = front.pivots, m = front.rows;
      plan_.flops += k * k * k / 3.0 + k * k * (m + 1.0) + k * (m + 1.0) * (m + 1.0);
    }
  }

  // The front in which the earlier of two nodes is eliminated holds their block.
  bool before(int32_t a, int32_t b) const {
    return super_.position[static_cast<size_t>(a)] < super_.position[static_cast<size_t>(b)];
  }

  FrontView& front_of(int32_t node) {
    return plan_.fronts[static_cast<size_t>(plan_.front_of[static_cast<size_t>(node)])];
  }

  // Counts, then fills; until `resolve_places` the row and column of a part hold node numbers.
  void place_factors() {
    each_factor(groups_, nodes_, [&](const FactorGroup& group, size_t, const int32_t* scope) {
      for (int a = 0; a < group.arity; ++a) {
        if (scope[a] < 0) continue;
        ++front_of(scope[a]).gradient_end;
        for (int b = a; b < group.arity; ++b)
          if (scope[b] >= 0) ++front_of(before(scope[b], scope[a]) ? scope[b] : scope[a]).block_end;
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
    each_factor(groups_, nodes_, [&](const FactorGroup& group, size_t i, const int32_t* scope) {
      place_factor(group, blocks_ + group.block + i * block_size(group), scope);
    });
  }

  void place_factor(const FactorGroup& group, const double* source, const int32_t* scope) {
    for (int a = 0; a < group.arity; ++a)
      for (int b = a; b < group.arity; ++b) {
        const int rows = group.dof[static_cast<size_t>(a)], columns = group.dof[static_cast<size_t>(b)];
        if (scope[a] >= 0 && scope[b] >= 0) {
          const bool swap = before(scope[b], scope[a]);  // then H_ab lies below the diagonal as it is
          FrontView& front = front_of(swap ? scope[b] : scope[a]);
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
      if (scope[a] >= 0) plan_.gradients[static_cast<size_t>(front_of(scope[a]).gradient_end++)] = {source, scope[a], count};
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

  std::span<const FactorGroup> groups_;
  const double* blocks_;
  const Nodes& nodes_;
  Supernodes super_;
  Plan plan_;
  std::vector<int32_t> local_;
};

}  // namespace

Adjacency adjacency_of(std::span<const FactorGroup> groups, const Nodes& nodes) {
  Adjacency graph;
  graph.offset.assign(nodes.weight.size() + 1, 0);
  const auto pairs = [&](auto&& visit) {
    each_factor(groups, nodes, [&](const FactorGroup& group, size_t, const int32_t* scope) {
      for (int a = 0; a < group.arity; ++a)
        for (int b = a + 1; b < group.arity; ++b)
          if (scope[a] >= 0 && scope[b] >= 0 && scope[a] != scope[b]) visit(scope[a], scope[b]);
    });
  };
  pairs([&](int32_t a, int32_t b) {
    ++graph.offset[static_cast<size_t>(a) + 1];
    ++graph.offset[static_cast<size_t>(b) + 1];
  });
  std::partial_sum(graph.offset.begin(), graph.offset.end(), graph.offset.begin());
  graph.neighbour.resize(static_cast<size_t>(graph.offset.back()));
  std::vector<int64_t> fill(graph.offset.begin(), graph.offset.end() - 1);
  pairs([&](int32_t a, int32_t b) {
    graph.neighbour[static_cast<size_t>(fill[static_cast<size_t>(a)]++)] = b;
    graph.neighbour[static_cast<size_t>(fill[static_cast<size_t>(b)]++)] = a;
  });
  tidy(graph);
  return graph;
}

Plan make_plan(std::span<const FactorGroup> groups, const double* blocks, const Nodes& nodes, const Adjacency& graph,
               std::span<const int32_t> order) {
  return PlanBuilder(groups, blocks, nodes, find_supernodes(graph, nodes.weight, order)).build();
}

}  // namespace heliograph
