// SPDX-License-Identifier: MIT
#include "io/decode.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>

namespace heliograph {

namespace {

// Column by column over a block that stays in the first-level cache: each loop has one type and no branch.
constexpr size_t kBlock = 256;

template <typename From, typename To>
void convert(const std::byte* at, std::ptrdiff_t stride, size_t count, To* out) {
  for (size_t k = 0; k < count; ++k, at += stride) {
    From value;
    std::memcpy(&value, at, sizeof value);
    if constexpr (std::is_floating_point_v<From> && std::is_integral_v<To>) {
      out[k] = 0;  // a ring is never floating point: the wrapper sees to that
    } else {
      out[k] = static_cast<To>(value);
    }
  }
}

template <typename To>
void read_block(const Column& column, size_t row, size_t first, size_t count, To* out) {
  const std::byte* at = column.data + static_cast<std::ptrdiff_t>(row) * column.row_stride +
                        static_cast<std::ptrdiff_t>(first) * column.stride;
  switch (column.type) {
    case ColumnType::i8: return convert<int8_t>(at, column.stride, count, out);
    case ColumnType::u8: return convert<uint8_t>(at, column.stride, count, out);
    case ColumnType::i16: return convert<int16_t>(at, column.stride, count, out);
    case ColumnType::u16: return convert<uint16_t>(at, column.stride, count, out);
    case ColumnType::i32: return convert<int32_t>(at, column.stride, count, out);
    case ColumnType::u32: return convert<uint32_t>(at, column.stride, count, out);
    case ColumnType::f32: return convert<float>(at, column.stride, count, out);
    case ColumnType::f64: return convert<double>(at, column.stride, count, out);
  }
}

// Which of a block's points are there, as places in the block.
struct Selection {
  std::array<uint16_t, kBlock> at;
  size_t count;
};

Selection append_points(const PointColumns& columns, size_t row, size_t first, size_t count, DecodedPoints* out) {
  std::array<float, kBlock> x, y, z;
  read_block(columns.x, row, first, count, x.data());
  read_block(columns.y, row, first, count, y.data());
  read_block(columns.z, row, first, count, z.data());
  Selection chosen;
  chosen.count = 0;
  for (size_t k = 0; k < count; ++k) {
    const float extent = std::abs(x[k]) + std::abs(y[k]) + std::abs(z[k]);
    chosen.at[chosen.count] = static_cast<uint16_t>(k);
    chosen.count += extent > 0.0F && extent < std::numeric_limits<float>::infinity() ? 1 : 0;  // false for NaN
  }
  const size_t before = out->points.size();
  out->points.resize(before + 3 * chosen.count);
  float* p = out->points.data() + before;
  for (size_t k = 0; k < chosen.count; ++k) {
    *p++ = x[chosen.at[k]];
    *p++ = y[chosen.at[k]];
    *p++ = z[chosen.at[k]];
  }
  const auto number = static_cast<uint32_t>(row * columns.columns + first);
  for (size_t k = 0; k < chosen.count; ++k) out->kept.push_back(number + chosen.at[k]);
  return chosen;
}

template <typename To>
void append_values(const Column& column, size_t row, size_t first, size_t count, const Selection& chosen,
                   std::vector<To>* out) {
  std::array<To, kBlock> values;
  read_block(column, row, first, count, values.data());
  const size_t before = out->size();
  out->resize(before + chosen.count);
  To* to = out->data() + before;
  for (size_t k = 0; k < chosen.count; ++k) to[k] = values[chosen.at[k]];
}

}  // namespace

DecodedPoints decode_points(const PointColumns& columns) {
  DecodedPoints out;
  const size_t most = columns.rows * columns.columns;
  out.points.reserve(3 * most);
  out.kept.reserve(most);
  if (columns.time) out.times.reserve(most);
  if (columns.intensity) out.intensity.reserve(most);
  if (columns.ring) out.ring.reserve(most);
  for (size_t row = 0; row < columns.rows; ++row) {
    for (size_t first = 0; first < columns.columns; first += kBlock) {
      const size_t count = std::min(kBlock, columns.columns - first);
      const Selection chosen = append_points(columns, row, first, count, &out);
      if (columns.time) append_values(*columns.time, row, first, count, chosen, &out.times);
      if (columns.intensity) append_values(*columns.intensity, row, first, count, chosen, &out.intensity);
      if (columns.ring) append_values(*columns.ring, row, first, count, chosen, &out.ring);
    }
  }
  out.first_time = std::numeric_limits<double>::infinity();
  for (const double time : out.times)
    if (std::isfinite(time) && time < out.first_time) out.first_time = time;
  return out;
}

SweepOffsets sweep_offsets(std::span<const double> times, double first, double ns_per_unit, double longest_ns) {
  SweepOffsets out;
  out.offsets_ns.resize(times.size());
  for (size_t k = 0; k < times.size(); ++k) {
    const double relative = (times[k] - first) * ns_per_unit;
    const bool within = relative <= longest_ns && relative >= -longest_ns;  // false for NaN
    const auto offset = static_cast<int32_t>(std::lrint(within ? relative : 0.0));
    out.offsets_ns[k] = offset;
    out.largest = std::max(out.largest, offset);
    out.outside += within ? 0 : 1;
  }
  return out;
}

}  // namespace heliograph
