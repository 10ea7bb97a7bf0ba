// SPDX-License-Identifier: MIT
#include "graph/tree/soundness.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "graph/factors/make_group.hpp"
#include "graph/factors/residual_kind.hpp"

namespace heliograph {

namespace {

constexpr uint32_t kMaxNumber = uint32_t{1} << 31;  // of updates and solves: they are counted on, and must not come round
constexpr int kMaxRows = 1 << 16;                   // of a residual
constexpr int kDofs[] = {0, 1, 3, 3, 6, 2, 9};      // of a manifold; 0: a vector's own

using Indices = std::vector<int32_t>;

void require(bool sound) {
  if (!sound) throw std::invalid_argument("the saved state is damaged: its parts do not belong together");
}

bool within(int32_t index, size_t size) { return index >= 0 && static_cast<size_t>(index) < size; }
size_t at(int32_t index) { return static_cast<size_t>(index); }
bool finite(const double* values, size_t count) {
  return std::all_of(values, values + count, [](double x) { return std::isfinite(x); });
}
bool finite(const std::vector<double>& values) { return finite(values.data(), values.size()); }
bool flags(const std::vector<uint8_t>& values) {
  return std::all_of(values.begin(), values.end(), [](uint8_t flag) { return flag <= 1; });
}

// What each index is, as the lists say: every member once.
std::vector<uint8_t> marked(const Indices& list, size_t size) {
  std::vector<uint8_t> mark(size, 0);
  for (const int32_t index : list) {
    require(within(index, size) && mark[at(index)] == 0);
    mark[at(index)] = 1;
  }
  return mark;
}

int32_t round_up_four(int64_t n) { return static_cast<int32_t>((n + 3) / 4 * 4); }

class Check {
 public:
  explicit Check(const StoredTree& tree)
      : variables_(tree.variables), factors_(tree.factors), cliques_(tree.cliques), tree_(tree), slots_(tree.variables.dof.size()) {}

  void all() {
    variables();
    cliques();
    top();
    kinds();
    factors();
    lists();
    hanging();
    steps();
    journal();
  }

 private:
  bool is_variable(int32_t v) const { return within(v, slots_) && free_variable_[at(v)] == 0; }
  bool is_clique(int32_t c) const { return within(c, cliques_.all.size()) && !cliques_.all[at(c)].nodes.empty(); }
  const Clique& clique(int32_t c) const { return cliques_.all[at(c)]; }
  const TreeFactor& factor(int32_t f) const { return factors_.factors[at(f)]; }
  size_t storage(int32_t v) const {
    return static_cast<size_t>(storage_of(variables_.manifold[at(v)], variables_.dof[at(v)]));
  }

  void variables() {
    const TreeVariables::Stored& v = variables_;
    for (const size_t size : {v.manifold.size(), v.theta_at.size(), v.delta_at.size(), v.clique_of.size(), v.changed.size(),
                              v.fluid_flag.size(), v.held.size(), v.frozen.size()})
      require(size == slots_);
    require(flags(v.fluid_flag) && flags(v.held) && flags(v.frozen) && finite(v.theta) && finite(v.delta));
    int64_t theta = 0, delta = 0;
    for (size_t i = 0; i < slots_; ++i) {
      const auto manifold = static_cast<int32_t>(v.manifold[i]);
      require(manifold >= 0 && manifold <= static_cast<int32_t>(Manifold::nav) && v.dof[i] >= 1 && v.dof[i] <= kMaxDof);
      require(manifold == 0 || v.dof[i] == kDofs[manifold]);
      require(v.theta_at[i] == theta && v.delta_at[i] == delta && v.changed[i] <= tree_.steps.solve_number);
      theta += storage_of(v.manifold[i], v.dof[i]);
      delta += v.dof[i];
    }
    require(v.theta.size() == static_cast<size_t>(theta) && v.delta.size() == static_cast<size_t>(delta));
    free_variables();
    const std::vector<uint8_t> fluid = marked(v.fluid, slots_);
    for (size_t i = 0; i < slots_; ++i)
      require(fluid[i] == v.fluid_flag[i] && (fluid[i] == 0 || (v.frozen[i] == 0 && free_variable_[i] == 0)));
  }

  void free_variables() {
    free_variable_.assign(slots_, 0);
    size_t count = 0;
    for (size_t family = 0; family < variables_.free.size(); ++family)
      for (const int32_t v : variables_.free[family]) {
        require(within(v, slots_) && free_variable_[at(v)] == 0 && variables_.clique_of[at(v)] == -1);
        require(family == TreeVariables::family_of(variables_.manifold[at(v)], variables_.dof[at(v)]));
        free_variable_[at(v)] = 1;
        ++count;
      }
    require(count == variables_.free_count);
  }

  void cliques() {
    const std::vector<uint8_t> is_free = marked(cliques_.free, cliques_.all.size());
    size_t pivots = 0;
    for (size_t c = 0; c < cliques_.all.size(); ++c) {
      const Clique& clique = cliques_.all[c];
      require(clique.unsolved <= 1 && clique.deferred <= 1 && clique.flagged < tree_.top.update_number);
      require(clique.solved <= tree_.steps.solve_number && (is_free[c] != 0) == clique.nodes.empty());
      if (is_free[c] != 0) {
        require(clique.parent == -1 && clique.child == -1 && clique.next == -1 && clique.previous == -1);
        require(clique.first_factor == -1 && clique.pivot_nodes == 0 && clique.pivots == 0 && clique.rows == 0);
        require(clique.height == 0 && clique.update_height == 0 && clique.deferred == 0 && clique.unsolved == 0);
        continue;
      }
      shape(clique);
      for (int32_t i = 0; i < clique.pivot_nodes; ++i) require(variables_.clique_of[at(clique.node(i))] == static_cast<int32_t>(c));
      pivots += at(clique.pivot_nodes);
    }
    size_t eliminated = 0;
    for (size_t v = 0; v < slots_; ++v) {
      const int32_t c = variables_.clique_of[v];
      require(c == -1 || (is_clique(c) && variables_.held[v] == 0));
      eliminated += c >= 0 ? 1 : 0;
    }
    require(eliminated == pivots);
  }

  void shape(const Clique& clique) {
    require(clique.pivot_nodes >= 0 && clique.pivot_nodes <= clique.node_count());
    Indices nodes(clique.nodes);
    std::sort(nodes.begin(), nodes.end());
    require(std::adjacent_find(nodes.begin(), nodes.end()) == nodes.end());
    int64_t pivots = 0, rows = 0;
    for (int32_t i = 0; i < clique.node_count(); ++i) {
      require(is_variable(clique.node(i)) && variables_.held[at(clique.node(i))] == 0);
      (i < clique.pivot_nodes ? pivots : rows) += variables_.dof[at(clique.node(i))];
    }
    require(clique.pivots == pivots && clique.rows == rows && clique.update_height == round_up_four(rows + 1));
    require(clique.height == (pivots > 0 ? round_up_four(pivots + clique.update_height) : 0));
    for (int32_t column = 0; column < clique.pivots; ++column) {  // what lies above the diagonal is never read
      const double* from = clique.factor + static_cast<int64_t>(column) * clique.height;
      require(from[column] > 0.0 && finite(from + column, at(clique.pivots + clique.rows + 1 - column)));
    }
    for (int32_t column = 0; column < clique.rows; ++column) {
      const double* from = clique.update + static_cast<int64_t>(column) * clique.update_height;
      require(finite(from + column, at(clique.rows + 1 - column)));
    }
  }

  // What waits to be eliminated, where an elimination is spread over several updates.
  void top() {
    const TreeTop::Stored& top = tree_.top;
    require(top.update_number >= 1 && top.update_number < kMaxNumber && tree_.steps.solve_number < kMaxNumber);
    require(top.open == !top.affected.empty() && (top.open || (top.orphans.empty() && top.factors.empty())));
    affected_ = marked(top.affected, slots_);
    for (size_t v = 0; v < slots_; ++v) {
      const bool waits = free_variable_[v] == 0 && variables_.held[v] == 0 && variables_.clique_of[v] < 0;
      require((affected_[v] != 0) == waits);
    }
    for (const int32_t v : tree_.kept_order) require(within(v, slots_) && affected_[at(v)] != 0);
    marked(tree_.kept_order, slots_);
    is_orphan_ = marked(top.orphans, cliques_.all.size());
  }

  void kinds() {
    require(factors_.free_rows.size() == factors_.kinds.size());
    for (const FactorGroup& kind : factors_.kinds) {
      const auto type = static_cast<int32_t>(kind.type);
      require(kind.arity >= 1 && kind.arity <= kMaxArity && kind.rows >= 1 && kind.rows <= kMaxRows);
      const auto arity = static_cast<size_t>(kind.arity), rows = static_cast<size_t>(kind.rows);
      require((type >= 0 && type <= static_cast<int32_t>(FactorType::point_to_plane)) || brought_residual(kind.type) != nullptr);
      require(static_cast<uint32_t>(kind.noise) <= 2 && static_cast<uint32_t>(kind.kernel) <= 6);
      require(std::isfinite(kind.kernel_width) && kind.kernel_width > 0.0 && kind.measurement_size >= 0);
      for (size_t a = 0; a < arity; ++a) {
        const auto manifold = static_cast<int32_t>(kind.manifold[a]);
        require(manifold >= 0 && manifold <= static_cast<int32_t>(Manifold::nav) && kind.dof[a] >= 1 && kind.dof[a] <= kMaxDof);
        require((manifold == 0 || kind.dof[a] == kDofs[manifold]) && kind.storage[a] == storage_of(kind.manifold[a], kind.dof[a]));
      }
      const FactorShape shape =
          shape_of(kind.type, {{kind.manifold.data(), arity}, {kind.dof.data(), arity}, kind.rows, kind.measurement_size});
      require(shape.known && shape.rows == kind.rows && shape.measurement == kind.measurement_size);
      sizes(kind, arity, rows);
    }
  }

  static void sizes(const FactorGroup& kind, size_t arity, size_t rows) {
    const size_t n = kind.count;
    require(n <= kind.variables.size() && kind.variables.size() == n * arity && kind.values.size() == n * arity);
    require(kind.measurement.size() == n * static_cast<size_t>(kind.measurement_size));
    require(kind.sqrt_information.size() == n * noise_numbers(kind.noise, kind.rows));
    require((kind.weight.empty() || kind.weight.size() == n) && kind.residual.size() <= n * rows);
    require(finite(kind.measurement) && finite(kind.sqrt_information) && finite(kind.weight));
    for (size_t a = 0; a < static_cast<size_t>(kMaxArity); ++a) {
      const size_t size = a < arity ? n * rows * static_cast<size_t>(kind.dof[a]) : 0;
      require(kind.jacobian[a].size() <= size);
    }
  }

  void factors() {
    std::vector<std::vector<uint8_t>> used;
    for (size_t k = 0; k < factors_.kinds.size(); ++k) used.push_back(marked(factors_.free_rows[k], factors_.kinds[k].count));
    const std::vector<uint8_t> is_free = marked(factors_.free, factors_.factors.size());
    for (size_t f = 0; f < factors_.factors.size(); ++f) {
      const TreeFactor& factor = factors_.factors[f];
      require((factor.kind < 0) == (is_free[f] != 0));
      if (factor.kind < 0) {
        require(factor.kind == -1 && factor.clique == -1 && factor.next == -1 && factor.let_go == 0);
        continue;
      }
      const FactorGroup& kind = factors_.kinds[at(factor.kind)];
      require(within(factor.index, kind.count) && used[at(factor.kind)][at(factor.index)] == 0);
      used[at(factor.kind)][at(factor.index)] = 1;
      require(factor.stale <= 1 && factor.let_go <= 1 && (factor.clique == -1 || is_clique(factor.clique)));
      require(factor.clique >= 0 || factor.next == -1);
      scope(factor, kind);
    }
    for (const std::vector<uint8_t>& rows : used)
      require(std::all_of(rows.begin(), rows.end(), [](uint8_t row) { return row != 0; }));
  }

  // The variables of a factor, and what it was linearised to. A factor is assembled in the clique of the first of its variables
  // that is eliminated, and the others are rows of it, or wait.
  void scope(const TreeFactor& factor, const FactorGroup& kind) const {
    const auto arity = static_cast<size_t>(kind.arity), row = at(factor.index);
    for (size_t a = 0; a < arity; ++a) {
      const int32_t v = kind.variables[row * arity + a];
      require(is_variable(v) && variables_.manifold[at(v)] == kind.manifold[a] && variables_.dof[at(v)] == kind.dof[a]);
      require(kind.values[row * arity + a] == variables_.theta_at[at(v)]);
      if (factor.clique < 0 || variables_.held[at(v)] != 0) continue;
      const Indices& nodes = clique(factor.clique).nodes;
      require(std::find(nodes.begin(), nodes.end(), v) != nodes.end());
    }
    if (factor.let_go != 0 || factor.stale != 0) return;
    require(finite(factor.block, block_size(kind)));
    if (kind.type != FactorType::custom) return;
    const size_t rows = static_cast<size_t>(kind.rows);
    require(kind.residual.size() >= (row + 1) * rows);
    for (size_t a = 0; a < arity; ++a)
      require(kind.jacobian[a].size() >= (row + 1) * rows * static_cast<size_t>(kind.dof[a]));
  }

  // The factors of each clique, and those that wait.
  void lists() {
    std::vector<uint8_t> seen(factors_.factors.size(), 0);
    for (size_t c = 0; c < cliques_.all.size(); ++c)
      for (int32_t f = cliques_.all[c].first_factor; f != -1; f = factor(f).next) {
        require(within(f, seen.size()) && seen[at(f)] == 0 && factor(f).clique == static_cast<int32_t>(c));
        require(factor(f).kind >= 0 && factor(f).let_go == 0);
        seen[at(f)] = 1;
      }
    for (const int32_t f : tree_.top.factors) {
      require(within(f, seen.size()) && seen[at(f)] == 0 && factor(f).kind >= 0 && factor(f).clique == -1);
      seen[at(f)] = 1;
    }
    for (size_t f = 0; f < seen.size(); ++f) require(seen[f] != 0 || factors_.factors[f].clique == -1);
  }

  // Each clique hangs once, below one that has all its rows.
  void hanging() {
    const size_t size = cliques_.all.size();
    std::vector<uint8_t> seen = marked(cliques_.roots, size);
    Indices stack;
    for (size_t c = 0; c < size; ++c) {
      if (seen[c] == 0 && is_orphan_[c] == 0) continue;
      require(seen[c] == 0 || is_orphan_[c] == 0);
      const Clique& top = cliques_.all[c];
      require(is_clique(static_cast<int32_t>(c)) && top.parent == -1 && top.next == -1 && top.previous == -1);
      for (int32_t i = top.first_row(); i < top.node_count(); ++i)
        require(is_orphan_[c] != 0 && affected_[at(top.node(i))] != 0);
      seen[c] = 1;
      stack.push_back(static_cast<int32_t>(c));
    }
    std::vector<int32_t> place(slots_, -1);  // the last clique that was looked at with the variable among its nodes
    while (!stack.empty()) {
      const int32_t parent = stack.back();
      stack.pop_back();
      for (const int32_t v : clique(parent).nodes) place[at(v)] = parent;
      int32_t before = -1;
      for (int32_t c = clique(parent).child; c != -1; c = clique(c).next) {
        require(is_clique(c) && seen[at(c)] == 0 && clique(c).parent == parent && clique(c).previous == before);
        for (int32_t i = clique(c).first_row(); i < clique(c).node_count(); ++i) require(place[at(clique(c).node(i))] == parent);
        require(clique(c).pivot_nodes > 0 || clique(c).child == -1);  // nothing hangs below a summary
        seen[at(c)] = 1;
        before = c;
        stack.push_back(c);
      }
    }
    for (size_t c = 0; c < size; ++c) require(seen[c] != 0 || cliques_.all[c].nodes.empty());
  }

  void steps() const {
    for (const Indices* list : {&tree_.steps.made, &tree_.steps.attached})
      for (const int32_t c : *list) require(is_clique(c));
    for (const int32_t c : tree_.steps.deferred) require(within(c, cliques_.all.size()));
    require(std::isfinite(tree_.steps.wildfire) && std::isfinite(tree_.steps.relinearize));
  }

  void journal() const {
    for (const int32_t v : tree_.journal.put_back) require(is_variable(v));
    for (const SavedVariable& saved : tree_.journal.slice_saved) {
      require(is_variable(saved.variable) && finite(saved.theta) && finite(saved.delta));
      require(saved.theta.size() == storage(saved.variable) && saved.delta.size() == at(variables_.dof[at(saved.variable)]));
    }
  }

  const TreeVariables::Stored& variables_;
  const TreeFactors::Stored& factors_;
  const TreeCliques::Stored& cliques_;
  const StoredTree& tree_;
  size_t slots_;
  std::vector<uint8_t> free_variable_, affected_, is_orphan_;
};

}  // namespace

void check_tree(const StoredTree& tree) { Check(tree).all(); }

}  // namespace heliograph
