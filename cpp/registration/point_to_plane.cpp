// SPDX-License-Identifier: MIT
#include "registration/point_to_plane.hpp"

#include <algorithm>
#include <vector>

#include "registration/match_view.hpp"
#include "util/isa.hpp"
#include "util/parallel.hpp"

namespace heliograph {

namespace {

constexpr size_t kChunk = 512;

MatchKernels kernels() {
#if defined(HELIOGRAPH_HAVE_AVX2)
  if (active_isa() == Isa::avx2) return avx2_match_kernels();
#endif
  return baseline_match_kernels();
}

MapView view(const VoxelMap& map) {
  return {{map.index().slots(), map.index().mask()},
          map.planes().data(),
          {map.points().index().slots(), map.points().index().mask()},
          map.points().buckets().data(),
          map.settings().voxel,
          map.points().size(),
          map.settings().max_thickness,
          map.settings().levels};
}

MatchInput input(const VoxelMap& map, const MatchScan& scan, const MatchSettings& s) {
  return {view(map),
          scan.points_body.data(),
          s.blocks.motion ? scan.before_end.data() : nullptr,
          scan.T_odom_body,
          s.blocks.mounting ? scan.T_body_lidar : nullptr,
          scan.T_odom_body_first,
          s.gate,
          s.kernel,
          s.sigma,
          s.fallback_range,
          s.fallback_stride,
          s.blocks.columns()};
}

// Sums chunk by chunk, so that the result does not depend on which thread did which.
template <typename Kernel>
NormalEquations sum_chunks(const MatchInput& in, size_t count, int threads, Kernel kernel) {
  const size_t chunks = (count + kChunk - 1) / kChunk;
  std::vector<NormalSums> partial(chunks, NormalSums{});
  parallel_chunks(chunks, threads, [&](size_t chunk) {
    kernel(in, chunk * kChunk, std::min(count, (chunk + 1) * kChunk), &partial[chunk]);
  });
  NormalEquations total;
  for (const NormalSums& part : partial) {
    for (int i = 0; i < in.columns; ++i) {
      total.gradient[i] += part.gradient[i];
      for (int j = i; j < in.columns; ++j) total.information[i * in.columns + j] += part.information[kRow * i + j];
    }
    total.weight += part.weight;
    total.robust_weight += part.robust_weight;
    total.square += part.square;
    total.cost += part.cost;
    total.matches += part.matches;
    total.fallback_matches += part.fallback_matches;
  }
  for (int i = 0; i < in.columns; ++i)
    for (int j = 0; j < i; ++j) total.information[i * in.columns + j] = total.information[j * in.columns + i];
  return total;
}

}  // namespace

NormalEquations match_planes(const VoxelMap& map, const MatchScan& scan, const MatchSettings& settings, int threads) {
  return sum_chunks(input(map, scan, settings), scan.points_body.size() / 3, threads, kernels().planes);
}

NormalEquations match_points(const VoxelMap& map, const MatchScan& scan, const MatchSettings& settings, int threads) {
  return sum_chunks(input(map, scan, settings), scan.points_body.size() / 3, threads, kernels().points);
}

void query_planes(const VoxelMap& map, std::span<const double> points_odom, const MatchSettings& settings,
                  PlaneQuery out) {
  const MatchInput in = input(map, {{}, {}, nullptr, nullptr, nullptr}, settings);
  kernels().query(in, points_odom.data(), 0, points_odom.size() / 3, out.normal, out.point, out.variance, out.source);
}

}  // namespace heliograph
