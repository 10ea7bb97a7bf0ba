// SPDX-License-Identifier: MIT
// What is done with a residual once it is found: linearise, cost or evaluate; and the entry points of a room's kernels.
#pragma once
#include "graph/factors/normal_blocks.inl"

namespace heliograph {
namespace {

// How a residual's blocks are formed; the most frequent ones have a way of their own.
template <class Residual>
struct Linearizer {
  static void run(const FactorView& view, size_t begin, size_t end, double* blocks, GroupCost* sum) {
    linearize_range<Residual>(view, begin, end, blocks, sum);
  }
};

struct Linearize {
  const FactorView& view;
  size_t begin, end;
  double* blocks;
  GroupCost* sum;
  template <class Residual>
  bool with() const {
    Linearizer<Residual>::run(view, begin, end, blocks, sum);
    return true;
  }
};

struct Cost {
  const FactorView& view;
  size_t begin, end;
  GroupCost* sum;
  template <class Residual>
  bool with() const {
    cost_range<Residual>(view, begin, end, sum);
    return true;
  }
};

struct Evaluate {
  const FactorView& view;
  size_t begin, end;
  double *residual, *jacobian;
  template <class Residual>
  bool with() const {
    evaluate_range<Residual>(view, begin, end, residual, jacobian);
    return true;
  }
};

// A room finds the residual of a view by `static bool visit(const Action&)`, which calls `action.with<Residual>()`.
template <class Room>
struct Entry {
  static bool linearize(const FactorView& view, size_t begin, size_t end, double* blocks, GroupCost* sum) {
    return Room::visit(Linearize{view, begin, end, blocks, sum});
  }
  static bool cost(const FactorView& view, size_t begin, size_t end, GroupCost* sum) {
    return Room::visit(Cost{view, begin, end, sum});
  }
  static bool evaluate(const FactorView& view, size_t begin, size_t end, double* residual, double* jacobian) {
    return Room::visit(Evaluate{view, begin, end, residual, jacobian});
  }
};

template <class Room>
FactorKernels kernels_of() {
  return {Entry<Room>::linearize, Entry<Room>::cost, Entry<Room>::evaluate};
}

}  // namespace
}  // namespace heliograph
