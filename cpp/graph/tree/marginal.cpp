// SPDX-License-Identifier: MIT
#include "graph/tree/marginal.hpp"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace heliograph {

namespace {

// Adds a summary to one that has all its variables. Both are lower triangles by columns, the gradient in one more row.
void add_summary(const Clique& from, const Clique& to, const TreeVariables& variables) {
  std::vector<int32_t> place;  // of each scalar
  for (const int32_t node : from.nodes) {
    int32_t at = 0;
    for (const int32_t other : to.nodes) {
      if (other == node) break;
      at += variables.dof(other);
    }
    for (int32_t k = 0; k < variables.dof(node); ++k) place.push_back(at + k);
  }
  for (int32_t column = 0; column < from.rows; ++column) {
    const double* source = from.update + static_cast<int64_t>(column) * from.update_height;
    const int32_t c = place[static_cast<size_t>(column)];
    for (int32_t row = column; row < from.rows; ++row) {
      const int32_t r = place[static_cast<size_t>(row)];
      to.update[static_cast<int64_t>(std::min(r, c)) * to.update_height + std::max(r, c)] += source[row];
    }
    to.update[static_cast<int64_t>(c) * to.update_height + to.rows] += source[from.rows];
  }
}

bool has_all(const Clique& clique, const Clique& of) {
  return std::all_of(of.nodes.begin(), of.nodes.end(), [&](int32_t node) {
    return std::find(clique.nodes.begin(), clique.nodes.end(), node) != clique.nodes.end();
  });
}

}  // namespace

void TreeMarginal::leave(std::span<const int32_t> variables, TreeJournal& journal, TreeTop& top) {
  for (const int32_t v : variables)
    if (!store_.variables.has_slot(v) || store_.variables.clique_of(v) < 0)
      throw std::invalid_argument("a variable that is held or that there is not");
  for (const int32_t v : variables) {
    if (journal.marks(v) != 0) continue;
    top.mark_with(v);
    journal.mark_leaving(v);
    leaving_.push_back(v);
  }
}

std::vector<int32_t> TreeMarginal::drop(std::span<const int32_t> made) {
  std::vector<int32_t> sorted(leaving_);
  std::sort(sorted.begin(), sorted.end());
  const auto leaves = [&](int32_t c) {
    const Clique& clique = store_.cliques[c];
    return clique.pivot_nodes > 0 && std::binary_search(sorted.begin(), sorted.end(), clique.nodes.front());
  };
  std::vector<int32_t> tops, dropped;
  for (const int32_t c : made) {
    const int32_t parent = store_.cliques[c].parent;
    if (leaves(c) && (parent < 0 || !leaves(parent))) tops.push_back(c);
  }
  for (const int32_t c : tops) {
    forget_below(c, dropped);
    summarize(c);
  }
  for (size_t i = leaving_.size(); i-- > 0;) store_.variables.give_back(leaving_[i]);
  leaving_.clear();
  return dropped;
}

// Drops the factors of a clique and all that hangs below it; there is nothing below that does not leave with it.
void TreeMarginal::forget_below(int32_t index, std::vector<int32_t>& dropped) {
  std::vector<int32_t> stack{index};
  while (!stack.empty()) {
    const int32_t at = stack.back();
    stack.pop_back();
    store_.cliques.each_child(at, [&](int32_t child) { stack.push_back(child); });
    for (int32_t f = store_.cliques[at].first_factor; f >= 0;) {
      const int32_t next = store_.factors[f].next;
      store_.factors.drop(f);
      dropped.push_back(std::exchange(f, next));
    }
    if (at != index) store_.cliques.release(at);
  }
  store_.cliques[index].child = -1;
  store_.cliques[index].first_factor = -1;
}

// A clique loses its pivots.
void TreeMarginal::summarize(int32_t index) {
  Clique& clique = store_.cliques[index];
  store_.cliques.give_back_block(clique.factor, clique.factor_doubles());
  clique.factor = nullptr;
  clique.nodes.erase(clique.nodes.begin(), clique.nodes.begin() + clique.pivot_nodes);
  clique.pivot_nodes = clique.pivots = clique.height = 0;
  for (const int32_t v : clique.nodes) store_.variables.freeze(v);
  if (clique.nodes.empty()) {  // it was all of its part of the graph
    store_.cliques.unlink(index);
    store_.cliques.release(index);
    return;
  }
  merge_summary(index);
}

// Summaries of the same variables become one, so that their number does not grow with what has left.
void TreeMarginal::merge_summary(int32_t index) {
  TreeCliques& cliques = store_.cliques;
  std::vector<int32_t> others;
  cliques.each_child(cliques[index].parent, [&](int32_t c) {
    if (c != index && cliques[c].pivot_nodes == 0) others.push_back(c);
  });
  int32_t into = index;
  for (const int32_t c : others) {
    const Clique &a = cliques[into], &b = cliques[c];
    const bool keep = has_all(a, b);
    if (!keep && !has_all(b, a)) continue;
    add_summary(keep ? b : a, keep ? a : b, store_.variables);
    const int32_t gone = keep ? c : std::exchange(into, c);
    cliques.unlink(gone);
    cliques.release(gone);
  }
}

}  // namespace heliograph
