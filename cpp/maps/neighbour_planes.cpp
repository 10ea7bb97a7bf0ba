// SPDX-License-Identifier: MIT
#include "maps/neighbour_planes.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "util/moments.hpp"
#include "util/parallel.hpp"
#include "util/voxel_key.hpp"

namespace heliograph {

namespace {

constexpr size_t kChunk = 256;
constexpr double kFarthest = 1e6;  // a cube's index holds no more
constexpr size_t kMaxNeighbours = 32;

bool plane_at(const IncrementalKdTree& tree, const double* q, const NeighbourPlaneSettings& s, size_t i, const NeighbourPlanes& out) {
  float found[kMaxNeighbours], places[3 * kMaxNeighbours];
  const float query[3] = {static_cast<float>(q[0]), static_cast<float>(q[1]), static_cast<float>(q[2])};
  if (!std::isfinite(query[0] + query[1] + query[2])) return false;
  if (tree.nearest(query, s.neighbours, static_cast<float>(s.reach * s.reach), found, places) < s.neighbours) return false;
  PointMoments m;
  for (size_t k = 0; k < s.neighbours; ++k)
    m.add(static_cast<double>(places[3 * k]) - q[0], static_cast<double>(places[3 * k + 1]) - q[1], static_cast<double>(places[3 * k + 2]) - q[2]);
  double c[6], values[3], axes[9];
  m.covariance(c);
  symmetric_axes(c, values, axes);
  if (values[0] > s.max_thickness * s.max_thickness || values[1] < s.min_spread * s.min_spread || values[1] < 4.0 * values[0]) return false;
  const double d[3] = {m.sum[0] / m.count, m.sum[1] / m.count, m.sum[2] / m.count};
  const double r = axes[0] * d[0] + axes[1] * d[1] + axes[2] * d[2];
  if (std::abs(r) > s.gate) return false;
  const double aside = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] - r * r;
  for (size_t k = 0; k < 3; ++k) {
    out.normal[3 * i + k] = static_cast<float>(axes[k]);
    out.point[3 * i + k] = q[k] + d[k];
  }
  out.variance[i] = static_cast<float>(values[0] / m.count * (1.0 + aside / values[1]));
  out.source[i] = 255;
  return true;
}

struct Box {
  float low[3], high[3];
};

Box box_of(const Cube& cube, double edge) {
  const double at[3] = {static_cast<double>(cube.x), static_cast<double>(cube.y), static_cast<double>(cube.z)};
  Box box;
  for (size_t k = 0; k < 3; ++k) {
    box.low[k] = static_cast<float>(at[k] * edge);
    box.high[k] = box.low[k] + static_cast<float>(edge);
  }
  return box;
}

}  // namespace

double insert_scan(IncrementalKdTree& tree, std::span<const float> points_body, const double* T, SeenCubes& seen) {
  const double edge = seen.edge();
  seen.begin();
  std::vector<float> odom;
  odom.reserve(points_body.size());
  size_t touched = 0, fresh = 0;
  for (size_t i = 0; i + 2 < points_body.size(); i += 3) {
    const double p[3] = {static_cast<double>(points_body[i]), static_cast<double>(points_body[i + 1]), static_cast<double>(points_body[i + 2])};
    double q[3];
    for (int k = 0; k < 3; ++k) q[k] = T[4 * k] * p[0] + T[4 * k + 1] * p[1] + T[4 * k + 2] * p[2] + T[4 * k + 3];
    if (!(std::abs(q[0]) < kFarthest && std::abs(q[1]) < kFarthest && std::abs(q[2]) < kFarthest)) continue;
    for (const double x : q) odom.push_back(static_cast<float>(x));
    const Cube cube{floor_index(q[0] / edge), floor_index(q[1] / edge), floor_index(q[2] / edge)};
    if (!seen.touch(cube)) continue;
    ++touched;
    const Box box = box_of(cube, edge);
    fresh += !tree.any_in_box(box.low, box.high);
  }
  tree.insert(odom);
  return touched > 0 ? static_cast<double>(fresh) / static_cast<double>(touched) : 0.0;
}

void forget_unseen(IncrementalKdTree& tree, SeenCubes& seen, uint32_t insertions) {
  for (const Cube& cube : seen.forget_unseen(insertions)) {
    const Box box = box_of(cube, seen.edge());
    tree.remove_box(box.low, box.high);
  }
}

void neighbour_planes(const IncrementalKdTree& tree, std::span<const double> queries,
                      const NeighbourPlaneSettings& settings, const NeighbourPlanes& out, int threads) {
  const size_t count = queries.size() / 3;
  NeighbourPlaneSettings s = settings;
  s.neighbours = std::clamp<size_t>(s.neighbours, 3, kMaxNeighbours);
  parallel_chunks((count + kChunk - 1) / kChunk, threads, [&](size_t chunk) {
    for (size_t i = chunk * kChunk; i < std::min(count, (chunk + 1) * kChunk); ++i) {
      std::fill_n(out.normal + 3 * i, 3, 0.0F);
      std::fill_n(out.point + 3 * i, 3, 0.0);
      out.variance[i] = 0.0F;
      out.source[i] = 0;
      plane_at(tree, queries.data() + 3 * i, s, i, out);
    }
  });
}

}  // namespace heliograph
