// SPDX-License-Identifier: MIT
// Open-addressing map from voxel keys to pool indices: one probe is one cache line.
#pragma once
#include <bit>
#include <cstdint>
#include <utility>
#include <vector>

#include "util/voxel_key.hpp"

namespace heliograph {

constexpr uint32_t kSeenMask = 0x7fffffffU;  // insertions that an index can tell apart

class FlatIndex {
 public:
  struct Slot {
    uint64_t key;
    uint32_t value;
    // For the owner: nothing more can be added to what `value` names, so it need not be looked at; and the number of the
    // last insertion that met it.
    uint32_t full : 1;
    uint32_t seen : 31;
  };

  // Whether each value was met in insertion `oldest` or later, for owners whose values count up from 0.
  std::vector<uint8_t> seen_since(uint32_t oldest) const {
    std::vector<uint8_t> wanted(size_);
    for (const Slot& slot : slots_)
      if (slot.key != kNoKey) wanted[slot.value] = slot.seen >= oldest ? 1 : 0;
    return wanted;
  }

  explicit FlatIndex(size_t capacity_log2 = 12) { reset(capacity_log2); }

  // The slot of `key`, valid until the next insertion; `value` goes in first when it is new; second tells which.
  std::pair<Slot*, bool> place(uint64_t key, uint32_t value) {
    if (2 * (size_ + 1) > slots_.size()) grow();
    for (uint64_t i = mix(key) & mask_;; i = (i + 1) & mask_) {
      Slot& slot = slots_[i];
      if (slot.key == key) return {&slot, false};
      if (slot.key == kNoKey) {
        slot = {key, value, 0, 0};
        ++size_;
        return {&slot, true};
      }
    }
  }

  // The value of `key`, inserting `value` first when it is new; second tells which.
  std::pair<uint32_t, bool> insert(uint64_t key, uint32_t value) {
    const auto [slot, is_new] = place(key, value);
    return {slot->value, is_new};
  }

  // The slot of `key`, null when it is not there.
  const Slot* find(uint64_t key) const {
    for (uint64_t i = mix(key) & mask_;; i = (i + 1) & mask_) {
      if (slots_[i].key == key) return &slots_[i];
      if (slots_[i].key == kNoKey) return nullptr;
    }
  }
  Slot* find(uint64_t key) { return const_cast<Slot*>(std::as_const(*this).find(key)); }

  // Forgets `key`, which is there. What was probed past it moves up, so that no probe ends too early.
  void erase(uint64_t key) {
    uint64_t hole = mix(key) & mask_;
    while (slots_[hole].key != key) hole = (hole + 1) & mask_;
    for (uint64_t i = (hole + 1) & mask_; slots_[i].key != kNoKey; i = (i + 1) & mask_) {
      const uint64_t home = mix(slots_[i].key) & mask_;
      if (((i - home) & mask_) < ((i - hole) & mask_)) continue;
      slots_[hole] = slots_[i];
      hole = i;
    }
    slots_[hole] = Slot{kNoKey, 0, 0, 0};
    --size_;
  }

  // Whether so few of `count` entries go that erasing them one by one is quicker than making the table anew.
  static bool few(size_t gone, size_t count) { return 8 * gone <= count; }

  // Forgets the entries of which `wanted[value]` is 0; those that stay are numbered anew, in the order of their values.
  void keep(const std::vector<uint8_t>& wanted) {
    std::vector<uint32_t> number(wanted.size());
    uint32_t kept = 0;
    for (size_t i = 0; i < wanted.size(); ++i) number[i] = wanted[i] != 0 ? kept++ : 0;
    const std::vector<Slot> old = std::move(slots_);
    reset(static_cast<size_t>(std::bit_width(2 * static_cast<size_t>(kept) + 1)));
    size_ = kept;
    for (const Slot& slot : old)
      if (slot.key != kNoKey && wanted[slot.value] != 0)
        settle({slot.key, number[slot.value], slot.full, slot.seen});
  }

  void prefetch(uint64_t key) const { __builtin_prefetch(slots_.data() + (mix(key) & mask_), 1); }

  void clear() {
    for (Slot& slot : slots_) slot.key = kNoKey;
    size_ = 0;
  }

  size_t size() const { return size_; }
  const Slot* slots() const { return slots_.data(); }
  uint64_t mask() const { return mask_; }
  size_t bytes() const { return slots_.size() * sizeof(Slot); }

 private:
  void reset(size_t capacity_log2) {
    slots_.assign(size_t{1} << capacity_log2, Slot{kNoKey, 0, 0, 0});
    mask_ = slots_.size() - 1;
    size_ = 0;
  }

  void grow() {
    std::vector<Slot> old = std::move(slots_);
    slots_.assign(2 * old.size(), Slot{kNoKey, 0, 0, 0});
    mask_ = slots_.size() - 1;
    for (const Slot& slot : old)
      if (slot.key != kNoKey) settle(slot);
  }

  void settle(const Slot& slot) {
    uint64_t i = mix(slot.key) & mask_;
    while (slots_[i].key != kNoKey) i = (i + 1) & mask_;
    slots_[i] = slot;
  }

  std::vector<Slot> slots_;
  uint64_t mask_ = 0;
  size_t size_ = 0;
};

}  // namespace heliograph
