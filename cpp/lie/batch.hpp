// SPDX-License-Identifier: MIT
// The Lie maps of heliograph.lie over batches of matrices: row-major, one element behind the other. Sizes in doubles.
#pragma once
#include <cstddef>

namespace heliograph {

struct UnaryMap {
  const char* name;
  size_t in, out;  // of one element
  void (*apply)(const double* in, double* out, size_t count);
};

struct BinaryMap {
  const char* name;
  size_t size;  // of each element, the result's too
  void (*apply)(const double* a, const double* b, double* out, size_t count);
};

constexpr size_t kUnaryMaps = 18, kBinaryMaps = 2;
extern const UnaryMap unary_maps[kUnaryMaps];
extern const BinaryMap binary_maps[kBinaryMaps];

}  // namespace heliograph
