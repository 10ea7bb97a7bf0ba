// SPDX-License-Identifier: MIT
// Memory for many small blocks of doubles that come and go: size classes cut from large pieces, so that nothing moves when it
// grows and what is given back is used again.
#pragma once
#include <bit>
#include <cstddef>
#include <memory>
#include <vector>

namespace heliograph {

class BlockPool {
 public:
  double* take(size_t doubles) {
    const size_t kind = class_of(doubles);
    if (kind >= free_.size()) free_.resize(kind + 1);
    in_use_ += size_of(kind);
    if (!free_[kind].empty()) {
      double* block = free_[kind].back();
      free_[kind].pop_back();
      return block;
    }
    const size_t size = size_of(kind);
    if (size > kPiece / 8) {  // large ones have a piece of their own
      pieces_.push_back(std::make_unique_for_overwrite<double[]>(size));
      held_ += size;
      return pieces_.back().get();
    }
    if (left_ < size) {
      pieces_.push_back(std::make_unique_for_overwrite<double[]>(kPiece));
      held_ += kPiece;
      next_ = pieces_.back().get();
      left_ = kPiece;
    }
    double* block = next_;
    next_ += size;
    left_ -= size;
    return block;
  }

  void give_back(double* block, size_t doubles) {
    if (block == nullptr) return;
    const size_t kind = class_of(doubles);
    in_use_ -= size_of(kind);
    free_[kind].push_back(block);
  }

  size_t in_use() const { return in_use_; }  // doubles
  size_t held() const { return held_; }

 private:
  static constexpr size_t kPiece = size_t{1} << 17;

  // Four classes to each power of two: at most a quarter is wasted.
  static size_t class_of(size_t doubles) {
    if (doubles <= 8) return doubles <= 4 ? 0 : 1;
    const auto top = static_cast<size_t>(std::bit_width(doubles - 1)) - 1;  // 2^top < doubles <= 2^(top + 1)
    const size_t quarter = ((doubles - 1) >> (top - 2)) & 3;
    return 2 + (top - 3) * 4 + quarter;
  }
  static size_t size_of(size_t kind) {
    if (kind < 2) return kind == 0 ? 4 : 8;
    const size_t top = (kind - 2) / 4 + 3, quarter = (kind - 2) % 4;
    return (size_t{1} << top) + ((quarter + 1) << (top - 2));
  }

  std::vector<std::vector<double*>> free_;
  std::vector<std::unique_ptr<double[]>> pieces_;
  double* next_ = nullptr;
  size_t left_ = 0;
  size_t in_use_ = 0;
  size_t held_ = 0;
};

}  // namespace heliograph
