// SPDX-License-Identifier: MIT
#include "graph/tree/top.hpp"

#include <algorithm>
#include <limits>
#include <numeric>

namespace heliograph {

namespace {

Adjacency adjacency_from(std::span<const std::pair<int32_t, int32_t>> edges, size_t nodes) {
  Adjacency graph;
  graph.offset.assign(nodes + 1, 0);
  for (const auto& [a, b] : edges) {
    ++graph.offset[static_cast<size_t>(a) + 1];
    ++graph.offset[static_cast<size_t>(b) + 1];
  }
  std::partial_sum(graph.offset.begin(), graph.offset.end(), graph.offset.begin());
  graph.neighbour.resize(static_cast<size_t>(graph.offset.back()));
  std::vector<int64_t> fill(graph.offset.begin(), graph.offset.end() - 1);
  for (const auto& [a, b] : edges) {
    graph.neighbour[static_cast<size_t>(fill[static_cast<size_t>(a)]++)] = b;
    graph.neighbour[static_cast<size_t>(fill[static_cast<size_t>(b)]++)] = a;
  }
  tidy(graph);
  return graph;
}

std::span<const int32_t> members(const Elements& elements, size_t e) {
  const auto begin = static_cast<size_t>(elements.begin[e]), end = static_cast<size_t>(elements.begin[e + 1]);
  return std::span(elements.nodes).subspan(begin, end - begin);
}

}  // namespace

void TreeTop::mark_up(int32_t clique) {
  while (clique >= 0 && !marked(clique)) {
    store_.cliques[clique].flagged = update_number_;
    taken_.push_back(clique);
    clique = store_.cliques[clique].parent;
  }
}

void TreeTop::mark_with(int32_t variable) {
  std::vector<int32_t> stack;
  const auto push_if_named = [&](int32_t c) {
    const Clique& clique = store_.cliques[c];
    const auto rows = clique.nodes.begin() + clique.first_row();
    if (rows != clique.nodes.begin() && std::find(rows, clique.nodes.end(), variable) != clique.nodes.end())  // no summary
      stack.push_back(c);
  };
  if (store_.variables.clique_of(variable) >= 0) {
    stack.push_back(store_.variables.clique_of(variable));
  } else if (open_) {
    for (const int32_t c : part_.orphans) push_if_named(c);
  }
  while (!stack.empty()) {
    const int32_t at = stack.back();
    stack.pop_back();
    mark_up(at);
    store_.cliques.each_child(at, push_if_named);
  }
}

void TreeTop::detach(TreeJournal& journal) {
  if (open_) carried_ = part_;
  detached_ = true;
  for (const int32_t v : journal.put_back()) mark_with(v);
  journal.mark_relinearized();
  for (const int32_t v : journal.touched()) mark_up(store_.variables.clique_of(v));
  auto& [affected, orphans, factors] = part_;
  const auto stays = [&](int32_t f) { return store_.factors[f].speaks(); };
  std::erase_if(orphans, [&](int32_t c) { return marked(c); });  // left over from the last slice, like open factors
  std::erase_if(factors, [&](int32_t f) { return !stays(f); });
  std::sort(taken_.begin(), taken_.end());  // not the order of discovery: the result does not depend on it
  for (const int32_t c : taken_) {
    const Clique& clique = store_.cliques[c];
    affected.insert(affected.end(), clique.nodes.begin(), clique.nodes.begin() + clique.pivot_nodes);
    for (int32_t f = clique.first_factor; f >= 0; f = store_.factors[f].next)
      if (stays(f)) factors.push_back(f);
    store_.cliques.each_child(c, [&](int32_t child) {
      if (!marked(child)) orphans.push_back(child);
    });
  }
  for (const int32_t v : journal.fresh())
    if (!store_.variables.held(v)) affected.push_back(v);
  std::sort(affected.begin(), affected.end());
  for (const std::vector<int32_t>* list : {&journal.loose(), &journal.taken_back()})
    std::copy_if(list->begin(), list->end(), std::back_inserter(factors), stays);
  std::sort(factors.begin(), factors.end());
  number();
  if (journal.relinearized().empty()) return;
  const auto moved = [&](int32_t v) { return (journal.marks(v) & TreeJournal::kRelinearized) != 0; };
  for (const int32_t f : factors) {
    const auto scope = store_.factors.scope(store_.factors[f]);
    if (std::any_of(scope.begin(), scope.end(), moved)) store_.factors[f].stale = 1;
  }
}

void TreeTop::number() {
  node_of_.resize(store_.variables.slots(), -1);
  for (size_t i = 0; i < part_.affected.size(); ++i)
    node_of_[static_cast<size_t>(part_.affected[i])] = static_cast<int32_t>(i);
}

void TreeTop::forget_numbers() {
  for (const int32_t v : part_.affected)
    if (static_cast<size_t>(v) < node_of_.size()) node_of_[static_cast<size_t>(v)] = -1;
}

Elements TreeTop::elements() const {
  Elements out;
  for (const int32_t c : part_.orphans) {
    const Clique& clique = store_.cliques[c];
    for (int32_t i = clique.first_row(); i < clique.node_count(); ++i) out.nodes.push_back(node_of(clique.node(i)));
    out.begin.push_back(static_cast<int32_t>(out.nodes.size()));
  }
  return out;
}

TreeTop::Edges TreeTop::factor_edges() const {
  Edges edges;
  for (const int32_t f : part_.factors) {
    const auto scope = store_.factors.scope(store_.factors[f]);
    for (size_t a = 0; a < scope.size(); ++a)
      for (size_t b = a + 1; b < scope.size(); ++b) {
        const int32_t i = node_of(scope[a]), j = node_of(scope[b]);
        if (i >= 0 && j >= 0) edges.emplace_back(i, j);
      }
  }
  return edges;
}

Adjacency TreeTop::quotient_graph(const Elements& elements) const {
  Edges edges = factor_edges();
  const auto first = static_cast<int32_t>(part_.affected.size());
  for (size_t e = 0; e < elements.size(); ++e)
    for (const int32_t member : members(elements, e)) edges.emplace_back(first + static_cast<int32_t>(e), member);
  return adjacency_from(edges, part_.affected.size() + elements.size());
}

Adjacency TreeTop::chained_graph(const Elements& elements, std::span<const int32_t> position) const {
  Edges edges = factor_edges();
  const auto earlier = [&](int32_t a, int32_t b) { return position[static_cast<size_t>(a)] < position[static_cast<size_t>(b)]; };
  std::vector<int32_t> chain;
  for (size_t e = 0; e < elements.size(); ++e) {
    const auto all = members(elements, e);
    chain.assign(all.begin(), all.end());
    std::sort(chain.begin(), chain.end(), earlier);
    for (size_t i = 1; i < chain.size(); ++i) edges.emplace_back(chain[i - 1], chain[i]);
  }
  return adjacency_from(edges, part_.affected.size());
}

size_t TreeTop::front_of(const Plan& plan, const TreeFactor& factor) const {
  int32_t first = std::numeric_limits<int32_t>::max();
  for (const int32_t v : store_.factors.scope(factor))
    if (const int32_t node = node_of(v); node >= 0) first = std::min(first, plan.front_of[static_cast<size_t>(node)]);
  return static_cast<size_t>(first);
}

TreeTop::Part TreeTop::exchange(Part part) {
  forget_numbers();
  std::swap(part_, part);
  number();
  return part;
}

void TreeTop::close(Part rest) {
  finish(std::move(rest));
  open_ = !part_.affected.empty();
}

void TreeTop::roll_back() {
  Part before;
  if (open_) before = detached_ ? std::move(carried_) : part_;
  finish(std::move(before));
}

void TreeTop::finish(Part next) {
  forget_numbers();
  taken_.clear();
  part_ = std::move(next);
  detached_ = false;
  ++update_number_;
}

}  // namespace heliograph
