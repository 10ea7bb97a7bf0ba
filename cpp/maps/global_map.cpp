// SPDX-License-Identifier: MIT
#include "maps/global_map.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

namespace heliograph {

namespace {
// Enough look-ups in flight to hide the memory's latency: the table is larger than any cache.
constexpr size_t kBatch = 32;
}  // namespace

GlobalMap::GlobalMap(double voxel) : voxel_(voxel), index_(16) {
  if (!(voxel > 0.0)) throw std::invalid_argument("the map's voxel must be positive");
}

void GlobalMap::insert(std::span<const float> points_body, std::span<const float> intensity, const double* T) {
  reindex();
  const double inverse = 1.0 / voxel_;
  const size_t count = points_body.size() / 3;
  std::array<uint64_t, kBatch> keys;
  std::array<std::array<float, 3>, kBatch> local;
  std::array<uint32_t, kBatch> ids;
  for (size_t begin = 0; begin < count; begin += kBatch) {
    const size_t batch = std::min(kBatch, count - begin);
    for (size_t k = 0; k < batch; ++k) {
      const float* p = points_body.data() + 3 * (begin + k);
      double q[3];
      int64_t c[3];
      for (int i = 0; i < 3; ++i) {
        q[i] = T[4 * i] * p[0] + T[4 * i + 1] * p[1] + T[4 * i + 2] * p[2] + T[4 * i + 3];
        q[i] = std::isfinite(q[i]) ? q[i] : 0.0;
        c[i] = floor_index(q[i] * inverse);
        local[k][static_cast<size_t>(i)] = static_cast<float>(q[i] - (static_cast<double>(c[i]) + 0.5) * voxel_);
      }
      keys[k] = std::isfinite(p[0] + p[1] + p[2]) ? pack(0, {c[0], c[1], c[2]}) : kNoKey;
      index_.prefetch(keys[k]);
    }
    for (size_t k = 0; k < batch; ++k) {
      if (keys[k] == kNoKey) continue;
      const auto [id, is_new] = index_.insert(keys[k], static_cast<uint32_t>(cells_.size()));
      if (is_new) cells_.push_back({keys[k], {0, 0, 0}, 0.0F, 0.0F, 0.0F});
      __builtin_prefetch(cells_.data() + id, 1);
      ids[k] = id;
    }
    for (size_t k = 0; k < batch; ++k) {
      if (keys[k] == kNoKey) continue;
      MapCell& cell = cells_[ids[k]];
      for (size_t i = 0; i < 3; ++i) cell.sum[i] += local[k][i];
      if (!intensity.empty()) cell.intensity += intensity[begin + k];
      cell.count += 1.0F;
    }
  }
}

void GlobalMap::merge(const Cells& from, const double* T) {
  reindex();
  const size_t count = from.counts.size();
  std::array<uint64_t, kBatch> keys;
  std::array<std::array<float, 3>, kBatch> sums;
  std::array<uint32_t, kBatch> ids;
  for (size_t begin = 0; begin < count; begin += kBatch) {
    const size_t batch = std::min(kBatch, count - begin);
    for (size_t k = 0; k < batch; ++k) {
      const int32_t* cube = from.cubes.data() + 3 * (begin + k);
      const float* sum = from.sums.data() + 3 * (begin + k);
      Cube c{cube[0], cube[1], cube[2]};
      for (size_t i = 0; i < 3; ++i) sums[k][i] = sum[i];
      if (T != nullptr) c = moved(cube, sum, from.counts[begin + k], T, sums[k]);
      keys[k] = pack(0, c);
      index_.prefetch(keys[k]);
    }
    for (size_t k = 0; k < batch; ++k) {
      const auto [id, is_new] = index_.insert(keys[k], static_cast<uint32_t>(cells_.size()));
      if (is_new) cells_.push_back({keys[k], {0, 0, 0}, 0.0F, 0.0F, 0.0F});
      __builtin_prefetch(cells_.data() + id, 1);
      ids[k] = id;
    }
    for (size_t k = 0; k < batch; ++k) {
      MapCell& cell = cells_[ids[k]];
      for (size_t i = 0; i < 3; ++i) cell.sum[i] += sums[k][i];
      cell.intensity += from.intensity[begin + k];
      cell.count += from.counts[begin + k];
    }
  }
}

// The cube in which a cell's mean lies after T, and the cell's sum of offsets from that cube's centre.
Cube GlobalMap::moved(const int32_t* cube, const float* sum, float count, const double* T,
                      std::array<float, 3>& moved_sum) const {
  const double n = static_cast<double>(count);
  const double inverse = 1.0 / voxel_;
  double p[3];
  for (int i = 0; i < 3; ++i) p[i] = (static_cast<double>(cube[i]) + 0.5) * voxel_ + static_cast<double>(sum[i]) / n;
  int64_t c[3];
  for (int i = 0; i < 3; ++i) {
    const double q = T[4 * i] * p[0] + T[4 * i + 1] * p[1] + T[4 * i + 2] * p[2] + T[4 * i + 3];
    c[i] = floor_index(q * inverse);
    moved_sum[static_cast<size_t>(i)] = static_cast<float>(n * (q - (static_cast<double>(c[i]) + 0.5) * voxel_));
  }
  return {c[0], c[1], c[2]};
}

void GlobalMap::clear() {
  index_.clear();
  cells_.clear();
}

SurfacePoints GlobalMap::surfaces(double thickness, int threads) {
  index_ = FlatIndex(4);
  return surface_points(cells_, voxel_, thickness, threads);
}

// The index that `surfaces` has given back.
void GlobalMap::reindex() {
  if (index_.size() == cells_.size()) return;
  for (size_t id = 0; id < cells_.size(); ++id) index_.insert(cells_[id].key, static_cast<uint32_t>(id));
}

std::vector<float> GlobalMap::points() const {
  std::vector<float> out;
  out.reserve(3 * cells_.size());
  for (const MapCell& cell : cells_) {
    const Cube cube = unpack(cell.key);
    out.push_back(static_cast<float>((static_cast<double>(cube.x) + 0.5) * voxel_ + cell.sum[0] / cell.count));
    out.push_back(static_cast<float>((static_cast<double>(cube.y) + 0.5) * voxel_ + cell.sum[1] / cell.count));
    out.push_back(static_cast<float>((static_cast<double>(cube.z) + 0.5) * voxel_ + cell.sum[2] / cell.count));
  }
  return out;
}

std::vector<float> GlobalMap::intensity() const {
  std::vector<float> out;
  out.reserve(cells_.size());
  for (const MapCell& cell : cells_) out.push_back(cell.intensity / cell.count);
  return out;
}

std::vector<float> GlobalMap::counts() const {
  std::vector<float> out;
  out.reserve(cells_.size());
  for (const MapCell& cell : cells_) out.push_back(cell.count);
  return out;
}

std::vector<int32_t> GlobalMap::cubes() const {
  std::vector<int32_t> out;
  out.reserve(3 * cells_.size());
  for (const MapCell& cell : cells_) {
    const Cube cube = unpack(cell.key);
    for (const int64_t index : {cube.x, cube.y, cube.z}) out.push_back(static_cast<int32_t>(index));
  }
  return out;
}

std::vector<float> GlobalMap::sums() const {
  std::vector<float> out;
  out.reserve(3 * cells_.size());
  for (const MapCell& cell : cells_) out.insert(out.end(), cell.sum, cell.sum + 3);
  return out;
}

std::vector<float> GlobalMap::intensity_sums() const {
  std::vector<float> out;
  out.reserve(cells_.size());
  for (const MapCell& cell : cells_) out.push_back(cell.intensity);
  return out;
}

}  // namespace heliograph
