// SPDX-License-Identifier: MIT
#include "graph/ordering/supernodes.hpp"

#include <algorithm>
#include <numeric>

#include "graph/ordering/fill.hpp"

namespace heliograph {

namespace {

std::vector<int32_t> inverse_of(std::span<const int32_t> order) {
  std::vector<int32_t> position(order.size());
  for (size_t i = 0; i < order.size(); ++i) position[static_cast<size_t>(order[i])] = static_cast<int32_t>(i);
  return position;
}

// Fundamental supernodes in postorder positions: columns [begin, end) with rows rows[row_begin ..].
struct Fundamental {
  std::vector<int32_t> begin;
  std::vector<int32_t> end;
  std::vector<int64_t> row_begin;
  std::vector<int32_t> row_count;
  std::vector<int32_t> rows;
  std::vector<int32_t> parent;
  std::vector<int32_t> taker;
};

class FundamentalBuilder {
 public:
  FundamentalBuilder(const Adjacency& graph, std::span<const int32_t> order, std::span<const int32_t> position,
                     const Elements& elements, std::span<const uint8_t> apart)
      : graph_(graph), order_(order), position_(position), elements_(elements), apart_(apart), mark_(order.size(), -1),
        owner_(order.size(), -1), child_(order.size(), -1), element_(elements.size() > 0 ? order.size() : 0, -1),
        next_element_(elements.size(), -1) {
    for (size_t e = 0; e < elements.size(); ++e) {
      const auto column = static_cast<size_t>(first_of(e));
      next_element_[e] = element_[column];
      element_[column] = static_cast<int32_t>(e);
    }
  }

  Fundamental build() {
    for (int32_t j = 0; j < static_cast<int32_t>(order_.size()); ++j)
      if (!extends_last(j)) open(j);
    for (size_t s = 0; s < out_.begin.size(); ++s)
      out_.parent.push_back(out_.row_count[s] > 0 ? owner_[static_cast<size_t>(first_row(s))] : -1);
    for (size_t e = 0; e < elements_.size(); ++e) out_.taker.push_back(owner_[static_cast<size_t>(first_of(e))]);
    return std::move(out_);
  }

 private:
  int32_t first_row(size_t s) const { return out_.rows[static_cast<size_t>(out_.row_begin[s])]; }

  template <typename Visit>
  void later_neighbours(int32_t j, Visit&& visit) const {
    const auto node = static_cast<size_t>(order_[static_cast<size_t>(j)]);
    for (int64_t i = graph_.offset[node]; i < graph_.offset[node + 1]; ++i) {
      const int32_t p = position_[static_cast<size_t>(graph_.neighbour[static_cast<size_t>(i)])];
      if (p > j) visit(p);
    }
  }

  std::span<const int32_t> nodes_of(size_t e) const {
    return std::span(elements_.nodes).subspan(static_cast<size_t>(elements_.begin[e]),
                                              static_cast<size_t>(elements_.begin[e + 1] - elements_.begin[e]));
  }

  // The position at which an element's first node is eliminated.
  int32_t first_of(size_t e) const {
    int32_t first = static_cast<int32_t>(order_.size());
    for (const int32_t node : nodes_of(e)) first = std::min(first, position_[static_cast<size_t>(node)]);
    return first;
  }

  template <typename Visit>
  void element_rows(int32_t j, Visit&& visit) const {
    if (element_.empty()) return;
    for (int32_t e = element_[static_cast<size_t>(j)]; e != -1; e = next_element_[static_cast<size_t>(e)])
      for (const int32_t node : nodes_of(static_cast<size_t>(e))) visit(position_[static_cast<size_t>(node)]);
  }

  // Column j has the structure of the last supernode's rows behind j: it is that supernode's next column. The marks are
  // still the last supernode's, because only opening one writes them.
  bool extends_last(int32_t j) {
    if (out_.begin.empty()) return false;
    const size_t s = out_.begin.size() - 1;
    if (out_.row_count[s] == 0 || first_row(s) != j) return false;
    const int32_t head = child_[static_cast<size_t>(j)];
    if (head != static_cast<int32_t>(s) || next_child_[s] != -1) return false;
    if (!apart_.empty() && apart_[static_cast<size_t>(order_[static_cast<size_t>(j)])] !=
                               apart_[static_cast<size_t>(order_[static_cast<size_t>(j) - 1])])
      return false;
    bool inside = true;
    const auto check = [&](int32_t p) { inside = inside && (p == j || mark_[static_cast<size_t>(p)] == static_cast<int32_t>(s)); };
    later_neighbours(j, check);
    element_rows(j, check);
    if (!inside) return false;
    out_.end[s] = j + 1;
    ++out_.row_begin[s];
    --out_.row_count[s];
    owner_[static_cast<size_t>(j)] = static_cast<int32_t>(s);
    hang(s);
    return true;
  }

  void open(int32_t j) {
    const auto s = static_cast<int32_t>(out_.begin.size());
    const size_t first = out_.rows.size();
    const auto take = [&](int32_t p) {
      if (p == j || mark_[static_cast<size_t>(p)] == s) return;
      mark_[static_cast<size_t>(p)] = s;
      out_.rows.push_back(p);
    };
    later_neighbours(j, take);
    element_rows(j, take);
    for (int32_t c = child_[static_cast<size_t>(j)]; c != -1; c = next_child_[static_cast<size_t>(c)]) {
      const auto at = static_cast<size_t>(out_.row_begin[static_cast<size_t>(c)]);
      for (size_t i = at; i < at + static_cast<size_t>(out_.row_count[static_cast<size_t>(c)]); ++i) take(out_.rows[i]);
    }
    std::sort(out_.rows.begin() + static_cast<std::ptrdiff_t>(first), out_.rows.end());
    out_.begin.push_back(j);
    out_.end.push_back(j + 1);
    out_.row_begin.push_back(static_cast<int64_t>(first));
    out_.row_count.push_back(static_cast<int32_t>(out_.rows.size() - first));
    owner_[static_cast<size_t>(j)] = s;
    next_child_.push_back(-1);
    hang(static_cast<size_t>(s));
  }

  // Supernode s becomes a child of the column that its first row names.
  void hang(size_t s) {
    if (out_.row_count[s] == 0) return;
    const auto column = static_cast<size_t>(first_row(s));
    next_child_[s] = child_[column];
    child_[column] = static_cast<int32_t>(s);
  }

  const Adjacency& graph_;
  std::span<const int32_t> order_, position_;
  const Elements& elements_;
  std::span<const uint8_t> apart_;
  Fundamental out_;
  std::vector<int32_t> mark_, owner_, child_, next_child_, element_, next_element_;
};

// Nanoseconds to assemble and eliminate a front of k pivots and m remaining scalars, as measured on one core: a constant, the
// entries that are cleared, added and handed on, and the multiplications, which run faster in larger fronts.
double front_cost(double k, double m) {
  const double height = k + m + 4.0;
  const double entries = k * height + m * m;
  const double products = k * k * k / 3.0 + k * k * (m + 1.0) + 0.5 * k * (m + 1.0) * (m + 1.0);
  return 100.0 + 12.0 * k + 0.3 * entries + 0.11 * products;
}

// Which supernodes join: into[s] is the supernode that s ends up in.
std::vector<int32_t> amalgamate(const Fundamental& f, std::span<const int32_t> weight_at, std::span<const uint8_t> apart_at) {
  const size_t n = f.begin.size();
  std::vector<int32_t> into(n), first(n, -1), next(n, -1);
  std::vector<double> pivots(n, 0.0), rows(n, 0.0);
  std::iota(into.begin(), into.end(), 0);
  std::vector<int32_t> kids;
  for (size_t s = 0; s < n; ++s) {
    for (int32_t p = f.begin[s]; p < f.end[s]; ++p) pivots[s] += weight_at[static_cast<size_t>(p)];
    const auto at = static_cast<size_t>(f.row_begin[s]);
    for (size_t i = at; i < at + static_cast<size_t>(f.row_count[s]); ++i) rows[s] += weight_at[static_cast<size_t>(f.rows[i])];
    kids.clear();
    for (int32_t c = first[s]; c != -1; c = next[static_cast<size_t>(c)]) kids.push_back(c);
    // The child that shares most of the front is tried first: it brings the fewest zeros.
    const auto taller = [&](int32_t a, int32_t b) { return rows[static_cast<size_t>(a)] > rows[static_cast<size_t>(b)]; };
    if (kids.size() > 1) std::stable_sort(kids.begin(), kids.end(), taller);  // it would ask for memory even for one
    for (const int32_t c : kids) {
      const auto child = static_cast<size_t>(c);
      if (!apart_at.empty() && apart_at[static_cast<size_t>(f.begin[child])] != apart_at[static_cast<size_t>(f.begin[s])]) continue;
      const double apart = front_cost(pivots[child], rows[child]) + front_cost(pivots[s], rows[s]);
      if (front_cost(pivots[child] + pivots[s], rows[s]) > apart) continue;
      into[child] = static_cast<int32_t>(s);
      pivots[s] += pivots[child];
    }
    if (f.parent[s] >= 0) {
      next[s] = first[static_cast<size_t>(f.parent[s])];
      first[static_cast<size_t>(f.parent[s])] = static_cast<int32_t>(s);
    }
  }
  for (size_t s = n; s-- > 0;) into[s] = into[static_cast<size_t>(into[s])];
  return into;
}

// Gathers the members of each joined supernode and renumbers the nodes by the new order.
Supernodes gather(const Fundamental& f, std::span<const int32_t> into, std::span<const int32_t> order) {
  const size_t n = f.begin.size();
  std::vector<int32_t> number(n, -1);
  Supernodes out;
  out.pivot_begin.push_back(0);
  std::vector<int64_t> fill;
  for (size_t s = 0; s < n; ++s)
    if (into[s] == static_cast<int32_t>(s)) {
      number[s] = static_cast<int32_t>(out.pivot_begin.size() - 1);
      out.pivot_begin.push_back(0);
    }
  for (size_t s = 0; s < n; ++s)
    out.pivot_begin[static_cast<size_t>(number[static_cast<size_t>(into[s])]) + 1] += f.end[s] - f.begin[s];
  std::partial_sum(out.pivot_begin.begin(), out.pivot_begin.end(), out.pivot_begin.begin());
  fill.assign(out.pivot_begin.begin(), out.pivot_begin.end() - 1);
  out.pivots.resize(order.size());
  out.position.resize(order.size());
  for (size_t s = 0; s < n; ++s)
    for (int32_t p = f.begin[s]; p < f.end[s]; ++p) {
      const int64_t at = fill[static_cast<size_t>(number[static_cast<size_t>(into[s])])]++;
      out.pivots[static_cast<size_t>(at)] = order[static_cast<size_t>(p)];
      out.position[static_cast<size_t>(order[static_cast<size_t>(p)])] = static_cast<int32_t>(at);
    }
  out.row_begin.push_back(0);
  for (size_t s = 0; s < n; ++s) {
    if (into[s] != static_cast<int32_t>(s)) continue;
    const auto at = static_cast<size_t>(f.row_begin[s]);
    const size_t begin = out.rows.size();
    for (size_t i = at; i < at + static_cast<size_t>(f.row_count[s]); ++i)
      out.rows.push_back(order[static_cast<size_t>(f.rows[i])]);
    std::sort(out.rows.begin() + static_cast<std::ptrdiff_t>(begin), out.rows.end(), [&](int32_t a, int32_t b) {
      return out.position[static_cast<size_t>(a)] < out.position[static_cast<size_t>(b)];
    });
    out.row_begin.push_back(static_cast<int64_t>(out.rows.size()));
    const int32_t parent = f.parent[s];
    out.parent.push_back(parent < 0 ? -1 : number[static_cast<size_t>(into[static_cast<size_t>(parent)])]);
  }
  for (const int32_t taker : f.taker) out.taker.push_back(number[static_cast<size_t>(into[static_cast<size_t>(taker)])]);
  return out;
}

}  // namespace

Supernodes find_supernodes(const Adjacency& graph, std::span<const int32_t> weight, std::span<const int32_t> order,
                           const Elements& elements, std::span<const uint8_t> apart) {
  const std::vector<int32_t> renumber = postorder(elimination_tree(graph, order));
  std::vector<int32_t> arranged(order.size()), weight_at(order.size());
  for (size_t i = 0; i < order.size(); ++i) {
    arranged[i] = order[static_cast<size_t>(renumber[i])];
    weight_at[i] = weight[static_cast<size_t>(arranged[i])];
  }
  std::vector<uint8_t> apart_at(apart.size());
  for (size_t i = 0; i < apart.size(); ++i) apart_at[i] = apart[static_cast<size_t>(arranged[i])];
  const std::vector<int32_t> position = inverse_of(arranged);
  const Fundamental fundamental = FundamentalBuilder(graph, arranged, position, elements, apart).build();
  return gather(fundamental, amalgamate(fundamental, weight_at, apart_at), arranged);
}

}  // namespace heliograph
