// SPDX-License-Identifier: MIT
#include "maps/feature_map.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "util/moments.hpp"
#include "util/voxel_key.hpp"

namespace heliograph {

namespace {

constexpr size_t kMaxNeighbours = 16;
constexpr size_t kLeastOnLine = 3, kLeastOnPlane = 5;  // means without which a fit says nothing
constexpr int kCoarse = 2;            // halvings of the coarse cubes: four times the edge
constexpr double kLine = 9.0, kFlat = 9.0;  // least ratio of the spreads along and across
constexpr double kMostWeight = 10.0;  // points of a cube that count in a fit: a mean of more is hardly better placed
// Of the cubes against the frame, in edges: what people build lies on round numbers, and a wall on a border between cubes
// would be split into two sheets of half its noise apart.
constexpr double kShift = 0.381966, kMiddle = 0.5 - kShift;
constexpr double kFarthest = 1e5;     // [m]

struct Near {
  double square;
  uint32_t id;
};

int steps_of(const FeatureMapSettings& s) { return std::clamp(static_cast<int>(std::ceil(s.reach / s.voxel - 1e-9)), 1, 3); }

}  // namespace

FeatureMap::FeatureMap(const FeatureMapSettings& settings) : settings_(settings) {
  if (!(settings.voxel > 0.0) || settings.neighbours < 5 || static_cast<size_t>(settings.neighbours) > kMaxNeighbours || settings.max_points < 1)
    throw std::invalid_argument("a feature map needs a positive voxel, 5 to 16 neighbours and at least one point a cube");
  const int r = steps_of(settings);
  for (int x = -r; x <= r; ++x)
    for (int y = -r; y <= r; ++y)
      for (int z = -r; z <= r; ++z) steps_.push_back({static_cast<int8_t>(x), static_cast<int8_t>(y), static_cast<int8_t>(z)});
  std::stable_sort(steps_.begin(), steps_.end(), [](const Step& a, const Step& b) {
    return a.x * a.x + a.y * a.y + a.z * a.z < b.x * b.x + b.y * b.y + b.z * b.z;
  });
}

double FeatureMap::insert(std::span<const float> points_body, const double* T) {
  ++insertions_;
  size_t touched = 0, fresh = 0;
  const double inverse = 1.0 / settings_.voxel;
  for (size_t k = 0; k + 2 < points_body.size(); k += 3) {
    const double x = points_body[k], y = points_body[k + 1], z = points_body[k + 2];
    double q[3];
    for (int i = 0; i < 3; ++i) q[i] = T[4 * i] * x + T[4 * i + 1] * y + T[4 * i + 2] * z + T[4 * i + 3];
    if (!(std::abs(q[0]) < kFarthest && std::abs(q[1]) < kFarthest && std::abs(q[2]) < kFarthest)) continue;
    const Cube cube{floor_index(q[0] * inverse + kShift), floor_index(q[1] * inverse + kShift), floor_index(q[2] * inverse + kShift)};
    last_ = cube;
    const uint64_t around = pack(0, {cube.x >> kCoarse, cube.y >> kCoarse, cube.z >> kCoarse});
    const auto [there, is_new_place] = coarse_.insert(around, static_cast<uint32_t>(coarse_cells_.size()));
    if (is_new_place) coarse_cells_.push_back({around, 0});
    if (coarse_cells_[there].touched != insertions_) {
      coarse_cells_[there].touched = insertions_;
      ++touched;
      fresh += is_new_place;
    }
    const uint64_t key = pack(0, cube);
    const auto [id, is_new] = index_.insert(key, static_cast<uint32_t>(cells_.size()));
    if (is_new) cells_.push_back({key, {0.0F, 0.0F, 0.0F}, 0.0F});
    Cell& cell = cells_[id];
    if (cell.count >= static_cast<float>(settings_.max_points)) continue;
    cell.count += 1.0F;
    const double centre[3] = {static_cast<double>(cube.x) + kMiddle, static_cast<double>(cube.y) + kMiddle, static_cast<double>(cube.z) + kMiddle};
    for (int i = 0; i < 3; ++i)
      cell.mean[i] += (static_cast<float>(q[i] - centre[i] * settings_.voxel) - cell.mean[i]) / cell.count;
  }
  return touched > 0 ? static_cast<double>(fresh) / static_cast<double>(touched) : 0.0;
}

void FeatureMap::place(const Cell& cell, const Cube& near, double* out) const {
  const Cube cube = unpack_near(cell.key, near);
  const double centre[3] = {static_cast<double>(cube.x) + kMiddle, static_cast<double>(cube.y) + kMiddle, static_cast<double>(cube.z) + kMiddle};
  for (int i = 0; i < 3; ++i) out[i] = centre[i] * settings_.voxel + static_cast<double>(cell.mean[i]);
}

void FeatureMap::prune(const double* centre, double radius, size_t max_cells) {
  std::vector<std::pair<double, uint32_t>> kept;
  const Cube near = cube_at(centre, settings_.voxel);
  for (uint32_t id = 0; id < cells_.size(); ++id) {
    double p[3], square = 0.0;
    place(cells_[id], near, p);
    for (int i = 0; i < 3; ++i) square += (p[i] - centre[i]) * (p[i] - centre[i]);
    if (square <= radius * radius) kept.emplace_back(square, id);
  }
  if (kept.size() > max_cells) {
    std::nth_element(kept.begin(), kept.begin() + static_cast<std::ptrdiff_t>(max_cells), kept.end());
    kept.resize(max_cells);
  }
  if (kept.size() == cells_.size()) return;
  std::sort(kept.begin(), kept.end(), [](const auto& a, const auto& b) { return a.second < b.second; });
  const std::vector<Cell> old = std::move(cells_);
  const std::vector<Coarse> old_coarse = std::move(coarse_cells_);
  clear();
  for (const auto& [square, id] : kept) {
    const Cell& cell = old[id];
    index_.insert(cell.key, static_cast<uint32_t>(cells_.size()));
    cells_.push_back(cell);
    const Cube cube = unpack_near(cell.key, near);
    const uint64_t around = pack(0, {cube.x >> kCoarse, cube.y >> kCoarse, cube.z >> kCoarse});
    if (coarse_.insert(around, static_cast<uint32_t>(coarse_cells_.size())).second) coarse_cells_.push_back({around, 0});
  }
}

void FeatureMap::clear() {
  index_ = FlatIndex();
  coarse_ = FlatIndex();
  cells_ = {};
  coarse_cells_ = {};
}

FeatureMatch FeatureMap::match(const double* q, double sigma) const {
  FeatureMatch out{};
  if (!(std::abs(q[0]) < kFarthest && std::abs(q[1]) < kFarthest && std::abs(q[2]) < kFarthest)) return out;
  const double edge = settings_.voxel, inverse = 1.0 / edge;
  const Cube home{floor_index(q[0] * inverse + kShift), floor_index(q[1] * inverse + kShift), floor_index(q[2] * inverse + kShift)};
  const auto wanted = static_cast<size_t>(settings_.neighbours);
  std::array<Near, kMaxNeighbours> near;
  size_t some = 0;
  double farthest = settings_.reach * settings_.reach;
  for (const Step& step : steps_) {
    const Cube cube{home.x + step.x, home.y + step.y, home.z + step.z};
    // No mean of that cube can be nearer than its nearest side.
    double least = 0.0;
    const int64_t at[3] = {cube.x, cube.y, cube.z};
    for (int i = 0; i < 3; ++i) {
      const double low = (static_cast<double>(at[i]) - kShift) * edge - q[i], high = -(low + edge);
      const double d = std::max({low, high, 0.0});
      least += d * d;
    }
    if (least > farthest) continue;
    const FlatIndex::Slot* slot = index_.find(pack(0, cube));
    if (slot == nullptr) continue;
    double p[3], square = 0.0;
    place(cells_[slot->value], home, p);
    for (int i = 0; i < 3; ++i) square += (p[i] - q[i]) * (p[i] - q[i]);
    if (square > farthest) continue;
    size_t k = some < wanted ? some++ : wanted - 1;
    for (; k > 0 && square < near[k - 1].square; --k) near[k] = near[k - 1];
    near[k] = {square, slot->value};
    if (some == wanted) farthest = near[wanted - 1].square;
  }
  const bool line = settings_.kind == FeatureKind::edge;
  if (some < (line ? kLeastOnLine : kLeastOnPlane)) return out;
  double weight = 0.0, mean[3] = {0.0, 0.0, 0.0};
  std::array<double, kMaxNeighbours> w;
  std::array<std::array<double, 3>, kMaxNeighbours> at;
  for (size_t k = 0; k < some; ++k) {
    const Cell& cell = cells_[near[k].id];
    double p[3];
    place(cell, home, p);
    w[k] = std::min(static_cast<double>(cell.count), kMostWeight);
    weight += w[k];
    for (size_t i = 0; i < 3; ++i) {
      at[k][i] = p[i] - q[i];
      mean[i] += w[k] * at[k][i];
    }
  }
  double c[6] = {0, 0, 0, 0, 0, 0}, values[3], axes[9] = {};
  for (double& m : mean) m /= weight;
  for (size_t k = 0; k < some; ++k) {
    const double d[3] = {at[k][0] - mean[0], at[k][1] - mean[1], at[k][2] - mean[2]};
    size_t e = 0;
    for (size_t i = 0; i < 3; ++i)
      for (size_t j = i; j < 3; ++j) c[e++] += w[k] * d[i] * d[j] / weight;
  }
  symmetric_axes(c, values, axes);
  const double across = line ? values[1] : values[0], along = line ? values[2] : values[1];
  if (across > settings_.max_thickness * settings_.max_thickness || along < settings_.min_spread * settings_.min_spread) return out;
  if (along < (line ? kLine : kFlat) * across) return out;
  // Few means scatter too little about what was fitted to them by chance: their own noise is the least that counts.
  const double free = std::max(static_cast<double>(some) - (line ? 2.0 : 3.0), 1.0);
  const double scatter = std::max(across * static_cast<double>(some) / free, sigma * sigma * static_cast<double>(some) / weight);
  out.variance = scatter / static_cast<double>(some);
  out.tilt = out.variance / along;
  const double* axis = line ? axes + 6 : axes;
  double dot = 0.0, square = 0.0;
  for (int i = 0; i < 3; ++i) {
    out.axis[i] = axis[i];
    out.point[i] = q[i] + mean[i];
    dot += axis[i] * mean[i];
    square += mean[i] * mean[i];
  }
  // How far along the line, or aside on the plane, the query lies from the middle of what was fitted.
  const double aside = line ? dot * dot : square - dot * dot;
  out.variance += out.tilt * aside;
  out.found = true;
  return out;
}

std::vector<double> FeatureMap::cells() const {
  std::vector<double> out(4 * cells_.size());
  for (size_t id = 0; id < cells_.size(); ++id) {
    place(cells_[id], last_, out.data() + 4 * id);
    out[4 * id + 3] = static_cast<double>(cells_[id].count);
  }
  return out;
}

}  // namespace heliograph
