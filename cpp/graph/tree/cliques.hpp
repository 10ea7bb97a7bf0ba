// SPDX-License-Identifier: MIT
// The cliques of a Bayes tree and how they hang together; their dense blocks lie in pooled memory.
#pragma once
#include <cstdint>
#include <vector>

#include "graph/cholesky/block_pool.hpp"

namespace heliograph {

// P(pivots | rows): the pivot columns of an eliminated front, and the remainder that it handed to its parent.
struct Clique {
  int32_t parent = -1;
  int32_t child = -1;        // first of its children
  int32_t next = -1;         // siblings
  int32_t previous = -1;
  int32_t pivot_nodes = 0;
  int32_t first_factor = -1; // of those that were assembled here
  int32_t pivots = 0;        // scalars
  int32_t rows = 0;
  int32_t height = 0;
  int32_t update_height = 0;
  uint32_t flagged = 0;      // number of the update that takes it down
  uint8_t unsolved = 0;      // made since the last solve
  uint8_t deferred = 0;      // its step and all below it are computed later
  uint32_t solved = 0;       // number of the solve that computed its step
  std::vector<int32_t> nodes;  // variables: pivots, then rows, in the order of elimination
  double* factor = nullptr;
  double* update = nullptr;

  int32_t first_row() const { return pivot_nodes; }  // in `nodes`
  int32_t node_count() const { return static_cast<int32_t>(nodes.size()); }
  int32_t node(int32_t i) const { return nodes[static_cast<size_t>(i)]; }
  size_t factor_doubles() const { return static_cast<size_t>(height) * static_cast<size_t>(pivots); }
  size_t update_doubles() const { return static_cast<size_t>(update_height) * static_cast<size_t>(rows); }
};

// Siblings are a list in both directions; a clique without a parent is a root, or an orphan while it is detached.
class TreeCliques {
 public:
  int32_t take();               // an empty one
  void release(int32_t clique);  // with its blocks; nothing hangs on it any more
  void link(int32_t clique, int32_t parent);  // parent -1: it becomes a root
  void unlink(int32_t clique);
  void forget_root(int32_t clique);

  Clique& operator[](int32_t clique) { return all_[at(clique)]; }
  const Clique& operator[](int32_t clique) const { return all_[at(clique)]; }
  const std::vector<Clique>& all() const { return all_; }  // those not in use have no nodes
  const std::vector<int32_t>& roots() const { return roots_; }
  size_t count() const { return all_.size() - free_.size(); }

  // Calls visit(child) for each.
  template <typename Visit>
  void each_child(int32_t clique, Visit&& visit) const {
    for (int32_t c = (*this)[clique].child; c >= 0; c = (*this)[c].next) visit(c);
  }

  double* take_block(size_t doubles) { return blocks_.take(doubles); }
  void give_back_block(double* block, size_t doubles) { blocks_.give_back(block, doubles); }
  size_t bytes() const;

  struct Stored {
    std::vector<Clique>& all;
    std::vector<int32_t>&free, &roots;
    BlockPool& blocks;
  };
  Stored stored() { return {all_, free_, roots_, blocks_}; }

 private:
  static size_t at(int32_t clique) { return static_cast<size_t>(clique); }

  std::vector<Clique> all_;
  std::vector<int32_t> free_;
  std::vector<int32_t> roots_;
  BlockPool blocks_;
};

}  // namespace heliograph
