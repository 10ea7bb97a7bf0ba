// SPDX-License-Identifier: MIT
// Approximate minimum degree on the quotient graph.
//
// Source: Amestoy, Davis, Duff, "An approximate minimum degree ordering algorithm", SIAM J. Matrix Anal. Appl. 17(4), 1996.
// An eliminated node becomes an element: its list is the clique that its elimination made. A variable's list holds first
// the elements it lies in, then those neighbours that no element covers, so the fill is never written out and no list
// ever grows beyond what it had at the start.
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>

#include "graph/ordering/ordering.hpp"

namespace heliograph {

namespace {

constexpr int32_t kNone = -1;
constexpr int64_t kAbsorbed = 0;  // the stamp of an element that another has taken in

// One record a node, so that a visit costs one cache line and not nine.
struct Node {
  int64_t begin = 0;      // its list in the store
  int64_t stamp = 1;      // of an element: flag + weight outside the pivot's pattern; of either: mark while comparing
  int32_t length = 0;     // entries in the list
  int32_t elements = 0;   // how many of them, from the front, are elements
  int32_t weight = 0;     // > 0 variable; < 0 variable in the pivot's pattern; 0 element, merged or put off as dense
  int32_t degree = 0;     // of a variable: bound on its external degree; of an element: weight of its pattern
  int32_t next = kNone;   // in its degree bucket, or in its hash bucket while a pivot is worked on
  int32_t previous = kNone;
  int32_t group = 0;      // rank of its constraint group
  int32_t hash = 0;
};

class QuotientGraph {
 public:
  QuotientGraph(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> group);
  std::vector<int32_t> order();

 private:
  void set_groups(std::span<const int32_t> group);
  void put_off_dense(const Adjacency& graph);
  void open_group(int32_t rank);
  void insert(int32_t i);
  void remove(int32_t i);
  int32_t select();
  void eliminate(int32_t pivot);
  void gather(int32_t pivot);
  void take(int32_t i, int64_t& out);
  void reserve(int64_t entries);
  void measure_elements(const Node& pivot);
  void update_variables(int32_t pivot);
  bool update_variable(int32_t i, int32_t pivot);
  void merge_indistinguishable(const Node& pivot);
  void merge_bucket(int32_t first);
  bool same_list(const Node& a, const Node& b) const;
  void close_pattern(int32_t pivot);
  void join(int32_t into, int32_t i);

  size_t bucket(int32_t degree) const { return std::min(static_cast<size_t>(degree), first_.size() - 1); }

  std::vector<Node> nodes_;
  std::vector<int32_t> store_;      // all lists; compacted when its end is reached
  int64_t free_ = 0;                // first unused entry of the store
  std::vector<int32_t> first_;      // (buckets) first variable of each degree; the last one takes all above
  std::vector<int32_t> hash_first_; // (a power of two)
  std::vector<int32_t> member_;     // chains of nodes merged into one: next of each ...
  std::vector<int32_t> last_;       // ... and last of each
  std::vector<int32_t> by_group_;   // nodes, lower groups first
  std::vector<int64_t> group_begin_;
  std::vector<uint8_t> dense_;      // empty where there is none
  std::vector<int32_t> order_;
  int64_t flag_ = 1;                // stamps below are old
  int32_t remaining_ = 0;           // weight not yet eliminated
  int32_t total_ = 0;
  int32_t pattern_weight_ = 0;      // of the pivot at hand
  int32_t pivot_weight_ = 0;
  size_t least_ = 0;                // no variable lies in a lower bucket
  int32_t open_ = 0;                // rank of the group being eliminated
};

QuotientGraph::QuotientGraph(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> group) {
  const size_t n = graph.size();
  if (weight.size() != n) throw std::invalid_argument("an ordering needs one weight a node");
  if (!group.empty() && group.size() != n) throw std::invalid_argument("an ordering needs one group a node, or none");
  int32_t unit = 0;  // equal weights are the common case: counted in their unit the buckets stay few
  int64_t total = 0;
  for (const int32_t w : weight) {
    if (w <= 0) throw std::invalid_argument("an ordering needs positive weights");
    unit = std::gcd(unit, w);
    total += w;
  }
  if (unit > 0) total /= unit;
  if (total >= std::numeric_limits<int32_t>::max() / 2) throw std::invalid_argument("the weights of an ordering sum to 2^30 or more");
  nodes_.resize(n);
  member_.assign(n, kNone);
  last_.resize(n);
  std::iota(last_.begin(), last_.end(), 0);
  for (size_t i = 0; i < n; ++i) {
    nodes_[i].begin = graph.offset[i];
    nodes_[i].length = static_cast<int32_t>(graph.offset[i + 1] - graph.offset[i]);
    nodes_[i].weight = weight[i] / unit;
  }
  total_ = remaining_ = static_cast<int32_t>(total);
  free_ = static_cast<int64_t>(graph.neighbour.size());
  store_.reserve(graph.neighbour.size() + graph.neighbour.size() / 4 + n + 16);
  store_.assign(graph.neighbour.begin(), graph.neighbour.end());
  store_.resize(store_.capacity());
  first_.assign(std::min(static_cast<size_t>(total), 4 * n + 64) + 1, kNone);
  size_t buckets = 16;
  while (buckets < n && buckets < (size_t{1} << 16)) buckets *= 2;
  hash_first_.assign(buckets, kNone);
  set_groups(group);
  put_off_dense(graph);
}

void QuotientGraph::set_groups(std::span<const int32_t> group) {
  const size_t n = nodes_.size();
  by_group_.resize(n);
  std::iota(by_group_.begin(), by_group_.end(), 0);
  group_begin_.push_back(0);
  if (!group.empty()) {
    std::stable_sort(by_group_.begin(), by_group_.end(), [&](int32_t a, int32_t b) { return group[a] < group[b]; });
    for (size_t k = 1; k < n; ++k) {
      if (group[by_group_[k]] != group[by_group_[k - 1]]) group_begin_.push_back(static_cast<int64_t>(k));
      nodes_[by_group_[k]].group = static_cast<int32_t>(group_begin_.size()) - 1;
    }
  }
  group_begin_.push_back(static_cast<int64_t>(n));
}

// A node that sees most of the others would sit in every list for nothing: whenever it goes, it fills. It goes last in
// its group and the degrees are counted without it.
void QuotientGraph::put_off_dense(const Adjacency& graph) {
  const auto limit = static_cast<int32_t>(std::max(16.0, 10.0 * std::sqrt(static_cast<double>(nodes_.size()))));
  for (size_t i = 0; i < nodes_.size(); ++i) {
    if (nodes_[i].length <= limit) continue;
    dense_.resize(nodes_.size(), 0);
    dense_[i] = 1;
    total_ -= nodes_[i].weight;
    nodes_[i].weight = 0;
  }
  remaining_ = total_;
  for (size_t i = 0; i < nodes_.size(); ++i) {
    int32_t degree = 0;
    for (int64_t p = graph.offset[i]; p < graph.offset[i + 1]; ++p) degree += nodes_[graph.neighbour[p]].weight;
    nodes_[i].degree = degree;
  }
}

std::vector<int32_t> QuotientGraph::order() {
  order_.reserve(nodes_.size());
  for (size_t g = 0; g + 1 < group_begin_.size(); ++g) {
    open_group(static_cast<int32_t>(g));
    for (int32_t pivot = select(); pivot != kNone; pivot = select()) eliminate(pivot);
    if (dense_.empty()) continue;
    for (int64_t k = group_begin_[g]; k < group_begin_[g + 1]; ++k)
      if (dense_[by_group_[k]]) order_.push_back(by_group_[k]);
  }
  return std::move(order_);
}

void QuotientGraph::open_group(int32_t rank) {
  open_ = rank;
  least_ = first_.size();
  for (int64_t k = group_begin_[rank]; k < group_begin_[rank + 1]; ++k)
    if (nodes_[by_group_[k]].weight > 0) insert(by_group_[k]);
}

void QuotientGraph::insert(int32_t i) {
  Node& node = nodes_[i];
  const size_t b = bucket(node.degree);
  node.previous = kNone;
  node.next = first_[b];
  if (node.next != kNone) nodes_[node.next].previous = i;
  first_[b] = i;
  least_ = std::min(least_, b);
}

void QuotientGraph::remove(int32_t i) {
  const Node& node = nodes_[i];
  if (node.next != kNone) nodes_[node.next].previous = node.previous;
  if (node.previous != kNone)
    nodes_[node.previous].next = node.next;
  else
    first_[bucket(node.degree)] = node.next;
}

int32_t QuotientGraph::select() {
  while (least_ < first_.size() && first_[least_] == kNone) ++least_;
  if (least_ >= first_.size()) return kNone;
  const int32_t pivot = first_[least_];
  remove(pivot);
  return pivot;
}

void QuotientGraph::eliminate(int32_t pivot) {
  pivot_weight_ = nodes_[pivot].weight;
  nodes_[pivot].weight = 0;
  pattern_weight_ = 0;
  gather(pivot);
  measure_elements(nodes_[pivot]);
  update_variables(pivot);
  flag_ += total_ + 1;
  merge_indistinguishable(nodes_[pivot]);
  close_pattern(pivot);
  for (int32_t i = pivot; i != kNone; i = member_[i]) order_.push_back(i);
}

// Puts variable i into the pivot's pattern, once.
void QuotientGraph::take(int32_t i, int64_t& out) {
  Node& node = nodes_[i];
  if (node.weight <= 0) return;
  pattern_weight_ += node.weight;
  if (node.group == open_) remove(i);
  node.weight = -node.weight;
  store_[out++] = i;
}

// The pivot's pattern: what it sees itself and through its elements, which it absorbs.
void QuotientGraph::gather(int32_t pivot) {
  Node& node = nodes_[pivot];
  const bool alone = node.elements == 0;
  const bool within = node.elements == 1 && node.length == 1;
  int64_t out = node.begin;
  if (alone || within) {  // the pattern is part of one list that is needed no more: written over it
    Node& source = alone ? node : nodes_[store_[node.begin]];
    const int64_t begin = source.begin;
    const int64_t end = begin + source.length;
    source.stamp = kAbsorbed;
    source.length = 0;
    out = begin;
    for (int64_t p = begin; p < end; ++p) take(store_[p], out);
    node.begin = begin;
    node.length = static_cast<int32_t>(out - begin);
  } else {
    int64_t entries = node.length;
    for (int32_t k = 0; k < node.elements; ++k) entries += nodes_[store_[node.begin + k]].length;
    reserve(entries);
    const int64_t begin = free_;
    out = begin;
    for (int64_t p = node.begin; p < node.begin + node.elements; ++p) {
      Node& element = nodes_[store_[p]];
      for (int64_t q = element.begin; q < element.begin + element.length; ++q) take(store_[q], out);
      element.stamp = kAbsorbed;
      element.length = 0;
    }
    for (int64_t p = node.begin + node.elements; p < node.begin + node.length; ++p) take(store_[p], out);
    node.begin = begin;
    node.length = static_cast<int32_t>(out - begin);
    free_ = out;
  }
  node.elements = 0;
  node.stamp = flag_;
}

// Room for a pattern at the end of the store. What is live never exceeds the graph's own size, so compaction is rare.
void QuotientGraph::reserve(int64_t entries) {
  if (free_ + entries <= static_cast<int64_t>(store_.size())) return;
  int64_t live = 0;
  for (const Node& node : nodes_) live += node.length;
  std::vector<int32_t> compact(static_cast<size_t>(live + std::max(entries, live / 4) + 16));
  free_ = 0;
  for (Node& node : nodes_) {
    std::copy_n(store_.begin() + node.begin, node.length, compact.begin() + free_);
    node.begin = free_;
    free_ += node.length;
  }
  store_ = std::move(compact);
}

// After this an element's stamp is flag + the weight of its pattern outside the pivot's.
void QuotientGraph::measure_elements(const Node& pivot) {
  for (int64_t p = pivot.begin; p < pivot.begin + pivot.length; ++p) {
    const Node& node = nodes_[store_[p]];
    for (int64_t q = node.begin; q < node.begin + node.elements; ++q) {
      Node& element = nodes_[store_[q]];
      if (element.stamp == kAbsorbed) continue;
      if (element.stamp < flag_) element.stamp = flag_ + element.degree;
      element.stamp += node.weight;  // negative while in the pattern
    }
  }
}

void QuotientGraph::update_variables(int32_t pivot) {
  const Node node = nodes_[pivot];
  for (int64_t p = node.begin; p < node.begin + node.length; ++p) {
    const int32_t i = store_[p];
    if (update_variable(i, pivot)) continue;
    // Mass elimination: it sees nothing beyond the pattern, so it goes with the pivot and adds no fill.
    Node& gone = nodes_[i];
    pattern_weight_ += gone.weight;
    pivot_weight_ -= gone.weight;
    gone.weight = 0;
    gone.length = gone.elements = 0;
    join(pivot, i);
  }
}

// Prunes the list of i by what the pivot covers, bounds its degree outside the pattern and files it by a hash of its list.
// False if nothing is left and it may go with the pivot.
bool QuotientGraph::update_variable(int32_t i, int32_t pivot) {
  Node& node = nodes_[i];
  const int64_t begin = node.begin;
  int64_t out = begin;
  int64_t outside = 0;
  uint32_t hash = 0;
  for (int64_t p = begin; p < begin + node.elements; ++p) {
    const int32_t e = store_[p];
    Node& element = nodes_[e];
    if (element.stamp == kAbsorbed) continue;
    if (element.stamp == flag_) {  // aggressive absorption: it lies within the pivot's pattern
      element.stamp = kAbsorbed;
      element.length = 0;
      continue;
    }
    outside += element.stamp - flag_;
    hash += static_cast<uint32_t>(e);
    store_[out++] = e;
  }
  const int64_t variables = out;
  for (int64_t p = begin + node.elements; p < begin + node.length; ++p) {
    const int32_t j = store_[p];
    if (nodes_[j].weight <= 0) continue;  // covered by the pivot, or gone
    outside += nodes_[j].weight;
    hash += static_cast<uint32_t>(j);
    store_[out++] = j;
  }
  if (out == begin && node.group == open_) return false;
  node.degree = static_cast<int32_t>(std::min<int64_t>(node.degree, outside));
  // At least one entry was dropped for the pivot, so there is room to put it in front of the two parts.
  store_[out] = store_[variables];
  store_[variables] = store_[begin];
  store_[begin] = pivot;
  node.elements = static_cast<int32_t>(variables - begin) + 1;
  node.length = static_cast<int32_t>(out - begin) + 1;
  node.hash = static_cast<int32_t>((hash * 2654435761u) >> 16 & (hash_first_.size() - 1));
  node.next = hash_first_[node.hash];
  hash_first_[node.hash] = i;
  return true;
}

// Variables with equal lists stay equal for good: they become one, which is eliminated at once.
void QuotientGraph::merge_indistinguishable(const Node& pivot) {
  for (int64_t p = pivot.begin; p < pivot.begin + pivot.length; ++p) {
    const Node& node = nodes_[store_[p]];
    if (node.weight == 0) continue;
    const int32_t first = hash_first_[node.hash];
    if (first == kNone) continue;
    hash_first_[node.hash] = kNone;
    if (nodes_[first].next != kNone) merge_bucket(first);
  }
}

void QuotientGraph::merge_bucket(int32_t first) {
  for (int32_t a = first; a != kNone && nodes_[a].next != kNone; a = nodes_[a].next) {
    Node& one = nodes_[a];
    for (int64_t p = one.begin + 1; p < one.begin + one.length; ++p) nodes_[store_[p]].stamp = flag_;
    int32_t before = a;
    for (int32_t b = one.next; b != kNone; b = nodes_[b].next) {
      Node& other = nodes_[b];
      if (!same_list(one, other)) {
        before = b;
        continue;
      }
      one.weight += other.weight;
      other.weight = 0;
      other.length = other.elements = 0;
      nodes_[before].next = other.next;
      join(a, b);
    }
    ++flag_;
  }
}

// Whether b lists what a lists, a's entries being stamped; the first entry of both is the pivot.
bool QuotientGraph::same_list(const Node& a, const Node& b) const {
  if (a.length != b.length || a.elements != b.elements || a.group != b.group) return false;
  for (int64_t p = b.begin + 1; p < b.begin + b.length; ++p)
    if (nodes_[store_[p]].stamp != flag_) return false;
  return true;
}

// The pivot becomes an element; what is left of its pattern goes back to the degree buckets.
void QuotientGraph::close_pattern(int32_t pivot) {
  Node& element = nodes_[pivot];
  remaining_ -= pivot_weight_;
  const int64_t end = element.begin + element.length;
  int64_t out = element.begin;
  for (int64_t p = element.begin; p < end; ++p) {
    const int32_t i = store_[p];
    Node& node = nodes_[i];
    if (node.weight == 0) continue;
    node.weight = -node.weight;
    const int64_t degree = int64_t{node.degree} + pattern_weight_ - node.weight;
    node.degree = static_cast<int32_t>(std::min<int64_t>(degree, remaining_ - node.weight));
    if (node.group == open_) insert(i);
    store_[out++] = i;
  }
  if (end == free_) free_ = out;
  element.length = static_cast<int32_t>(out - element.begin);
  element.degree = pattern_weight_;
  if (element.length == 0) element.stamp = kAbsorbed;
}

void QuotientGraph::join(int32_t into, int32_t i) {
  member_[last_[into]] = i;
  last_[into] = last_[i];
}

}  // namespace

std::vector<int32_t> minimum_degree(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> group) {
  return QuotientGraph(graph, weight, group).order();
}

}  // namespace heliograph
