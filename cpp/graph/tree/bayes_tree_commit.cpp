// SPDX-License-Identifier: MIT
// How an update of the Bayes tree ends: what was eliminated becomes cliques, wholly or in part, or all is as it was before.
#include <algorithm>
#include <iterator>
#include <limits>
#include <utility>

#include "graph/tree/bayes_tree.hpp"
#include "graph/cholesky/plan_builder.hpp"

namespace heliograph {

void BayesTree::unlink(int32_t index) {
  Clique& clique = cliques_[static_cast<size_t>(index)];
  if (clique.previous >= 0) {
    cliques_[static_cast<size_t>(clique.previous)].next = clique.next;
  } else if (clique.parent >= 0) {
    cliques_[static_cast<size_t>(clique.parent)].child = clique.next;
  }
  if (clique.next >= 0) cliques_[static_cast<size_t>(clique.next)].previous = clique.previous;
  if (clique.parent < 0) std::erase(roots_, index);
  clique.parent = clique.next = clique.previous = -1;
}

void BayesTree::link(int32_t index, int32_t parent) {
  Clique& clique = cliques_[static_cast<size_t>(index)];
  clique.parent = parent;
  if (parent < 0) {
    roots_.push_back(index);
    return;
  }
  clique.next = cliques_[static_cast<size_t>(parent)].child;
  if (clique.next >= 0) cliques_[static_cast<size_t>(clique.next)].previous = index;
  cliques_[static_cast<size_t>(parent)].child = index;
}

int32_t BayesTree::new_clique() {
  if (free_cliques_.empty()) {
    cliques_.emplace_back();
    return static_cast<int32_t>(cliques_.size()) - 1;
  }
  const int32_t index = free_cliques_.back();
  free_cliques_.pop_back();
  return index;
}

void BayesTree::release(int32_t index) {
  Clique& clique = cliques_[static_cast<size_t>(index)];
  clique_blocks_.give_back(clique.factor, static_cast<size_t>(clique.height) * static_cast<size_t>(clique.pivots));
  clique_blocks_.give_back(clique.update, static_cast<size_t>(clique.update_height) * static_cast<size_t>(clique.rows));
  std::vector<int32_t> nodes = std::move(clique.nodes);
  clique = Clique{};
  nodes.clear();
  clique.nodes = std::move(nodes);  // its memory is used again
  free_cliques_.push_back(index);
}

void BayesTree::swap_rest(Rest& rest) {
  std::swap(affected_, rest.affected);
  std::swap(orphans_, rest.orphans);
  std::swap(open_factors_, rest.open_factors);
}

// How many of a plan's fronts are eliminated now: those that fit, and at least one.
size_t BayesTree::slice_of(const Plan& plan, size_t made, size_t most) const {
  if (most >= affected_.size()) return made;
  size_t done = 0, variables = 0;
  while (done < made) {
    variables += static_cast<size_t>(plan.fronts[done].node_pivots);
    if (done > 0 && variables > most) break;
    ++done;
  }
  return done;
}

// A variable that the new factors leave free even where all older ones are known, or -1. Because the information of the
// older ones is positive definite, that of all is exactly where this part of it is: asked before work is begun that, being
// spread over several updates, could not be taken back later.
int32_t BayesTree::undetermined_fresh() {
  Rest rest;
  std::vector<int32_t> kept = std::exchange(kept_order_, {});
  for (const int32_t v : fresh_)
    if (held_[static_cast<size_t>(v)] == 0) rest.affected.push_back(v);
  if (rest.affected.empty()) {
    kept_order_ = std::move(kept);
    return -1;
  }
  std::sort(rest.affected.begin(), rest.affected.end());
  rest.open_factors = loose_;
  for (const int32_t v : affected_) local_[static_cast<size_t>(v)] = -1;
  swap_rest(rest);
  number_affected();
  linearize_stale(nullptr, 0);
  reorder();
  const Plan plan = plan_elimination();
  counts_.work = plan.flops;
  std::vector<double*> factor(plan.fronts.size(), nullptr), update(plan.fronts.size(), nullptr);
  const int32_t failed = run(plan, plan.fronts.size(), factor, update);
  if (failed < 0) give_back(plan, plan.fronts.size(), factor, update);
  for (const int32_t v : affected_) local_[static_cast<size_t>(v)] = -1;
  swap_rest(rest);
  number_affected();
  kept_order_ = std::move(kept);
  return failed;
}

void BayesTree::commit(const Plan& plan, const std::vector<double*>& factor, const std::vector<double*>& update, size_t done) {
  for (const int32_t c : orphans_) unlink(c);
  for (const int32_t c : taken_) {
    if (cliques_[static_cast<size_t>(c)].parent < 0) std::erase(roots_, c);
    release(c);
  }
  const size_t fronts = plan.fronts.size() - orphans_.size();
  Rest rest;
  for (size_t i = 0; i < affected_.size(); ++i) {
    clique_of_[static_cast<size_t>(affected_[i])] = -1;
    if (static_cast<size_t>(plan.front_of[i]) >= done) rest.affected.push_back(affected_[i]);
  }
  counts_.variables = affected_.size() - rest.affected.size();
  make_cliques(plan, factor, update, done);
  const auto stays_open = [&](int32_t parent) { return parent >= 0 && static_cast<size_t>(parent) >= done; };
  for (size_t s = 0; s < done; ++s)
    if (stays_open(plan.fronts[s].parent)) rest.orphans.push_back(made_[s]);
  attached_.clear();
  kept_order_.clear();
  for (size_t s = done; s < fronts; ++s)
    for (int32_t i = plan.fronts[s].node_begin; i < plan.fronts[s].node_begin + plan.fronts[s].node_pivots; ++i)
      kept_order_.push_back(affected_[static_cast<size_t>(plan.nodes[static_cast<size_t>(i)])]);
  for (size_t e = 0; e < orphans_.size(); ++e) {
    const int32_t parent = plan.fronts[fronts + e].parent;
    if (stays_open(parent)) {
      rest.orphans.push_back(orphans_[e]);
      continue;
    }
    link(orphans_[e], made_[static_cast<size_t>(parent)]);
    attached_.push_back(orphans_[e]);
  }
  place_open_factors(plan, done, rest);
  for (const int32_t f : removed_) drop_factor(f);
  job_saved_.insert(job_saved_.end(), std::make_move_iterator(saved_.begin()), std::make_move_iterator(saved_.end()));
  finish_update();
  undo_.clear();
  swap_rest(rest);
  open_ = !affected_.empty();
  if (!open_) job_saved_.clear();
  eliminated_ += counts_.variables;
}

void BayesTree::make_cliques(const Plan& plan, const std::vector<double*>& factor, const std::vector<double*>& update,
                             size_t done) {
  made_.clear();
  for (size_t s = 0; s < done; ++s) made_.push_back(new_clique());
  for (size_t s = done; s-- > 0;) {  // parents first
    const FrontView& front = plan.fronts[s];
    Clique& clique = cliques_[static_cast<size_t>(made_[s])];
    clique.pivot_nodes = front.node_pivots;
    clique.pivots = front.pivots;
    clique.rows = front.rows;
    clique.height = front.height;
    clique.update_height = front.update_height;
    clique.unsolved = 1;
    clique.factor = factor[s];
    clique.update = update[s];
    for (int32_t i = front.node_begin; i < front.node_end; ++i)
      clique.nodes.push_back(affected_[static_cast<size_t>(plan.nodes[static_cast<size_t>(i)])]);
    for (int32_t i = 0; i < front.node_pivots; ++i) clique_of_[static_cast<size_t>(clique.nodes[static_cast<size_t>(i)])] = made_[s];
    if (front.parent < 0 || static_cast<size_t>(front.parent) < done)
      link(made_[s], front.parent < 0 ? -1 : made_[static_cast<size_t>(front.parent)]);
  }
}

void BayesTree::place_open_factors(const Plan& plan, size_t done, Rest& rest) {
  for (const int32_t f : open_factors_) {
    TreeFactor& entry = factors_[static_cast<size_t>(f)];
    const size_t front = front_of(plan, entry);
    if (front >= plan.fronts.size()) continue;  // between variables that are all held
    if (front >= done) {
      entry.clique = entry.next = -1;
      rest.open_factors.push_back(f);
      continue;
    }
    entry.clique = made_[front];
    entry.next = cliques_[static_cast<size_t>(entry.clique)].first_factor;
    cliques_[static_cast<size_t>(entry.clique)].first_factor = f;
  }
}

void BayesTree::restore(const std::vector<Saved>& saved) {
  for (const Saved& old : saved) {
    const auto v = static_cast<size_t>(old.variable);
    std::copy(old.theta.begin(), old.theta.end(), theta_.begin() + theta_at_[v]);
    std::copy(old.delta.begin(), old.delta.end(), delta_.begin() + delta_at_[v]);
  }
}

void BayesTree::restore_factors() {
  const double* from = old_blocks_.data();
  for (const OldFactor& old : old_) {
    const TreeFactor& factor = factors_[static_cast<size_t>(old.factor)];
    const size_t size = block_size(kinds_[static_cast<size_t>(factor.kind)]);
    std::copy_n(from, size, factor.block);
    from += size;
  }
  for (const int32_t f : open_factors_) {
    TreeFactor& factor = factors_[static_cast<size_t>(f)];
    if (factor.clique >= 0) factor.stale = 0;  // the others stay open, and stale where no slice came to them yet
  }
  for (size_t i = weighed_.size(); i-- > 0;) {  // backwards: one may have been weighed twice
    TreeFactor& factor = factors_[static_cast<size_t>(weighed_[i].factor)];
    kinds_[static_cast<size_t>(factor.kind)].weight[static_cast<size_t>(factor.index)] = weighed_[i].weight;
    factor.stale = factor.clique >= 0 ? 0 : 1;
  }
  for (const int32_t f : removed_) factors_[static_cast<size_t>(f)].removed = 0;
  for (size_t i = loose_.size(); i-- > 0;) drop_factor(loose_[i]);  // backwards: their numbers come again in the same order
}

// The tree itself has not been changed: only what was linearised anew, added and marked is undone, to the bit. An elimination
// that fails in a later slice also gives up the linearisation points that its first slice took: cliques made since then speak
// of them, and are taken down by the next update.
void BayesTree::roll_back() {
  restore(saved_);
  if (looked_at_fluid_) {
    for (const int32_t v : fluid_) fluid_flag_[static_cast<size_t>(v)] = 0;
    fluid_ = fluid_before_;
    for (const int32_t v : fluid_) fluid_flag_[static_cast<size_t>(v)] = 1;
  }
  if (open_ && detached_) {
    restore(job_saved_);
    for (const Saved& saved : job_saved_) {
      if (std::exchange(fluid_flag_[static_cast<size_t>(saved.variable)], 1) == 0) fluid_.push_back(saved.variable);
      undo_.push_back(saved.variable);
    }
    job_saved_.clear();
  }
  restore_factors();
  for (const int32_t v : leaving_) touched_flag_[static_cast<size_t>(v)] = 0;
  leaving_.clear();
  for (const int32_t v : affected_) local_[static_cast<size_t>(v)] = -1;
  const size_t kept = dof_.size() - grown_;
  for (size_t i = fresh_.size(); i-- > 0;)
    if (static_cast<size_t>(fresh_[i]) < kept) free_variable(fresh_[i]);
  Rest rest;
  if (open_ && detached_) {
    rest = std::move(carried_);
  } else if (open_) {
    swap_rest(rest);
  }
  finish_update();
  swap_rest(rest);
  shrink(kept);
}

void BayesTree::shrink(size_t kept) {
  if (kept < dof_.size()) {
    theta_.resize(static_cast<size_t>(theta_at_[kept]));
    delta_.resize(static_cast<size_t>(delta_at_[kept]));
  }
  dof_.resize(kept);
  clique_of_.resize(kept);
  local_.resize(kept, -1);
  for (std::vector<int64_t>* list : {&theta_at_, &delta_at_}) list->resize(kept);
  for (std::vector<uint8_t>* list : {&fluid_flag_, &touched_flag_, &held_, &frozen_}) list->resize(kept);
  manifold_.resize(kept);
  changed_.resize(kept);
}

// Forgets the work lists.
void BayesTree::finish_update() {
  for (const int32_t v : touched_) touched_flag_[static_cast<size_t>(v)] = 0;
  for (const int32_t v : relinearized_) touched_flag_[static_cast<size_t>(v)] = 0;
  for (const int32_t v : affected_) local_[static_cast<size_t>(v)] = -1;
  for (std::vector<int32_t>* list : {&touched_, &relinearized_, &fresh_, &loose_, &removed_, &taken_, &orphans_, &affected_, &open_factors_})
    list->clear();
  saved_.clear();
  old_.clear();
  old_blocks_.clear();
  weighed_.clear();
  looked_at_fluid_ = indivisible_ = detached_ = false;
  grown_ = 0;
  ++update_number_;
}

}  // namespace heliograph
