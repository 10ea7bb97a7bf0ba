// SPDX-License-Identifier: MIT
#include "graph/diagnosis/diagnosis.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "graph/diagnosis/slots.hpp"
#include "graph/factors/regular.hpp"

namespace heliograph {

namespace {

// Whether one factor of this type determines a variable at all values if it does at some.
bool always_regular(FactorType type) {
  return type == FactorType::prior || type == FactorType::between || type == FactorType::landmark ||
         type == FactorType::linear_motion;
}

int32_t root_of(std::vector<int32_t>& parent, int32_t v) {
  while (parent[static_cast<size_t>(v)] != v) {
    int32_t& up = parent[static_cast<size_t>(v)];
    up = parent[static_cast<size_t>(up)];
    v = up;
  }
  return v;
}

// A factor as the search sees it.
struct Link {
  const FactorGroup* group;
  const Slots* slots;
  const int32_t* scope;
  const double* block;
};

class Finder {
 public:
  Finder(const GraphProblem& problem, int most_columns)
      : problem_(problem), variables_(problem.variables()), most_columns_(most_columns) {
    for (const FactorGroup& group : problem.groups()) {
      slots_.push_back(slots_of(group));
      factors_ += group.count;
    }
    index();
  }

  FreeSpace run(std::span<const int32_t> assumed);
  int32_t components() const {
    FreeSpace space;
    components(&space);
    return space.components;
  }

 private:
  size_t at(int32_t v) const { return static_cast<size_t>(v); }
  Link link(int32_t f) const {
    const auto g = static_cast<size_t>(group_of_[at(f)]);
    const FactorGroup& group = problem_.groups()[g];
    const size_t row = at(f) - group.first_factor;
    return {&group, &slots_[g], group.variables.data() + row * static_cast<size_t>(group.arity),
            problem_.blocks().data() + group.block + row * static_cast<size_t>(slots_[g].size)};
  }
  std::span<const int32_t> factors_at(int32_t v) const {
    return {adjacent_.data() + begin_[at(v)], static_cast<size_t>(begin_[at(v) + 1] - begin_[at(v)])};
  }
  void index();
  void components(FreeSpace* out) const;
  void settle(int32_t v, bool fixed);
  void ready(int32_t v, const Link& factor, size_t a);
  bool attempt(int32_t v);
  void attempt_together(int32_t f);
  void solve_motion(const double* lower, const double* scale, int n, std::vector<double>* right) const;
  void add_motion(const Link& factor, size_t a, std::vector<double>* right) const;
  void drain();
  void seed(int32_t v);
  bool resists();
  void add_resistance(const Link& factor, int columns, std::vector<double>* gram, std::vector<double>* magnitude) const;
  void split(std::vector<int32_t> left);
  void part(std::vector<int32_t> members);
  void store(const std::vector<int32_t>& members, FreeSpace* out);

  const GraphProblem& problem_;
  size_t variables_;
  int most_columns_;
  size_t factors_ = 0;
  std::vector<Slots> slots_;
  std::vector<int32_t> group_of_;                  // (factors)
  std::vector<int32_t> begin_, adjacent_;          // factors of each variable
  std::vector<uint8_t> open_;                      // (factors) variables that are not settled
  enum class Place : uint8_t { open, fixed, moving };
  std::vector<Place> place_;                       // (variables)
  std::vector<int32_t> ready_, tried_;             // (variables) factors that join it to settled variables only
  std::vector<int32_t> queue_, pending_, body_;
  std::vector<std::vector<double>> motion_;        // (variables) dof x columns when it was settled
  int columns_ = 0;                                // of the present part
  std::vector<std::vector<int32_t>> work_;
  FreeSpace out_;
};

void Finder::index() {
  group_of_.resize(factors_);
  open_.resize(factors_);
  begin_.assign(variables_ + 1, 0);
  size_t f = 0;
  for (size_t g = 0; g < problem_.groups().size(); ++g) {
    const FactorGroup& group = problem_.groups()[g];
    for (const int32_t v : group.variables) ++begin_[at(v) + 1];
    std::fill_n(group_of_.begin() + static_cast<std::ptrdiff_t>(f), group.count, static_cast<int32_t>(g));
    std::fill_n(open_.begin() + static_cast<std::ptrdiff_t>(f), group.count, static_cast<uint8_t>(group.arity));
    f += group.count;
  }
  std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
  adjacent_.resize(static_cast<size_t>(begin_.back()));
  std::vector<int32_t> to(begin_.begin(), begin_.end() - 1);
  int32_t number = 0;
  for (const FactorGroup& group : problem_.groups())
    for (size_t k = 0; k < group.count; ++k, ++number)
      for (size_t a = 0; a < static_cast<size_t>(group.arity); ++a)
        adjacent_[at(to[at(group.variables[k * static_cast<size_t>(group.arity) + a])]++)] = number;
}

void Finder::components(FreeSpace* out) const {
  std::vector<int32_t> parent(variables_);
  std::iota(parent.begin(), parent.end(), 0);
  for (const FactorGroup& group : problem_.groups()) {
    const auto arity = static_cast<size_t>(group.arity);
    for (size_t k = 0; k < group.count && arity > 1; ++k) {
      const int32_t* scope = group.variables.data() + k * arity;
      for (size_t a = 1; a < arity; ++a) {
        const int32_t x = root_of(parent, scope[0]), y = root_of(parent, scope[a]);
        parent[at(std::max(x, y))] = std::min(x, y);
      }
    }
  }
  out->component.resize(variables_);
  out->factors.resize(variables_);
  for (size_t v = 0; v < variables_; ++v) {  // a root is the least of its component, so it is numbered first
    const int32_t root = root_of(parent, static_cast<int32_t>(v));
    out->component[v] = at(root) == v ? out->components++ : out->component[at(root)];
    out->factors[v] = begin_[v + 1] - begin_[v];
  }
}

// Its value, or its motion, is known from here on.
void Finder::settle(int32_t v, bool fixed) {
  place_[at(v)] = fixed ? Place::fixed : Place::moving;
  if (!fixed) body_.push_back(v);
  queue_.push_back(v);
}

// One more factor joins v to settled variables only. Attempts are at powers of two, and at last when the search is stuck.
void Finder::ready(int32_t v, const Link& factor, size_t a) {
  const int32_t count = ++ready_[at(v)];
  if (count == 1 && columns_ == 0) {  // most variables: their first factor is enough
    tried_[at(v)] = 1;
    if (!regular(factor.block + factor.slots->at[a][a], factor.group->dof[a])) return;
    out_.everywhere = out_.everywhere && always_regular(factor.group->type);
    settle(v, true);
    return;
  }
  if ((count & (count - 1)) != 0 || !attempt(v)) pending_.push_back(v);
}

bool Finder::attempt(int32_t v) {
  const int n = problem_.dof_of(at(v));
  tried_[at(v)] = ready_[at(v)];
  double sum[kMaxDof * kMaxDof], magnitude[kMaxDof], scale[kMaxDof];
  std::fill_n(sum, n * n, 0.0);
  for (const int32_t f : factors_at(v)) {
    if (open_[at(f)] != 1) continue;
    const Link factor = link(f);
    size_t a = 0;
    while (factor.scope[a] != v) ++a;
    const double* h = factor.block + factor.slots->at[a][a];
    for (int k = 0; k < n * n; ++k) sum[k] += h[k];
  }
  if (columns_ == 0) {
    if (!regular(sum, n)) return false;
    out_.everywhere = false;
    settle(v, true);
    return true;
  }
  for (int k = 0; k < n; ++k) magnitude[k] = sum[k * n + k];
  if (!regular_factor(sum, n, magnitude, scale)) return false;
  std::vector<double> right(static_cast<size_t>(n * columns_), 0.0);
  bool moved = false;
  for (const int32_t f : factors_at(v)) {
    if (open_[at(f)] != 1) continue;
    const Link factor = link(f);
    size_t a = 0;
    while (factor.scope[a] != v) ++a;
    for (int b = 0; b < factor.group->arity; ++b) moved |= place_[at(factor.scope[b])] == Place::moving;
    add_motion(factor, a, &right);
  }
  if (!moved) {
    settle(v, true);
    return true;
  }
  solve_motion(sum, scale, n, &right);
  motion_[at(v)] = std::move(right);
  settle(v, false);
  return true;
}

// right = -H^-1 right, with the scaled Cholesky factor of H: how open variables follow their neighbours' pull.
void Finder::solve_motion(const double* lower, const double* scale, int n, std::vector<double>* right) const {
  double x[kMaxDof];
  for (int c = 0; c < columns_; ++c) {
    double* column = right->data() + c;
    for (int i = 0; i < n; ++i) {
      x[i] = column[static_cast<size_t>(i * columns_)] * scale[i];
      for (int k = 0; k < i; ++k) x[i] -= lower[i * n + k] * x[k];
      x[i] /= lower[i * n + i];
    }
    for (int i = n; i-- > 0;) {
      for (int k = i + 1; k < n; ++k) x[i] -= lower[k * n + i] * x[k];
      x[i] /= lower[i * n + i];
    }
    for (int i = 0; i < n; ++i) column[static_cast<size_t>(i * columns_)] = -x[i] * scale[i];
  }
}

// A factor with several open variables and enough rows may determine all of them at once, as a motion model does with the
// next state and what drifts along. Without this every such step would need a seed of its own.
void Finder::attempt_together(int32_t f) {
  const Link factor = link(f);
  const FactorGroup& group = *factor.group;
  size_t open[kMaxArity];
  int first[kMaxArity], count = 0, n = 0;
  bool moved = false;
  for (size_t a = 0; a < static_cast<size_t>(group.arity); ++a) {
    const Place place = place_[at(factor.scope[a])];
    moved |= place == Place::moving;
    if (place != Place::open) continue;
    open[count] = a;
    first[count++] = n;
    n += group.dof[a];
  }
  if (count < 2 || n > group.rows || n > kMaxDof) return;
  double sum[kMaxDof * kMaxDof], magnitude[kMaxDof], scale[kMaxDof];
  for (int p = 0; p < count; ++p)
    for (int q = 0; q <= p; ++q) {  // H_qp is stored, q <= p; the lower triangle is read
      const double* h = factor.block + factor.slots->at[open[q]][open[p]];
      const int rows = group.dof[open[q]], columns = group.dof[open[p]];
      for (int r = 0; r < rows; ++r)
        for (int c = 0; c < columns; ++c) sum[(first[p] + c) * n + first[q] + r] = h[r * columns + c];
    }
  for (int k = 0; k < n; ++k) magnitude[k] = sum[k * n + k];
  if (!regular_factor(sum, n, magnitude, scale)) return;
  std::vector<double> right(static_cast<size_t>(n * columns_), 0.0);
  if (moved) {
    for (int p = 0; p < count; ++p) {
      std::vector<double> part(static_cast<size_t>(group.dof[open[p]] * columns_), 0.0);
      add_motion(factor, open[p], &part);
      std::copy(part.begin(), part.end(), right.begin() + static_cast<std::ptrdiff_t>(first[p]) * columns_);
    }
    solve_motion(sum, scale, n, &right);
  } else {
    out_.everywhere = false;
  }
  for (int p = 0; p < count; ++p) {
    const int32_t v = factor.scope[open[p]];
    const auto begin = right.begin() + static_cast<std::ptrdiff_t>(first[p]) * columns_;
    if (moved) motion_[at(v)].assign(begin, begin + static_cast<std::ptrdiff_t>(group.dof[open[p]]) * columns_);
    settle(v, !moved);
  }
}

// right += H_ab M_b of the factor's other variables.
void Finder::add_motion(const Link& factor, size_t a, std::vector<double>* right) const {
  const FactorGroup& group = *factor.group;
  for (size_t b = 0; b < static_cast<size_t>(group.arity); ++b) {
    const int32_t other = factor.scope[b];
    if (b == a || place_[at(other)] != Place::moving) continue;
    const std::vector<double>& m = motion_[at(other)];
    const int rows = group.dof[a], inner = group.dof[b], columns = static_cast<int>(m.size()) / inner;
    const double* h = factor.block + (a < b ? factor.slots->at[a][b] : factor.slots->at[b][a]);
    for (int r = 0; r < rows; ++r)
      for (int k = 0; k < inner; ++k) {
        const double x = a < b ? h[r * inner + k] : h[k * rows + r];
        for (int c = 0; c < columns; ++c)
          (*right)[static_cast<size_t>(r * columns_ + c)] += x * m[static_cast<size_t>(k * columns + c)];
      }
  }
}

// Follows everything that the queue determines, until nothing moves on.
void Finder::drain() {
  size_t next = 0;
  while (true) {
    for (; next < queue_.size(); ++next)
      for (const int32_t f : factors_at(queue_[next])) {
        if (--open_[at(f)] > 1) attempt_together(f);
        if (open_[at(f)] != 1) continue;
        const Link factor = link(f);
        for (size_t a = 0; a < static_cast<size_t>(factor.group->arity); ++a)
          if (place_[at(factor.scope[a])] == Place::open) ready(factor.scope[a], factor, a);
      }
    queue_.clear();
    next = 0;
    std::vector<int32_t> again;
    again.swap(pending_);
    for (const int32_t v : again)
      if (place_[at(v)] == Place::open && tried_[at(v)] != ready_[at(v)]) attempt(v);
    if (queue_.empty()) return;
  }
}

void Finder::seed(int32_t v) {
  const int n = problem_.dof_of(at(v));
  const int before = columns_;
  columns_ += n;
  std::vector<double> m(static_cast<size_t>(n * columns_), 0.0);
  for (int i = 0; i < n; ++i) m[static_cast<size_t>(i * columns_ + before + i)] = 1.0;
  motion_[at(v)] = std::move(m);
  settle(v, false);
  drain();
}

// Whether the factors among what moves (and what is fixed) leave none of the seeds' motions free.
bool Finder::resists() {
  const auto n = static_cast<size_t>(columns_);
  std::vector<double> gram(n * n, 0.0), magnitude(n, 0.0), scale(n);
  for (const int32_t v : body_)
    for (const int32_t f : factors_at(v)) {
      if (open_[at(f)] != 0) continue;
      const Link factor = link(f);
      int a = 0;
      while (place_[at(factor.scope[a])] != Place::moving) ++a;
      if (factor.scope[a] == v) add_resistance(factor, columns_, &gram, &magnitude);  // each factor once
    }
  return regular_factor(gram.data(), columns_, magnitude.data(), scale.data());
}

void Finder::add_resistance(const Link& factor, int columns, std::vector<double>* gram, std::vector<double>* magnitude) const {
  const FactorGroup& group = *factor.group;
  const auto n = static_cast<size_t>(columns);
  for (size_t a = 0; a < static_cast<size_t>(group.arity); ++a) {
    if (place_[at(factor.scope[a])] != Place::moving) continue;
    const std::vector<double>& ma = motion_[at(factor.scope[a])];
    const auto rows = static_cast<size_t>(group.dof[a]), ca = ma.size() / rows;
    std::vector<double> pull(rows * n, 0.0);
    std::vector<double> own(rows * n, 0.0);
    for (size_t b = 0; b < static_cast<size_t>(group.arity); ++b) {
      if (place_[at(factor.scope[b])] != Place::moving) continue;
      const std::vector<double>& mb = motion_[at(factor.scope[b])];
      const auto inner = static_cast<size_t>(group.dof[b]), cb = mb.size() / inner;
      const double* h = factor.block + (a <= b ? factor.slots->at[a][b] : factor.slots->at[b][a]);
      for (size_t r = 0; r < rows; ++r)
        for (size_t k = 0; k < inner; ++k) {
          const double x = a <= b ? h[r * inner + k] : h[k * rows + r];
          for (size_t c = 0; c < cb; ++c) pull[r * n + c] += x * mb[k * cb + c];
          if (a == b)
            for (size_t c = 0; c < cb; ++c) own[r * n + c] += std::abs(x * mb[k * cb + c]);
        }
    }
    for (size_t r = 0; r < rows; ++r)
      for (size_t i = 0; i < ca; ++i) {
        (*magnitude)[i] += std::abs(ma[r * ca + i]) * own[r * n + i];
        for (size_t j = 0; j < n; ++j) (*gram)[i * n + j] += ma[r * ca + i] * pull[r * n + j];
      }
  }
}

// Puts the connected parts of what is still open on the list of work.
void Finder::split(std::vector<int32_t> left) {
  std::erase_if(left, [&](int32_t v) { return place_[at(v)] != Place::open; });
  std::sort(left.begin(), left.end());
  std::vector<uint8_t> seen(left.size(), 0);
  const auto where = [&](int32_t v) { return static_cast<size_t>(std::lower_bound(left.begin(), left.end(), v) - left.begin()); };
  std::vector<std::vector<int32_t>> parts;
  for (size_t first = 0; first < left.size(); ++first) {
    if (seen[first] != 0) continue;
    std::vector<int32_t> members{left[first]};
    seen[first] = 1;
    for (size_t next = 0; next < members.size(); ++next)
      for (const int32_t f : factors_at(members[next])) {
        if (open_[at(f)] < 2) continue;
        const Link factor = link(f);
        for (int a = 0; a < factor.group->arity; ++a) {
          const int32_t v = factor.scope[a];
          if (place_[at(v)] != Place::open || seen[where(v)] != 0) continue;
          seen[where(v)] = 1;
          members.push_back(v);
        }
      }
    std::sort(members.begin(), members.end());
    parts.push_back(std::move(members));
  }
  for (size_t p = parts.size(); p-- > 0;) work_.push_back(std::move(parts[p]));
}

// Moves a connected part by seeds, one after another, until every variable of it follows.
void Finder::part(std::vector<int32_t> members) {
  // Poses come first as seeds: they carry points along, points carry nothing.
  std::vector<int32_t> order(members);
  const auto rank = [&](int32_t v) {
    const auto& families = problem_.families();
    size_t f = 0;
    while (at(v) >= families[f].first + families[f].count) ++f;
    return families[f].manifold == Manifold::vector ? 0 : families[f].dof;
  };
  std::stable_sort(order.begin(), order.end(), [&](int32_t a, int32_t b) { return rank(a) > rank(b); });
  columns_ = 0;
  body_.clear();
  bool resolved = true;
  int seeds = 0;
  for (const int32_t v : order) {
    if (place_[at(v)] != Place::open) continue;
    if (columns_ + problem_.dof_of(at(v)) > most_columns_ && seeds > 0) {
      resolved = false;
      break;
    }
    seed(v);
    if (++seeds == 1 && body_.size() < members.size() && resists()) break;
  }
  const bool complete = std::none_of(members.begin(), members.end(), [&](int32_t v) { return place_[at(v)] == Place::open; });
  if (resolved && (!complete || resists())) {
    out_.everywhere = false;
    for (const int32_t v : body_) {
      place_[at(v)] = Place::fixed;
      motion_[at(v)] = {};
    }
    columns_ = 0;
    drain();  // what only waited for a retry
    split(std::move(members));
    return;
  }
  const auto number = static_cast<int32_t>(out_.columns.size());
  out_.columns.push_back(resolved ? columns_ : 0);
  for (const int32_t v : members) {
    if (place_[at(v)] == Place::fixed) continue;
    out_.part[at(v)] = number;
    out_.freedom[at(v)] = resolved ? Freedom::follows : Freedom::unresolved;
  }
  if (resolved) store(members, &out_);
  for (const int32_t v : members) motion_[at(v)] = {};
}

void Finder::store(const std::vector<int32_t>& members, FreeSpace* out) {
  const auto n = static_cast<size_t>(columns_);
  for (const int32_t v : members) {
    if (place_[at(v)] != Place::moving) continue;
    const auto rows = static_cast<size_t>(problem_.dof_of(at(v)));
    const std::vector<double>& m = motion_[at(v)];
    const size_t columns = m.size() / rows;
    out->motion_of[at(v)] = static_cast<int64_t>(out->motion.size());
    for (size_t r = 0; r < rows; ++r)
      for (size_t c = 0; c < n; ++c) out->motion.push_back(c < columns ? m[r * columns + c] : 0.0);
  }
}

FreeSpace Finder::run(std::span<const int32_t> assumed) {
  place_.assign(variables_, Place::open);
  ready_.assign(variables_, 0);
  tried_.assign(variables_, 0);
  for (size_t v = 0; v < variables_; ++v)
    if (problem_.held(v)) settle(static_cast<int32_t>(v), true);
  for (const int32_t v : assumed)
    if (place_[at(v)] == Place::open) settle(v, true);
  for (const FactorGroup& group : problem_.groups())
    for (size_t k = 0; k < group.count && group.arity == 1; ++k)
      if (place_[at(group.variables[k])] == Place::open)
        ready(group.variables[k], link(static_cast<int32_t>(group.first_factor + k)), 0);
  drain();
  std::vector<int32_t> left;
  for (size_t v = 0; v < variables_; ++v)
    if (place_[v] == Place::open) left.push_back(static_cast<int32_t>(v));
  if (left.empty()) return std::move(out_);
  out_.determined = false;
  components(&out_);
  out_.freedom.assign(variables_, Freedom::determined);
  out_.part.assign(variables_, -1);
  out_.motion_of.assign(variables_, -1);
  motion_.resize(variables_);
  split(std::move(left));
  while (!work_.empty()) {
    std::vector<int32_t> members = std::move(work_.back());
    work_.pop_back();
    part(std::move(members));
  }
  return std::move(out_);
}

}  // namespace

FreeSpace free_space(const GraphProblem& problem, std::span<const int32_t> assumed, int most_columns) {
  return Finder(problem, most_columns).run(assumed);
}

int32_t count_components(const GraphProblem& problem) { return Finder(problem, 0).components(); }

}  // namespace heliograph
