// SPDX-License-Identifier: MIT
#include "maps/voxel_map.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <stdexcept>

#include "util/point_rank.hpp"

namespace heliograph {

namespace {

constexpr size_t kBatch = 16;
constexpr uint32_t kFull = ~uint32_t{0};
// About a millimetre at 10 m: de-skewing the same point from another driver's message differs by less.
constexpr int kRankBits = 10;
// How many times its variance a finer normal may be off a coarser one, squared and an axis, and still be taken for the
// same: chance goes beyond that in one of fifty cubes. Beyond the second it is a bend for certain (one of 8 000).
constexpr double kChance = 4.0, kBend = 9.0;
constexpr double kFlat = 9.0;  // least ratio of the spreads along and across a plane: less is an edge or a sliver
constexpr double kBorrowed = 10.0;  // points whose scatter a plane borrows from the coarser one

}  // namespace

VoxelMap::VoxelMap(const VoxelMapSettings& settings)
    : settings_(settings), points_(settings.levels > 1 ? 2.0 * settings.voxel : settings.voxel, settings.point_spacing),
      touched_(static_cast<size_t>(std::clamp(settings.levels, 1, 8))) {
  if (settings.voxel <= 0.0 || settings.levels < 1 || settings.levels > 8)
    throw std::invalid_argument("a voxel map needs a positive voxel and 1 to 8 levels");
}

void VoxelMap::gather(std::span<const float> points_body, const double* T) {
  const double inverse = 1.0 / settings_.voxel;
  const size_t count = points_body.size() / 3;
  seen_.clear();
  deltas_.clear();
  std::array<Spot, kBatch> spots;
  for (size_t begin = 0; begin < count; begin += kBatch) {
    const size_t batch = std::min(kBatch, count - begin);
    for (size_t k = 0; k < batch; ++k) {
      const float* p = points_body.data() + 3 * (begin + k);
      const double x = p[0], y = p[1], z = p[2];
      Spot& spot = spots[k];
      spot.key = kNoKey;
      if (!std::isfinite(x + y + z)) continue;
      for (int i = 0; i < 3; ++i) spot.q[i] = T[4 * i] * x + T[4 * i + 1] * y + T[4 * i + 2] * z + T[4 * i + 3];
      spot.cube = {floor_index(spot.q[0] * inverse), floor_index(spot.q[1] * inverse), floor_index(spot.q[2] * inverse)};
      spot.key = pack(0, spot.cube);
      spot.rank = point_rank(p, kRankBits);
      seen_.prefetch(spot.key);
    }
    for (size_t k = 0; k < batch; ++k)
      if (spots[k].key != kNoKey) collect(spots[k]);
  }
}

void VoxelMap::collect(const Spot& spot) {
  const auto [id, is_new] = seen_.insert(spot.key, static_cast<uint32_t>(deltas_.size()));
  if (is_new) deltas_.push_back({.key = spot.key, .cube = spot.cube});
  Delta& d = deltas_[id];
  if (is_new || spot.rank < d.rank) {
    d.rank = spot.rank;
    std::copy(spot.q, spot.q + 3, d.raw);
  }
  const double voxel = settings_.voxel;
  const float u = static_cast<float>(spot.q[0] - (static_cast<double>(spot.cube.x) + 0.5) * voxel);
  const float v = static_cast<float>(spot.q[1] - (static_cast<double>(spot.cube.y) + 0.5) * voxel);
  const float w = static_cast<float>(spot.q[2] - (static_cast<double>(spot.cube.z) + 0.5) * voxel);
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

// The cube of a key, made if it is new, and counted in `created` then; kFull where nothing more goes in.
uint32_t VoxelMap::locate(uint64_t key, size_t* created) {
  const auto [slot, is_new] = index_.place(key, static_cast<uint32_t>(planes_.size()));
  slot->seen = insertions_ & kSeenMask;
  if (slot->full != 0) return kFull;
  if (is_new) {
    planes_.push_back({{0, 0, 0}, {0, 0, 0}, -1.0F, 0.0F});
    moments_.push_back({key, 0.0F, 0.0F, {0, 0, 0}, {0, 0, 0, 0, 0, 0}, 0, 0.0F});
    ++*created;
  }
  return slot->value;
}

void VoxelMap::add(const Delta& delta, uint64_t key, uint32_t id) {
  Moments& m = moments_[id];
  const double fine = settings_.voxel, coarse = edge(key_level(key));
  const uint64_t level = key_level(key);
  const Cube cube{delta.cube.x >> level, delta.cube.y >> level, delta.cube.z >> level};
  const float d[3] = {
      static_cast<float>((static_cast<double>(delta.cube.x) + 0.5) * fine - (static_cast<double>(cube.x) + 0.5) * coarse),
      static_cast<float>((static_cast<double>(delta.cube.y) + 0.5) * fine - (static_cast<double>(cube.y) + 0.5) * coarse),
      static_cast<float>((static_cast<double>(delta.cube.z) + 0.5) * fine - (static_cast<double>(cube.z) + 0.5) * coarse)};
  const float n = delta.count;
  const float* s = delta.sum;
  m.count += n;
  m.since += (static_cast<float>(insertions_) - m.since) * n / m.count;
  for (int i = 0; i < 3; ++i) m.sum[i] += s[i] + n * d[i];
  int k = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = i; j < 3; ++j, ++k) m.outer[k] += delta.outer[k] + s[i] * d[j] + d[i] * s[j] + n * d[i] * d[j];
  if (m.touched != insertions_) touched_[key_level(key)].push_back(id);
  m.touched = insertions_;
}

// Adds a few deltas on all levels and returns how many of the coarsest cubes were new. The tables are larger than any
// cache: asking for all the memory first and using it later lets the waits overlap.
size_t VoxelMap::add_batch(std::span<const Delta> deltas) {
  std::array<uint64_t, 8 * kBatch> keys;
  std::array<uint32_t, 8 * kBatch> ids;
  const auto levels = static_cast<uint64_t>(settings_.levels);
  size_t count = 0, created = 0, finer = 0;
  for (const Delta& delta : deltas) {
    for (uint64_t level = 0; level < levels; ++level) {
      keys[count] = pack(level, {delta.cube.x >> level, delta.cube.y >> level, delta.cube.z >> level});
      index_.prefetch(keys[count++]);
    }
  }
  for (size_t k = 0; k < count; ++k) {
    ids[k] = locate(keys[k], (k + 1) % levels == 0 ? &created : &finer);
    if (ids[k] != kFull) __builtin_prefetch(moments_.data() + ids[k], 1);
  }
  for (size_t k = 0; k < count; ++k)
    if (ids[k] != kFull) add(deltas[k / levels], keys[k], ids[k]);
  return created;
}

// Raw points turn their neighbours away, so their order counts: it is that of space, not that of the driver.
void VoxelMap::add_raw_points() {
  std::vector<const double*> raw(deltas_.size());
  std::transform(deltas_.begin(), deltas_.end(), raw.begin(), [](const Delta& delta) { return delta.raw; });
  const auto accepted = std::make_unique<bool[]>(raw.size());
  points_.accepts(raw, insertions_, accepted.get());
  std::vector<std::pair<uint64_t, const double*>> chosen;
  for (size_t k = 0; k < raw.size(); ++k)
    if (accepted[k]) chosen.emplace_back(deltas_[k].key, raw[k]);
  std::sort(chosen.begin(), chosen.end());
  for (const auto& [key, point] : chosen) points_.insert(point, insertions_);
}

void VoxelMap::refit(uint32_t id) {
  Moments& m = moments_[id];
  // Only now, so that it does not matter in which order the insertion's points came.
  if (m.count >= static_cast<float>(settings_.max_points)) index_.place(m.key, id).first->full = 1;
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
      spread[1] < kFlat * thinnest) {
    plane.variance = -1.0F;
    return;
  }
  const Eigen::Vector3d normal = solver.eigenvectors().col(0).normalized();
  for (int i = 0; i < 3; ++i) {
    plane.normal[i] = static_cast<float>(normal[i]);
    plane.centroid[i] = static_cast<float>(mean[i]);
  }
  // Three numbers of the plane were fitted to the same points, so their scatter about it is too small by as many of them.
  plane.variance = static_cast<float>(std::max(thinnest, 1e-8) / std::max(n - 3.0, 1.0));
  // First order of the eigenvector's error, for the axis along which it is worse.
  plane.inv_spread = static_cast<float>(spread[1] / ((spread[1] - thinnest) * (spread[1] - thinnest)));
  lean_on_coarser(m, &plane);
}

// A plane of a quarter of a metre knows its normal to a degree or two, the one around it many times better. Where both
// agree within that, as on a wall, they are averaged by what they know; what they differ by beyond chance counts as the
// surface's own bend (an estimate of one sample, as in empirical Bayes), and the finer one is left alone.
void VoxelMap::lean_on_coarser(const Moments& m, Plane* plane) const {
  const uint64_t level = key_level(m.key) + 1;
  if (level >= static_cast<uint64_t>(settings_.levels)) return;
  const Cube cube = cube_of(m.key);
  const FlatIndex::Slot* slot = index_.find(pack(level, {cube.x >> 1, cube.y >> 1, cube.z >> 1}));
  if (slot == nullptr || planes_[slot->value].variance < 0.0F) return;
  const Plane& coarse = planes_[slot->value];
  // The scatter of eight points about their plane is a poor guess of the noise; the coarser cube's counts as ten more.
  const double free = std::max(static_cast<double>(m.fitted) - 3.0, 1.0);
  const double around = std::max(static_cast<double>(moments_[slot->value].fitted) - 3.0, 1.0);
  const double thin = free * static_cast<double>(plane->variance), thick = around * static_cast<double>(coarse.variance);
  plane->variance = static_cast<float>(std::max(thin, (free * thin + kBorrowed * thick) / (free + kBorrowed)) / free);
  double dot = 0.0, apart = 0.0;
  for (int i = 0; i < 3; ++i) dot += static_cast<double>(plane->normal[i]) * static_cast<double>(coarse.normal[i]);
  const double sign = dot < 0.0 ? -1.0 : 1.0;
  for (int i = 0; i < 3; ++i) {
    const double d = static_cast<double>(plane->normal[i]) - sign * static_cast<double>(coarse.normal[i]);
    apart += 0.5 * d * d;  // a normal is off about two axes
  }
  const double own = static_cast<double>(plane->variance) * static_cast<double>(plane->inv_spread);
  const double known = static_cast<double>(coarse.variance) * static_cast<double>(coarse.inv_spread);
  const double theirs = known + std::max(apart - kChance * own, 0.0);
  Eigen::Vector3d normal;
  for (int i = 0; i < 3; ++i)
    normal[i] = theirs * static_cast<double>(plane->normal[i]) + own * sign * static_cast<double>(coarse.normal[i]);
  normal.normalize();
  for (int i = 0; i < 3; ++i) plane->normal[i] = static_cast<float>(normal[i]);
  // What was kept of the difference is an error if the surface is even, and it was kept because it was large.
  const double kept = theirs / (own + theirs);
  const double tilt = apart > kBend * own ? own * kept : std::max(known + kept * kept * apart, own * kept);
  plane->inv_spread = static_cast<float>(tilt / static_cast<double>(plane->variance));
}

double VoxelMap::insert(std::span<const float> points_body, const double* T_odom_body) {
  gather(points_body, T_odom_body);
  for (auto& ids : touched_) ids.clear();
  ++insertions_;
  size_t created = 0;
  for (size_t begin = 0; begin < deltas_.size(); begin += kBatch)
    created += add_batch(std::span<const Delta>(deltas_).subspan(begin, std::min(kBatch, deltas_.size() - begin)));
  add_raw_points();
  // Coarse cubes first: finer ones lean on them.
  for (size_t level = touched_.size(); level-- > 0;)
    for (const uint32_t id : touched_[level]) refit(id);
  const size_t surroundings = coarse_cubes();
  return surroundings == 0 ? 0.0 : static_cast<double>(created) / static_cast<double>(surroundings);
}

// How many of the coarsest cubes the deltas reach.
size_t VoxelMap::coarse_cubes() {
  const auto top = static_cast<uint64_t>(settings_.levels - 1);
  seen_.clear();
  uint64_t last = kNoKey;  // neighbouring points come one after the other
  for (const Delta& delta : deltas_) {
    const uint64_t key = pack(top, {delta.cube.x >> top, delta.cube.y >> top, delta.cube.z >> top});
    if (key != last) seen_.insert(key, 0);
    last = key;
  }
  return seen_.size();
}

void VoxelMap::prune(const double* centre, double radius, size_t max_voxels) {
  std::vector<double> distance2(planes_.size());
  for (size_t id = 0; id < planes_.size(); ++id) {
    const double size = edge(key_level(moments_[id].key));
    const Cube cube = unpack_near(moments_[id].key, cube_at(centre, size));
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
  std::vector<uint8_t> wanted(planes_.size());
  for (size_t id = 0; id < planes_.size(); ++id) wanted[id] = distance2[id] <= limit2 ? 1 : 0;
  keep(wanted);
  points_.prune(centre, std::sqrt(limit2));
}

void VoxelMap::forget_unseen(uint32_t insertions) {
  const uint32_t oldest = insertions_ >= insertions ? insertions_ - insertions + 1 : 0;
  keep(index_.seen_since(oldest));
  points_.forget_before(oldest);
}

void VoxelMap::keep(const std::vector<uint8_t>& wanted) {
  const auto kept = static_cast<size_t>(std::count(wanted.begin(), wanted.end(), 1));
  if (kept == wanted.size()) return;
  if (FlatIndex::few(wanted.size() - kept, wanted.size())) {
    drop(wanted);
    return;
  }
  index_.keep(wanted);
  size_t next = 0;
  for (size_t id = 0; id < wanted.size(); ++id) {
    if (wanted[id] == 0) continue;
    planes_[next] = planes_[id];
    moments_[next++] = moments_[id];
  }
  planes_.resize(next);
  moments_.resize(next);
}

// The last cube takes the place of each that goes: the work is that of what goes, not of what stays.
void VoxelMap::drop(const std::vector<uint8_t>& wanted) {
  for (size_t id = wanted.size(); id-- > 0;) {
    if (wanted[id] != 0) continue;
    index_.erase(moments_[id].key);
    if (id + 1 < moments_.size()) {
      planes_[id] = planes_.back();
      moments_[id] = moments_.back();
      index_.find(moments_[id].key)->value = static_cast<uint32_t>(id);
    }
    planes_.pop_back();
    moments_.pop_back();
  }
}

Cube VoxelMap::cube_of(uint64_t key) const {
  if (deltas_.empty()) return unpack(key);
  const uint64_t level = key_level(key);
  const Cube& near = deltas_.front().cube;
  return unpack_near(key, {near.x >> level, near.y >> level, near.z >> level});
}

size_t VoxelMap::bytes() const {
  return index_.bytes() + planes_.capacity() * sizeof(Plane) + moments_.capacity() * sizeof(Moments) + points_.bytes();
}

}  // namespace heliograph
