// SPDX-License-Identifier: MIT
#include <cmath>
#include <cstring>
#include <limits>
#include <vector>

#include "io/decode.hpp"
#include "tests/check.hpp"

using namespace heliograph;

namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

void check_packed_records() {
  constexpr size_t kCount = 600, kStep = 17;  // longer than a block, and no element aligned
  std::vector<std::byte> records(kCount * kStep);
  for (size_t k = 0; k < kCount; ++k) {
    const float xyz[3] = {k % 3 == 1 ? kNaN : static_cast<float>(k), 0.0F, 0.0F};  // and the first is zero
    const auto time = static_cast<uint32_t>(1000 + k);
    std::memcpy(records.data() + k * kStep, xyz, 12);
    std::memcpy(records.data() + k * kStep + 12, &time, 4);
    records[k * kStep + 16] = static_cast<std::byte>(k % 16);
  }
  const auto column = [&](size_t offset, ColumnType type) { return Column{records.data() + offset, 0, kStep, type}; };
  const PointColumns in{1,
                        kCount,
                        column(0, ColumnType::f32),
                        column(4, ColumnType::f32),
                        column(8, ColumnType::f32),
                        column(12, ColumnType::u32),
                        std::nullopt,
                        column(16, ColumnType::u8)};
  const DecodedPoints out = decode_points(in);
  CHECK(out.kept.size() == 399 && out.points.size() == 3 * 399 && out.times.size() == 399 && out.ring.size() == 399);
  CHECK(out.intensity.empty() && out.kept.front() == 2 && out.first_time == 1002.0);
  for (size_t k = 0; k < out.kept.size(); ++k) {
    CHECK(out.points[3 * k] == static_cast<float>(out.kept[k]));
    CHECK(out.times[k] == 1000.0 + out.kept[k] && out.ring[k] == out.kept[k] % 16);
  }
}

void check_offsets() {
  const std::vector<double> times{0.0, 1.0, std::numeric_limits<double>::quiet_NaN(), 1e9};
  const SweepOffsets out = sweep_offsets(times, 0.0, 1000.0, 2e9);
  CHECK(out.offsets_ns[1] == 1000 && out.offsets_ns[2] == 0 && out.offsets_ns[3] == 0);
  CHECK(out.largest == 1000 && out.outside == 2);
}

}  // namespace

void check_io() {
  check_packed_records();
  check_offsets();
}
