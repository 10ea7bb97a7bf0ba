// SPDX-License-Identifier: MIT
#include "graph/tree/regrow.hpp"

namespace heliograph {

namespace {

bool done(const EliminatedFronts& eliminated, int32_t front) { return static_cast<size_t>(front) < eliminated.done; }

void take_out(TreeStore& store, const TreeTop& top) {
  for (const int32_t c : top.orphans()) store.cliques.unlink(c);
  for (const int32_t c : top.taken()) {
    if (store.cliques[c].parent < 0) store.cliques.forget_root(c);
    store.cliques.release(c);
  }
  for (const int32_t v : top.affected()) store.variables.set_clique(v, -1);
}

void make_cliques(TreeStore& store, const TreeTop& top, const EliminatedFronts& eliminated, std::vector<int32_t>& made) {
  for (size_t s = 0; s < eliminated.done; ++s) made.push_back(store.cliques.take());
  for (size_t s = eliminated.done; s-- > 0;) {  // parents first
    const FrontView& front = eliminated.plan.fronts[s];
    Clique& clique = store.cliques[made[s]];
    clique.pivot_nodes = front.node_pivots;
    clique.pivots = front.pivots;
    clique.rows = front.rows;
    clique.height = front.height;
    clique.update_height = front.update_height;
    clique.unsolved = 1;
    clique.factor = eliminated.factor[s];
    clique.update = eliminated.update[s];
    for (int32_t i = front.node_begin; i < front.node_end; ++i)
      clique.nodes.push_back(top.affected(eliminated.plan.nodes[static_cast<size_t>(i)]));
    for (int32_t i = 0; i < front.node_pivots; ++i) store.variables.set_clique(clique.node(i), made[s]);
    if (front.parent < 0) {
      store.cliques.link(made[s], -1);
    } else if (done(eliminated, front.parent)) {
      store.cliques.link(made[s], made[static_cast<size_t>(front.parent)]);
    }
  }
}

void hang_orphans(TreeStore& store, const TreeTop& top, const EliminatedFronts& eliminated, Regrown& out) {
  for (size_t s = 0; s < eliminated.done; ++s) {
    const int32_t parent = eliminated.plan.fronts[s].parent;
    if (parent >= 0 && !done(eliminated, parent)) out.rest.orphans.push_back(out.made[s]);
  }
  for (size_t e = 0; e < top.orphans().size(); ++e) {
    const int32_t parent = eliminated.plan.fronts[eliminated.fronts + e].parent, orphan = top.orphan(e);
    if (parent >= 0 && !done(eliminated, parent)) {
      out.rest.orphans.push_back(orphan);
      continue;
    }
    store.cliques.link(orphan, out.made[static_cast<size_t>(parent)]);
    out.attached.push_back(orphan);
  }
}

void place_factors(TreeStore& store, const TreeTop& top, const EliminatedFronts& eliminated, Regrown& out) {
  for (const int32_t f : top.factors()) {
    TreeFactor& factor = store.factors[f];
    const size_t front = top.front_of(eliminated.plan, factor);
    if (front >= eliminated.plan.fronts.size()) continue;  // between variables that are all held
    if (front >= eliminated.done) {
      factor.clique = factor.next = -1;
      out.rest.factors.push_back(f);
      continue;
    }
    factor.clique = out.made[front];
    factor.next = store.cliques[factor.clique].first_factor;
    store.cliques[factor.clique].first_factor = f;
  }
}

}  // namespace

Regrown regrow(TreeStore& store, const TreeTop& top, const EliminatedFronts& eliminated) {
  Regrown out;
  take_out(store, top);
  for (size_t i = 0; i < top.affected().size(); ++i)
    if (!done(eliminated, eliminated.plan.front_of[i])) out.rest.affected.push_back(top.affected()[i]);
  make_cliques(store, top, eliminated, out.made);
  hang_orphans(store, top, eliminated, out);
  place_factors(store, top, eliminated, out);
  return out;
}

}  // namespace heliograph
