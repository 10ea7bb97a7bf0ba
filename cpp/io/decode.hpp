// SPDX-License-Identifier: MIT
// From a message's point columns, wherever they lie in it, to packed arrays without the points that are not there.
#pragma once
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace heliograph {

enum class ColumnType { i8, u8, i16, u16, i32, u32, f32, f64 };

// One value a point in rows x columns; the strides are in bytes and may be anything, so nothing is aligned.
struct Column {
  const std::byte* data;
  std::ptrdiff_t row_stride, stride;
  ColumnType type;
};

struct PointColumns {
  size_t rows, columns;
  Column x, y, z;
  std::optional<Column> time, intensity, ring;
};

struct DecodedPoints {
  std::vector<float> points;       // (N, 3)
  std::vector<double> times;       // (N,) in the column's own unit, or empty where there is none
  std::vector<float> intensity;    // likewise
  std::vector<uint16_t> ring;      // likewise
  std::vector<uint32_t> kept;      // their numbers in storage order
  double first_time = 0.0;         // the least finite time; infinity where none is finite
};

// Keeps the points whose coordinates are finite and not all zero.
DecodedPoints decode_points(const PointColumns& columns);

struct SweepOffsets {
  std::vector<int32_t> offsets_ns;
  int32_t largest = 0;   // of those within
  size_t outside = 0;    // points later than `longest_ns` or of no finite time; their offset is 0
};

// (time - first) * ns_per_unit, rounded to the nearest nanosecond, ties to even.
SweepOffsets sweep_offsets(std::span<const double> times, double first, double ns_per_unit, double longest_ns);

}  // namespace heliograph
