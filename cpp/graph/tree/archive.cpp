// SPDX-License-Identifier: MIT
#include "graph/tree/archive.hpp"

#include <cstring>
#include <stdexcept>
#include <type_traits>
#include <utility>

#include "graph/tree/soundness.hpp"

namespace heliograph {

namespace {

constexpr uint64_t kMark = 0x3345455254594248, kMarkBefore = 0x3245455254594248;  // "HBYTREE3", and 2: nothing was let go

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
  size_t count(size_t n, size_t) {
    uint64_t wide = n;
    raw(&wide, sizeof(wide));
    return n;
  }
  void expect_doubles(size_t) const {}
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
  // Of things that take at least so many bytes each: no more memory is asked for than the file's size allows.
  size_t count(size_t, size_t bytes) {
    uint64_t wide = 0;
    raw(&wide, sizeof(wide));
    if (wide > bytes_.size() / bytes) damaged();
    return static_cast<size_t>(wide);
  }
  void expect_doubles(size_t n) const {
    if (n > bytes_.size() / sizeof(double)) damaged();
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
    const size_t n = with.count(stack.size(), sizeof(stack[0]));
    if constexpr (Archive::reads) stack.resize(n);
    with.raw(stack.data(), n * sizeof(stack[0]));
  };
  (one(values), ...);
}

template <typename Archive>
void block(Archive& with, BlockPool& pool, double*& at, size_t size) {
  with.expect_doubles(size);
  if constexpr (Archive::reads) at = size > 0 ? pool.take(size) : nullptr;
  with.raw(at, size * sizeof(double));
}

template <typename Archive>
void whole_kind(Archive& with, FactorGroup& kind) {
  plain(with, kind.type, kind.arity, kind.rows, kind.manifold, kind.dof, kind.storage, kind.count, kind.measurement_size, kind.noise,
        kind.kernel, kind.kernel_width);
  if (kind.arity < 1 || kind.arity > kMaxArity) damaged();  // the sizes of its factors' blocks follow from these
  for (size_t a = 0; a < static_cast<size_t>(kind.arity); ++a)
    if (kind.dof[a] < 1 || kind.dof[a] > kMaxDof) damaged();
  arrays(with, kind.variables, kind.values, kind.measurement, kind.sqrt_information, kind.weight, kind.residual);
  for (std::vector<double>& jacobian : kind.jacobian) arrays(with, jacobian);
}

template <typename Archive>
void saved_variables(Archive& with, std::vector<SavedVariable>& all) {
  all.resize(with.count(all.size(), sizeof(int32_t) + 2 * sizeof(uint64_t)));
  for (SavedVariable& saved : all) {
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
  if (Archive::reads && (clique.pivots < 0 || clique.rows < 0 || clique.height < 0 || clique.update_height < 0)) damaged();
  block(with, pool, clique.factor, clique.factor_doubles());
  block(with, pool, clique.update, clique.update_doubles());
}

// What one takes in a file at least [bytes].
constexpr size_t kLeastKind = 200, kLeastFactor = 17, kLeastClique = 54;

// The layout, one list for both ways.
template <typename Archive>
void whole_tree(Archive& with, StoredTree& tree) {
  uint64_t mark = kMark;
  plain(with, mark);
  if (mark != kMark && mark != kMarkBefore) damaged();
  auto& [v, factors, cliques, journal, top, kept_order, steps, counts] = tree;
  arrays(with, v.manifold, v.dof, v.theta_at, v.delta_at, v.clique_of, v.theta, v.delta, v.changed, v.fluid_flag, v.held, v.frozen,
         v.fluid);
  arrays(with, factors.free, cliques.free, cliques.roots, steps.made, steps.attached, steps.deferred);
  arrays(with, top.affected, top.orphans, top.factors, journal.put_back, kept_order);
  for (std::vector<int32_t>& free : v.free) arrays(with, free);
  saved_variables(with, journal.slice_saved);
  uint8_t open = top.open ? 1 : 0;
  plain(with, top.update_number, steps.solve_number, counts, open, v.free_count, steps.eliminated, steps.wildfire,
        steps.relinearize);
  if (open > 1) damaged();
  top.open = open != 0;
  factors.kinds.resize(with.count(factors.kinds.size(), kLeastKind));
  factors.free_rows.resize(factors.kinds.size());
  for (size_t k = 0; k < factors.kinds.size(); ++k) {
    whole_kind(with, factors.kinds[k]);
    arrays(with, factors.free_rows[k]);
  }
  factors.factors.resize(with.count(factors.factors.size(), kLeastFactor));
  for (TreeFactor& factor : factors.factors) {
    plain(with, factor.kind, factor.index, factor.clique, factor.next, factor.stale);
    if (mark == kMark) plain(with, factor.let_go);
    if (factor.kind < 0) continue;
    if (static_cast<size_t>(factor.kind) >= factors.kinds.size()) damaged();
    block(with, factors.blocks, factor.block, block_size(factors.kinds[static_cast<size_t>(factor.kind)]));
  }
  cliques.all.resize(with.count(cliques.all.size(), kLeastClique));
  for (Clique& clique : cliques.all) whole_clique(with, cliques.blocks, clique);
}

}  // namespace

std::vector<uint8_t> write_tree(StoredTree tree) {
  Writer writer;
  whole_tree(writer, tree);
  return writer.take();
}

void read_tree(StoredTree tree, std::span<const uint8_t> bytes) {
  Reader reader(bytes);
  whole_tree(reader, tree);
  if (!reader.done()) damaged();
  check_tree(tree);
}

}  // namespace heliograph
