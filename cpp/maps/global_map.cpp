// SPDX-License-Identifier: MIT
#include "maps/global_map.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

namespace heliograph {

namespace {
// Enough look-ups in flight to hide the memory's latency: the table is larger than any cache.
constexpr size_t kBatch = 32;
// A cube with so many points is left as it is: its mean is known to a hundredth of the noise, and a sum of floats that
// goes on growing rounds what is added to it, all one way, until the mean drifts.
constexpr float kEnough = 16384.0F;
// Cubes from the first one to either side, a few short of where keys begin anew: those about a cube have keys too.
constexpr int64_t kReach = kKeyOffset - 4;
constexpr size_t kMinPlane = 5;       // cells of a plane
constexpr double kThin = 0.25;        // its scatter, in edges, at most
constexpr double kFlat = 4.0;         // variance along it against that across it, at least
}  // namespace

GlobalMap::GlobalMap(double voxel) : voxel_(voxel), index_(10) {
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
      keys[k] = std::isfinite(p[0] + p[1] + p[2]) ? key_of({c[0], c[1], c[2]}) : kNoKey;
      index_.prefetch(keys[k]);
    }
    for (size_t k = 0; k < batch; ++k) {
      if (keys[k] == kNoKey) continue;
      ids[k] = place(keys[k], 0);
      __builtin_prefetch(cells_.data() + ids[k], 1);
    }
    for (size_t k = 0; k < batch; ++k) {
      if (keys[k] == kNoKey) continue;
      MapCell& cell = cells_[ids[k]];
      if (cell.count >= kEnough) continue;
      for (size_t i = 0; i < 3; ++i) cell.sum[i] += local[k][i];
      if (!intensity.empty()) cell.intensity += intensity[begin + k];
      cell.count += 1.0F;
    }
  }
}

void GlobalMap::merge(const Cells& from, const double* T, uint32_t visit) {
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
      keys[k] = key_of(c);
      index_.prefetch(keys[k]);
    }
    for (size_t k = 0; k < batch; ++k) {
      ids[k] = place(keys[k], visit);
      __builtin_prefetch(cells_.data() + ids[k], 1);
    }
    for (size_t k = 0; k < batch; ++k) {
      MapCell& cell = cells_[ids[k]];
      if (cell.visits() < kMaxVisits) ++cell.visit;
      if (cell.count >= kEnough) continue;
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

// The key of a cube, which counts from the first one; throws where it is too far off to have one.
uint64_t GlobalMap::key_of(const Cube& cube) {
  if (!placed_) origin_ = cube;
  placed_ = true;
  const Cube from{cube.x - origin_.x, cube.y - origin_.y, cube.z - origin_.z};
  if (std::max({std::abs(from.x), std::abs(from.y), std::abs(from.z)}) > kReach)
    throw std::invalid_argument("a map in memory ends 524284 cubes from its first point; put it together in tiles");
  return pack(0, from);
}

Cube GlobalMap::cube_of(const MapCell& cell) const {
  const Cube from = unpack(cell.key);
  return {origin_.x + from.x, origin_.y + from.y, origin_.z + from.z};
}

// The cell of a key, a new one where there is none yet.
uint32_t GlobalMap::place(uint64_t key, uint32_t visit) {
  const auto [id, is_new] = index_.insert(key, static_cast<uint32_t>(cells_.size()));
  if (is_new) cells_.push_back({key, {0, 0, 0}, 0.0F, 0.0F, visit << 8});
  return id;
}

void GlobalMap::clear() {
  index_.clear();
  cells_.clear();
  placed_ = false;
}

void GlobalMap::keep(std::span<const uint8_t> wanted) {
  if (wanted.size() != cells_.size()) throw std::invalid_argument("wanted needs one value a cell");
  reindex();
  index_.keep({wanted.begin(), wanted.end()});
  size_t next = 0;
  for (size_t id = 0; id < wanted.size(); ++id)
    if (wanted[id] != 0) cells_[next++] = cells_[id];
  cells_.resize(next);
}

SurfacePoints GlobalMap::surfaces(double thickness, int threads) {
  index_ = FlatIndex(4);
  return surface_points(cells_, origin_, voxel_, thickness, threads);
}

// The index that `surfaces` has given back.
void GlobalMap::reindex() {
  if (index_.size() == cells_.size()) return;
  for (size_t id = 0; id < cells_.size(); ++id) index_.insert(cells_[id].key, static_cast<uint32_t>(id));
}

// Calls see(id, step) for the cells in the 27 cubes about one, itself among them; step is the way between the cubes.
template <typename See>
void GlobalMap::about(const MapCell& cell, See&& see) const {
  const Cube at = unpack(cell.key);
  for (int64_t x = -1; x <= 1; ++x)
    for (int64_t y = -1; y <= 1; ++y)
      for (int64_t z = -1; z <= 1; ++z)
        if (const auto* slot = index_.find(pack(0, {at.x + x, at.y + y, at.z + z}))) see(slot->value, Cube{x, y, z});
}

std::vector<float> GlobalMap::normals(std::span<const uint32_t> cells) {
  reindex();
  std::vector<float> out(3 * cells.size());
  for (size_t k = 0; k < cells.size(); ++k) {
    size_t count = 0;
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    Eigen::Matrix3d outer = Eigen::Matrix3d::Zero();
    about(cells_.at(cells[k]), [&](uint32_t id, const Cube& step) {
      const MapCell& cell = cells_[id];
      const Eigen::Vector3d p(static_cast<double>(step.x) + static_cast<double>(cell.sum[0] / cell.count) / voxel_,
                              static_cast<double>(step.y) + static_cast<double>(cell.sum[1] / cell.count) / voxel_,
                              static_cast<double>(step.z) + static_cast<double>(cell.sum[2] / cell.count) / voxel_);
      sum += p;
      outer += p * p.transpose();
      ++count;
    });
    if (count < kMinPlane) continue;
    const double n = static_cast<double>(count);
    Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver;
    solver.computeDirect(outer / n - (sum / n) * (sum / n).transpose());
    const Eigen::Vector3d& spread = solver.eigenvalues();
    if (spread[0] > kThin * kThin || spread[1] < kFlat * spread[0]) continue;
    for (int i = 0; i < 3; ++i) out[3 * k + static_cast<size_t>(i)] = static_cast<float>(solver.eigenvectors()(i, 0));
  }
  return out;
}

std::vector<uint32_t> GlobalMap::marked_around(std::span<const uint32_t> cells, std::span<const uint8_t> marked) {
  if (marked.size() != cells_.size()) throw std::invalid_argument("marked needs one value a cell");
  reindex();
  std::vector<uint32_t> out(2 * cells.size());
  for (size_t k = 0; k < cells.size(); ++k)
    about(cells_.at(cells[k]), [&](uint32_t id, const Cube& step) {
      if (step.x == 0 && step.y == 0 && step.z == 0) return;
      out[2 * k] += marked[id] != 0 ? 1 : 0;
      ++out[2 * k + 1];
    });
  return out;
}

std::vector<double> GlobalMap::points() const {
  std::vector<double> out;
  out.reserve(3 * cells_.size());
  for (const MapCell& cell : cells_) {
    const Cube cube = cube_of(cell);
    out.push_back((static_cast<double>(cube.x) + 0.5) * voxel_ + cell.sum[0] / cell.count);
    out.push_back((static_cast<double>(cube.y) + 0.5) * voxel_ + cell.sum[1] / cell.count);
    out.push_back((static_cast<double>(cube.z) + 0.5) * voxel_ + cell.sum[2] / cell.count);
  }
  return out;
}

std::vector<uint32_t> GlobalMap::visits() const {
  std::vector<uint32_t> out;
  out.reserve(cells_.size());
  for (const MapCell& cell : cells_) out.push_back(cell.visits());
  return out;
}

std::vector<uint32_t> GlobalMap::first() const {
  std::vector<uint32_t> out;
  out.reserve(cells_.size());
  for (const MapCell& cell : cells_) out.push_back(cell.first());
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
    const Cube cube = cube_of(cell);
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
