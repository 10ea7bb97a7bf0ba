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
          map.born().data(),
          map.anchor().data(),
          map.settings().voxel,
          map.points().size(),
          map.settings().max_thickness,
          map.settings().levels};
}

MatchInput input(const VoxelMap& map, const MatchScan& scan, const double* remount,
                 const MatchSettings& s) {
  return {view(map),
          scan.points_body.data(),
          scan.before_end.empty() ? nullptr : scan.before_end.data(),
          scan.T_odom_body,
          scan.T_body_lidar,
          remount,
          s.gate,
          s.kernel,
          s.sigma,
          s.fallback_range,
          s.fallback_stride,
          s.columns};
}

// Error vectors (rotation, lever arm) from the mounting of each insertion to the present one. They are small, so the
// rotation is that of the antisymmetric part.
std::vector<double> mounting_changes(const VoxelMap& map, const double* E) {
  const std::vector<double>& old = map.mountings();
  std::vector<double> changes(old.size() / 2);
  for (size_t k = 0; k < old.size() / 12; ++k) {
    const double* B = old.data() + 12 * k;
    double M[3][3];
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) M[i][j] = B[i] * E[j] + B[4 + i] * E[4 + j] + B[8 + i] * E[8 + j];
    double* d = changes.data() + 6 * k;
    d[0] = 0.5 * (M[2][1] - M[1][2]);
    d[1] = 0.5 * (M[0][2] - M[2][0]);
    d[2] = 0.5 * (M[1][0] - M[0][1]);
    for (int i = 0; i < 3; ++i) d[3 + i] = E[4 * i + 3] - B[4 * i + 3];
  }
  return changes;
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
  std::vector<double> remount;
  if (settings.columns == kMaxColumns || (settings.columns > 6 && scan.before_end.empty()))
    remount = mounting_changes(map, scan.T_body_lidar);
  return sum_chunks(input(map, scan, remount.data(), settings), scan.points_body.size() / 3, threads, kernels().planes);
}

NormalEquations match_points(const VoxelMap& map, const MatchScan& scan, const MatchSettings& settings, int threads) {
  return sum_chunks(input(map, scan, nullptr, settings), scan.points_body.size() / 3, threads, kernels().points);
}

void query_planes(const VoxelMap& map, std::span<const double> points_odom, const MatchSettings& settings,
                  PlaneQuery out) {
  const MatchInput in = input(map, {{}, {}, nullptr, nullptr}, nullptr, settings);
  kernels().query(in, points_odom.data(), 0, points_odom.size() / 3, out.normal, out.point, out.variance, out.source);
}

}  // namespace heliograph
