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
          map.moments().data(),
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

// Spreads the moments of one power of time over rows and columns of rotation and position.
void feigned_pose(const double* a, const double* T, double (*F)[6]) {
  const double S[9] = {a[0], a[1], a[2], a[1], a[3], a[4], a[2], a[4], a[5]};
  const double* C = a + 6;
  const double D[9] = {a[15], a[16], a[17], a[16], a[18], a[19], a[17], a[19], a[20]};
  double RS[9];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      F[i][j] = D[3 * i + j];
      double turned = 0.0, both = 0.0;
      for (int k = 0; k < 3; ++k) {
        turned += C[3 * i + k] * T[4 * j + k];
        both += T[4 * i + k] * S[3 * k + j];
      }
      F[i][3 + j] = F[3 + j][i] = turned;
      RS[3 * i + j] = both;
    }
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      F[3 + i][3 + j] = 0.0;
      for (int k = 0; k < 3; ++k) F[3 + i][3 + j] += RS[3 * i + k] * T[4 * j + k];
    }
}

// A row by velocity is -dt times that by position, a row by the gyroscope's bias dt times that by rotation.
void feigned_information(const double* moments, const double* T, bool motion, int columns, double* out) {
  double F[3][6][6];
  for (int k = 0; k < (motion ? 3 : 1); ++k) feigned_pose(moments + k * kFeigned, T, F[k]);
  const auto pose = [](int i) { return i < 6 ? i : (i < 9 ? i - 3 : i - 9); };
  const auto sign = [](int i) { return i >= 6 && i < 9 ? -1.0 : 1.0; };
  const int size = motion ? 12 : 6;
  for (int i = 0; i < size; ++i)
    for (int j = 0; j < size; ++j)
      out[i * columns + j] = sign(i) * sign(j) * F[(i >= 6 ? 1 : 0) + (j >= 6 ? 1 : 0)][pose(i)][pose(j)];
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
  double feigned[3 * kFeigned] = {};
  for (const NormalSums& part : partial) {
    for (int i = 0; i < 3 * kFeigned; ++i) feigned[i] += part.feigned[i];
    total.feigned_square += part.feigned_square;
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
  feigned_information(feigned, in.T_odom_body, in.before_end != nullptr, in.columns, total.feigned);
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
  kernels().query(in, points_odom.data(), 0, points_odom.size() / 3, out.normal, out.point, out.variance, out.tilt, out.scatter,
                  out.since, out.source);
}

}  // namespace heliograph
