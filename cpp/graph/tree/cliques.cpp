// SPDX-License-Identifier: MIT
#include "graph/tree/cliques.hpp"

#include <utility>

namespace heliograph {

int32_t TreeCliques::take() {
  if (free_.empty()) {
    all_.emplace_back();
    return static_cast<int32_t>(all_.size()) - 1;
  }
  const int32_t index = free_.back();
  free_.pop_back();
  return index;
}

void TreeCliques::release(int32_t index) {
  Clique& clique = all_[at(index)];
  blocks_.give_back(clique.factor, clique.factor_doubles());
  blocks_.give_back(clique.update, clique.update_doubles());
  std::vector<int32_t> nodes = std::move(clique.nodes);
  clique = Clique{};
  nodes.clear();
  clique.nodes = std::move(nodes);  // its memory is used again
  free_.push_back(index);
}

void TreeCliques::link(int32_t index, int32_t parent) {
  Clique& clique = all_[at(index)];
  clique.parent = parent;
  if (parent < 0) {
    roots_.push_back(index);
    return;
  }
  clique.next = all_[at(parent)].child;
  if (clique.next >= 0) all_[at(clique.next)].previous = index;
  all_[at(parent)].child = index;
}

void TreeCliques::unlink(int32_t index) {
  Clique& clique = all_[at(index)];
  if (clique.previous >= 0) {
    all_[at(clique.previous)].next = clique.next;
  } else if (clique.parent >= 0) {
    all_[at(clique.parent)].child = clique.next;
  }
  if (clique.next >= 0) all_[at(clique.next)].previous = clique.previous;
  if (clique.parent < 0) forget_root(index);
  clique.parent = clique.next = clique.previous = -1;
}

void TreeCliques::forget_root(int32_t index) { std::erase(roots_, index); }

size_t TreeCliques::bytes() const {
  size_t other = all_.capacity() * sizeof(Clique);
  for (const Clique& clique : all_) other += clique.nodes.capacity() * sizeof(int32_t);
  return blocks_.held() * sizeof(double) + other;
}

}  // namespace heliograph
