// SPDX-License-Identifier: MIT
// The state of a Bayes tree as bytes: little-endian counts and raw arrays in the order of `archive`, then a checksum.
#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <type_traits>

#include "graph/tree/bayes_tree.hpp"

namespace heliograph {

namespace {

constexpr uint64_t kMark = 0x3245455254594248;  // "HBYTREE2"

uint64_t checksum(std::span<const uint8_t> bytes) {  // FNV-1a, eight bytes at a time
  uint64_t hash = 0xcbf29ce484222325;
  size_t i = 0;
  for (; i + 8 <= bytes.size(); i += 8) {
    uint64_t word = 0;
    std::memcpy(&word, bytes.data() + i, 8);
    hash = (hash ^ word) * 0x100000001b3;
    hash ^= hash >> 29;
  }
  for (; i < bytes.size(); ++i) hash = (hash ^ bytes[i]) * 0x100000001b3;
  return hash;
}

[[noreturn]] void damaged() { throw std::invalid_argument("the saved state is damaged or cut short"); }

class Writer {
 public:
  static constexpr bool reads = false;

  void raw(void* data, size_t size) {
    const auto* from = static_cast<const uint8_t*>(data);
    bytes_.insert(bytes_.end(), from, from + size);
  }
  size_t count(size_t n) {
    uint64_t wide = n;
    raw(&wide, sizeof(wide));
    return n;
  }
  std::vector<uint8_t> take() {
    uint64_t sum = checksum(bytes_);
    raw(&sum, sizeof(sum));
    return std::move(bytes_);
  }

 private:
  std::vector<uint8_t> bytes_;
};

class Reader {
 public:
  static constexpr bool reads = true;

  explicit Reader(std::span<const uint8_t> bytes) {
    uint64_t sum = 0;
    if (bytes.size() < sizeof(sum)) damaged();
    bytes_ = bytes.first(bytes.size() - sizeof(sum));
    std::memcpy(&sum, bytes.data() + bytes_.size(), sizeof(sum));
    if (sum != checksum(bytes_)) damaged();
  }

  void raw(void* data, size_t size) {
    if (size > bytes_.size()) damaged();
    if (size > 0) std::memcpy(data, bytes_.data(), size);
    bytes_ = bytes_.subspan(size);
  }
  size_t count(size_t) {
    uint64_t wide = 0;
    raw(&wide, sizeof(wide));
    if (wide > bytes_.size()) damaged();  // nothing takes less than a byte
    return static_cast<size_t>(wide);
  }
  bool done() const { return bytes_.empty(); }

 private:
  std::span<const uint8_t> bytes_;
};

template <typename Archive, typename... T>
void plain(Archive& with, T&... values) {
  static_assert((std::is_trivially_copyable_v<T> && ...));
  (with.raw(&values, sizeof(T)), ...);
}

template <typename Archive, typename... T>
void arrays(Archive& with, std::vector<T>&... values) {
  const auto one = [&](auto& stack) {
    const size_t n = with.count(stack.size());
    if constexpr (Archive::reads) stack.resize(n);
    with.raw(stack.data(), n * sizeof(stack[0]));
  };
  (one(values), ...);
}

template <typename Archive>
void block(Archive& with, BlockPool& pool, double*& at, size_t size) {
  if constexpr (Archive::reads) at = size > 0 ? pool.take(size) : nullptr;
  with.raw(at, size * sizeof(double));
}

template <typename Archive>
void whole_kind(Archive& with, FactorGroup& kind) {
  plain(with, kind.type, kind.arity, kind.rows, kind.manifold, kind.dof, kind.storage, kind.count, kind.measurement_size, kind.noise,
        kind.kernel, kind.kernel_width);
  arrays(with, kind.variables, kind.values, kind.measurement, kind.sqrt_information, kind.weight, kind.residual);
  for (std::vector<double>& jacobian : kind.jacobian) arrays(with, jacobian);
}

template <typename Archive, typename Saved>
void saved_variables(Archive& with, std::vector<Saved>& all) {
  all.resize(with.count(all.size()));
  for (Saved& saved : all) {
    plain(with, saved.variable);
    arrays(with, saved.theta, saved.delta);
  }
}

template <typename Archive>
void whole_clique(Archive& with, BlockPool& pool, Clique& clique) {
  plain(with, clique.parent, clique.child, clique.next, clique.previous, clique.pivot_nodes, clique.first_factor, clique.pivots,
        clique.rows, clique.height, clique.update_height, clique.flagged, clique.unsolved, clique.deferred, clique.solved);
  arrays(with, clique.nodes);
  if (clique.nodes.empty()) return;  // not in use
  block(with, pool, clique.factor, static_cast<size_t>(clique.height) * static_cast<size_t>(clique.pivots));
  block(with, pool, clique.update, static_cast<size_t>(clique.update_height) * static_cast<size_t>(clique.rows));
}

}  // namespace

template <typename Archive>
void BayesTree::archive(Archive& with) {
  uint64_t mark = kMark;
  plain(with, mark);
  if (mark != kMark) damaged();
  arrays(with, manifold_, dof_, theta_at_, delta_at_, clique_of_, theta_, delta_, changed_, fluid_flag_, held_, frozen_, fluid_);
  arrays(with, free_factors_, free_cliques_, roots_, made_, attached_, deferred_);
  arrays(with, affected_, orphans_, open_factors_, undo_, kept_order_);
  for (std::vector<int32_t>& free : free_variables_) arrays(with, free);
  saved_variables(with, job_saved_);
  plain(with, update_number_, solve_number_, counts_, open_, free_count_, eliminated_, wildfire_, fluid_threshold_);
  kinds_.resize(with.count(kinds_.size()));
  free_rows_.resize(kinds_.size());
  for (size_t k = 0; k < kinds_.size(); ++k) {
    whole_kind(with, kinds_[k]);
    arrays(with, free_rows_[k]);
  }
  factors_.resize(with.count(factors_.size()));
  for (TreeFactor& factor : factors_) {
    plain(with, factor.kind, factor.index, factor.clique, factor.next, factor.stale);
    if (factor.kind < 0) continue;
    if (static_cast<size_t>(factor.kind) >= kinds_.size()) damaged();
    block(with, factor_blocks_, factor.block, block_size(kinds_[static_cast<size_t>(factor.kind)]));
  }
  cliques_.resize(with.count(cliques_.size()));
  for (Clique& clique : cliques_) whole_clique(with, clique_blocks_, clique);
}

std::vector<uint8_t> BayesTree::save() const {
  if (!idle() || !removed_.empty() || !weighed_.empty())
    throw std::invalid_argument("an update is under way; save between updates");
  Writer writer;
  const_cast<BayesTree*>(this)->archive(writer);  // one list of members serves both ways; writing changes none
  return writer.take();
}

void BayesTree::load(std::span<const uint8_t> bytes) {
  if (!dof_.empty() || !kinds_.empty()) throw std::invalid_argument("only an empty tree can load a state");
  Reader reader(bytes);
  archive(reader);
  if (!reader.done()) damaged();
  check_loaded();
  touched_flag_.assign(dof_.size(), 0);
  local_.assign(dof_.size(), -1);
}

// Whoever gets past the checksum wrote it on purpose; sizes that would be read out of bounds are refused all the same.
void BayesTree::check_loaded() const {
  const size_t n = dof_.size();
  for (const size_t size : {manifold_.size(), theta_at_.size(), delta_at_.size(), clique_of_.size(), changed_.size(),
                            fluid_flag_.size(), held_.size(), frozen_.size()})
    if (size != n) damaged();
  const auto inside = [](int32_t index, size_t size) {
    if (index < -1 || (index >= 0 && static_cast<size_t>(index) >= size)) damaged();
  };
  for (size_t v = 0; v < n; ++v) inside(clique_of_[v], cliques_.size());
  for (const std::vector<int32_t>& free : free_variables_)
    for (const int32_t v : free) inside(v, n);
  for (const std::vector<int32_t>* list : {&affected_, &undo_, &kept_order_})
    for (const int32_t v : *list) inside(v, n);
  for (const Saved& saved : job_saved_) inside(saved.variable, n);
  for (const std::vector<int32_t>* list : {&orphans_, &deferred_})
    for (const int32_t c : *list) inside(c, cliques_.size());
  for (const int32_t f : open_factors_) inside(f, factors_.size());
  for (const Clique& clique : cliques_) {
    for (const int32_t link : {clique.parent, clique.child, clique.next, clique.previous}) inside(link, cliques_.size());
    inside(clique.first_factor, factors_.size());
    for (const int32_t v : clique.nodes) inside(v, n);
  }
  for (const TreeFactor& factor : factors_) {
    inside(factor.clique, cliques_.size());
    inside(factor.next, factors_.size());
  }
}

}  // namespace heliograph
