// SPDX-License-Identifier: MIT
// The top of a Bayes tree that an update takes down: its variables, its factors, and the orphans that hung below it.
#pragma once
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "graph/cholesky/plan.hpp"
#include "graph/ordering/supernodes.hpp"
#include "graph/tree/journal.hpp"
#include "graph/tree/store.hpp"

namespace heliograph {

// While an elimination is worked through in slices the tree is open: a part of the top stays down between updates, and the
// finished cliques are a forest, whose roots stand among the orphans.
class TreeTop {
 public:
  struct Part {
    std::vector<int32_t> affected;  // variables to be eliminated, ascending
    std::vector<int32_t> orphans;   // cliques
    std::vector<int32_t> factors;
  };

  explicit TreeTop(TreeStore& store) : store_(store) {}

  // Marks every clique that speaks of the variable, and those above: the one that eliminates it and those below that have it
  // among their rows.
  void mark_with(int32_t variable);
  // Takes down what is marked, and what the journal says is touched, with all above it.
  void detach(TreeJournal& journal);

  bool open() const { return open_; }
  bool detached() const { return detached_; }
  size_t waiting() const { return open_ ? part_.affected.size() : 0; }
  const std::vector<int32_t>& taken() const { return taken_; }  // cliques
  const std::vector<int32_t>& affected() const { return part_.affected; }
  const std::vector<int32_t>& orphans() const { return part_.orphans; }
  const std::vector<int32_t>& factors() const { return part_.factors; }
  int32_t affected(int32_t node) const { return part_.affected[static_cast<size_t>(node)]; }
  int32_t orphan(size_t element) const { return part_.orphans[element]; }
  int32_t node_of(int32_t variable) const { return node_of_[static_cast<size_t>(variable)]; }  // -1: not affected

  // What the orphans still say, as elements of the elimination.
  Elements elements() const;
  // Who is joined to whom by the factors, and by the elements: each a node of its own that its members are joined to.
  Adjacency quotient_graph(const Elements& elements) const;
  // The same where the order is known: each element is a chain of its members. `position` is that of each node.
  Adjacency chained_graph(const Elements& elements, std::span<const int32_t> position) const;
  // The front in which a factor's first variable is eliminated; beyond all fronts where all are held.
  size_t front_of(const Plan& plan, const TreeFactor& factor) const;

  Part exchange(Part part);   // another part for a while; returns this one
  void close(Part rest);      // the update is done but for the rest
  void roll_back();           // as it was when the update began

  struct Stored {
    std::vector<int32_t>&affected, &orphans, &factors;
    uint32_t& update_number;
    bool& open;
  };
  Stored stored() { return {part_.affected, part_.orphans, part_.factors, update_number_, open_}; }

 private:
  using Edges = std::vector<std::pair<int32_t, int32_t>>;

  void mark_up(int32_t clique);
  bool marked(int32_t clique) const { return store_.cliques[clique].flagged == update_number_; }
  void number();
  void forget_numbers();
  void finish(Part next);
  Edges factor_edges() const;

  TreeStore& store_;
  uint32_t update_number_ = 1;
  std::vector<int32_t> taken_;
  Part part_;
  std::vector<int32_t> node_of_;  // (variables) place among the affected
  bool open_ = false;             // between two slices
  bool detached_ = false;
  Part carried_;                  // the open part, as it was when this update began
};

}  // namespace heliograph
