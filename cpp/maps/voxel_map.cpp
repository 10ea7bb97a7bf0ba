// SPDX-License-Identifier: MIT
#include "maps/voxel_map.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "util/point_rank.hpp"

namespace heliograph {

namespace {

// About a millimetre at 10 m: de-skewing the same point from another driver's message differs by less.
constexpr int kRankBits = 10;

}  // namespace

// What one scan adds to one finest cube. Gathering first means that the large tables are touched once a cube, not once a
// point and level.
struct VoxelMap::Delta {
  uint64_t key;
  Cube cube;
  float count = 0.0F;
  float sum[3] = {0.0F, 0.0F, 0.0F};
  float outer[6] = {0.0F, 0.0F, 0.0F, 0.0F, 0.0F, 0.0F};
  uint32_t rank = std::numeric_limits<uint32_t>::max();
  double raw[3] = {0.0, 0.0, 0.0};  // the point that stands for the others in the fallback's grid
};

VoxelMap::VoxelMap(const VoxelMapSettings& settings)
    : settings_(settings), points_(settings.levels > 1 ? 2.0 * settings.voxel : settings.voxel, settings.point_spacing) {
  if (settings.voxel <= 0.0 || settings.levels < 1 || settings.levels > 8)
    throw std::invalid_argument("a voxel map needs a positive voxel and 1 to 8 levels");
}

std::vector<VoxelMap::Delta> VoxelMap::gather(std::span<const float> points_body, const double* T) {
  const double inverse = 1.0 / settings_.voxel;
  FlatIndex seen(15);
  std::vector<Delta> deltas;
  deltas.reserve(points_body.size() / 24);
  for (size_t k = 0; k + 2 < points_body.size(); k += 3) {
    const double x = points_body[k], y = points_body[k + 1], z = points_body[k + 2];
    if (!std::isfinite(x + y + z)) continue;
    const double q[3] = {T[0] * x + T[1] * y + T[2] * z + T[3], T[4] * x + T[5] * y + T[6] * z + T[7],
                         T[8] * x + T[9] * y + T[10] * z + T[11]};
    const Cube cube{floor_index(q[0] * inverse), floor_index(q[1] * inverse),
                    floor_index(q[2] * inverse)};
    const uint64_t key = pack(0, cube);
    const auto [id, is_new] = seen.insert(key, static_cast<uint32_t>(deltas.size()));
    if (is_new) deltas.push_back({.key = key, .cube = cube});
    Delta& d = deltas[id];
    if (const uint32_t rank = point_rank(points_body.data() + k, kRankBits); is_new || rank < d.rank) {
      d.rank = rank;
      std::copy(q, q + 3, d.raw);
    }
    const float u = static_cast<float>(q[0] - (static_cast<double>(cube.x) + 0.5) * settings_.voxel);
    const float v = static_cast<float>(q[1] - (static_cast<double>(cube.y) + 0.5) * settings_.voxel);
    const float w = static_cast<float>(q[2] - (static_cast<double>(cube.z) + 0.5) * settings_.voxel);
    d.count += 1.0F;
    d.sum[0] += u;
    d.sum[1] += v;
    d.sum[2] += w;
    d.outer[0] += u * u;
    d.outer[1] += u * v;
    d.outer[2] += u * w;
    d.outer[3] += v * v;
    d.outer[4] += v * w;
    d.outer[5] += w * w;
  }
  return deltas;
}

// Returns whether the cube is new.
bool VoxelMap::add(const Delta& delta, uint64_t level) {
  const Cube cube{delta.cube.x >> level, delta.cube.y >> level, delta.cube.z >> level};
  const uint64_t key = pack(level, cube);
  const auto [id, is_new] = index_.insert(key, static_cast<uint32_t>(planes_.size()));
  if (is_new) {
    planes_.push_back({{0, 0, 0}, {0, 0, 0}, -1.0F, 0.0F});
    moments_.push_back({key, 0.0F, 0.0F, {0, 0, 0}, {0, 0, 0, 0, 0, 0}, false});
    born_.push_back(static_cast<uint32_t>(mountings_.size() / 12 - 1));
  }
  Moments& m = moments_[id];
  if (m.frozen) return false;
  const double fine = settings_.voxel, coarse = edge(level);
  const float d[3] = {
      static_cast<float>((static_cast<double>(delta.cube.x) + 0.5) * fine - (static_cast<double>(cube.x) + 0.5) * coarse),
      static_cast<float>((static_cast<double>(delta.cube.y) + 0.5) * fine - (static_cast<double>(cube.y) + 0.5) * coarse),
      static_cast<float>((static_cast<double>(delta.cube.z) + 0.5) * fine - (static_cast<double>(cube.z) + 0.5) * coarse)};
  const float n = delta.count;
  const float* s = delta.sum;
  m.count += n;
  for (int i = 0; i < 3; ++i) m.sum[i] += s[i] + n * d[i];
  int k = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j, ++k) m.outer[k] += delta.outer[k] + s[i] * d[j] + d[i] * s[j] + n * d[i] * d[j];
  touched_.push_back(id);
  return is_new;
}

void VoxelMap::refit(uint32_t id) {
  Moments& m = moments_[id];
  // Only now, so that it does not matter in which order the insertion's points came.
  m.frozen = m.count >= static_cast<float>(settings_.max_points);
  // A plane barely changes while its cube gains less than a quarter of its points.
  if (m.count < static_cast<float>(settings_.min_points) || m.count < 1.25F * m.fitted) return;
  m.fitted = m.count;
  const double n = m.count;
  const Eigen::Vector3d mean(m.sum[0] / n, m.sum[1] / n, m.sum[2] / n);
  Eigen::Matrix3d covariance;
  covariance << m.outer[0], m.outer[1], m.outer[2], m.outer[1], m.outer[3], m.outer[4], m.outer[2], m.outer[4], m.outer[5];
  covariance = covariance / n - mean * mean.transpose();
  Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
  solver.computeDirect(covariance);
  const Eigen::Vector3d& spread = solver.eigenvalues();
  const double size = edge(key_level(m.key));
  const double thinnest = std::max(spread[0], 0.0);
  Plane& plane = planes_[id];
  const double least = settings_.min_spread * size;
  if (thinnest > settings_.max_thickness * settings_.max_thickness || spread[1] < least * least ||
      spread[1] < 4.0 * thinnest) {
    plane.variance = -1.0F;
    return;
  }
  const Eigen::Vector3d normal = solver.eigenvectors().col(0).normalized();
  for (int i = 0; i < 3; ++i) {
    plane.normal[i] = static_cast<float>(normal[i]);
    plane.centroid[i] = static_cast<float>(mean[i]);
  }
  plane.variance = static_cast<float>(std::max(thinnest, 1e-8) / n);
  plane.inv_spread = static_cast<float>(1.0 / spread[1]);
}

double VoxelMap::insert(std::span<const float> points_body, const double* T_odom_body, const double* T_body_lidar) {
  const std::vector<Delta> deltas = gather(points_body, T_odom_body);
  touched_.clear();
  if (anchor_.empty()) anchor_.assign(T_odom_body, T_odom_body + 12);
  mountings_.insert(mountings_.end(), T_body_lidar, T_body_lidar + 12);
  FlatIndex coarse(12);
  size_t created = 0;
  const auto top = static_cast<uint64_t>(settings_.levels - 1);
  std::vector<std::pair<uint64_t, uint32_t>> raw;
  for (size_t k = 0; k < deltas.size(); ++k) {
    const Delta& delta = deltas[k];
    for (uint64_t level = 0; level < top; ++level) add(delta, level);
    created += add(delta, top) ? 1 : 0;
    coarse.insert(pack(top, {delta.cube.x >> top, delta.cube.y >> top, delta.cube.z >> top}), 0);
    if (points_.accepts(delta.raw)) raw.emplace_back(delta.key, static_cast<uint32_t>(k));
  }
  // Raw points turn their neighbours away, so their order counts: it is that of space, not that of the driver.
  std::sort(raw.begin(), raw.end());
  for (const auto& [key, at] : raw) points_.insert(deltas[at].raw);
  // A cube that several deltas reached is listed as often; its second refit finds nothing new to do.
  for (const uint32_t id : touched_) refit(id);
  return coarse.size() == 0 ? 0.0 : static_cast<double>(created) / static_cast<double>(coarse.size());
}

void VoxelMap::prune(const double* centre, double radius, size_t max_voxels) {
  std::vector<double> distance2(planes_.size());
  for (size_t id = 0; id < planes_.size(); ++id) {
    const Cube cube = unpack(moments_[id].key);
    const double size = edge(key_level(moments_[id].key));
    const double dx = (static_cast<double>(cube.x) + 0.5) * size - centre[0];
    const double dy = (static_cast<double>(cube.y) + 0.5) * size - centre[1];
    const double dz = (static_cast<double>(cube.z) + 0.5) * size - centre[2];
    distance2[id] = dx * dx + dy * dy + dz * dz;
  }
  double limit2 = radius * radius;
  if (planes_.size() > max_voxels && max_voxels > 0) {
    std::vector<double> sorted = distance2;
    const auto nth = sorted.begin() + static_cast<std::ptrdiff_t>(max_voxels - 1);
    std::nth_element(sorted.begin(), nth, sorted.end());
    limit2 = std::min(limit2, *nth);
  }
  FlatIndex index;
  size_t kept = 0;
  for (size_t id = 0; id < planes_.size(); ++id) {
    if (distance2[id] > limit2) continue;
    planes_[kept] = planes_[id];
    moments_[kept] = moments_[id];
    born_[kept] = born_[id];
    index.insert(moments_[kept].key, static_cast<uint32_t>(kept));
    ++kept;
  }
  planes_.resize(kept);
  moments_.resize(kept);
  born_.resize(kept);
  index_ = std::move(index);
  points_.prune(centre, std::sqrt(limit2));
}

size_t VoxelMap::bytes() const {
  return index_.bytes() + planes_.capacity() * sizeof(Plane) + moments_.capacity() * sizeof(Moments) + points_.bytes();
}

}  // namespace heliograph
