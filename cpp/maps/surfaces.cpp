// SPDX-License-Identifier: MIT
#include "maps/surfaces.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "util/parallel.hpp"
#include "util/voxel_key.hpp"

namespace heliograph {

namespace {

constexpr uint32_t kNone = ~uint32_t{0};
constexpr size_t kChunk = 8192;  // cells
constexpr size_t kAround = 28;  // 27 cubes, in fours

// In units of the thickness: how far from its plane a cell may lie. Noise as large as the thickness is split by a
// border into means at 0.8 of it; of what it throws beyond 2.5 some points come together in a cell, beyond 4 hardly one.
constexpr float kGate = 2.5F;
constexpr float kFarGate = 4.0F;
constexpr float kBeyond = 0.0062F;  // share of normal noise beyond kGate on one side

// In units of the voxel's edge.
constexpr float kRadius = 2.0F;     // where a neighbour's weight comes to nothing
constexpr double kMinSpread = 0.4;  // a plane's cells spread at least so wide in both its directions (RMS)
constexpr float kBeside = 0.6F;     // cells nearer than this along the plane are one point
constexpr float kAbove = 0.3F;      // and nearer than this across it
constexpr size_t kMinCells = 5;    // three are always in one plane, and four often
constexpr double kFlatness = 4.0;   // variance along a plane against that across it, at least
constexpr float kParallel = 0.8F;   // cosine between the normals of one surface

struct Vec {
  float x, y, z;
};

Vec operator+(const Vec& a, const Vec& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vec operator-(const Vec& a, const Vec& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vec operator*(float s, const Vec& a) { return {s * a.x, s * a.y, s * a.z}; }
float dot(const Vec& a, const Vec& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// A cell's mean, from the centre of its cube.
struct Site {
  Vec mean;
  float count;
};

// Fitted about one cell: the points m + d with normal . d = offset, m the cell's mean. `typical` is the mean count of
// its cells, negative where there is no plane.
struct Plane {
  Vec normal;
  float offset;
  float typical = -1.0F;
};

// Onto which plane a cell is moved, by how much along the normal.
struct Move {
  uint32_t plane = kNone;
  float height = 0.0F;
};

// The cells in the 27 cubes about one cell, itself among them, as columns of numbers; what lies beyond `size` up to the
// next multiple of four weighs nothing.
struct Around {
  size_t size = 0;
  alignas(16) std::array<float, kAround> x, y, z;  // their means, from this cell's mean
  alignas(16) std::array<float, kAround> weight;   // by count and distance
  alignas(16) std::array<float, kAround> count;
};

// Nine columns of three cubes each stand about a cube; in the order of keys, each advances together with it.
// `keys` ends in one that is greater than all others and stands for no cell.
class Columns {
 public:
  Columns(std::span<const uint64_t> keys, size_t start) : keys_(keys) {
    for (size_t c = 0; c < cursors_.size(); ++c)
      cursors_[c] = static_cast<size_t>(std::ranges::lower_bound(keys, lowest(keys[start], c)) - keys.begin());
  }

  // Calls see(j, step) for the cells about cell i, step being the way between their cubes in voxels. i must not
  // decrease from call to call.
  template <typename See>
  void visit(size_t i, See&& see) {
    for (size_t c = 0; c < cursors_.size(); ++c) {
      const uint64_t first = lowest(keys_[i], c);
      size_t j = cursors_[c];
      while (keys_[j] < first) ++j;
      cursors_[c] = j;
      for (; keys_[j] <= first + 2 && j + 1 < keys_.size(); ++j)
        see(static_cast<uint32_t>(j), Vec{static_cast<float>(c / 3) - 1.0F, static_cast<float>(c % 3) - 1.0F,
                                          static_cast<float>(keys_[j] - first) - 1.0F});
    }
  }

 private:
  // Key of the lowest cube of a column about the cube of `key`.
  static uint64_t lowest(uint64_t key, size_t column) {
    const uint64_t dx = column / 3, dy = column % 3, one = 1;
    return key + (dx << (2 * kKeyBits)) + (dy << kKeyBits) - (one << (2 * kKeyBits)) - (one << kKeyBits) - one;
  }

  std::span<const uint64_t> keys_;
  std::array<size_t, 9> cursors_;
};

struct Spread {
  double thin, middle;  // the smaller two eigenvalues
  Eigen::Vector3d normal;
};

// Newton from below meets the smallest root of the characteristic polynomial without overshooting, in three or four
// steps where it stands apart; where all three are close, a twentieth at most is left after eight, and it is no plane.
Spread thinnest(const Eigen::Matrix3d& a) {
  const double trace = a.trace();
  if (!(trace > 0.0)) return {0.0, 0.0, Eigen::Vector3d::UnitZ()};
  const Eigen::Matrix3d m = a / trace;
  const double minors = m(0, 0) * m(1, 1) - m(0, 1) * m(0, 1) + m(0, 0) * m(2, 2) - m(0, 2) * m(0, 2) +
                        m(1, 1) * m(2, 2) - m(1, 2) * m(1, 2);
  const double determinant = m.determinant();
  double root = 0.0;
  for (int k = 0; k < 8; ++k) {
    const double value = determinant - root * (minors - root * (1.0 - root));
    const double slope = minors - root * (2.0 - 3.0 * root);
    if (!(value > 1e-15) || !(slope > 0.0)) break;
    root += value / slope;
  }
  const double rest = 1.0 - root, product = minors - root * rest;
  const double middle = 0.5 * (rest - std::sqrt(std::max(rest * rest - 4.0 * product, 0.0)));
  const Eigen::Matrix3d off = m - root * Eigen::Matrix3d::Identity();
  const std::array<Eigen::Vector3d, 3> normals{off.col(0).cross(off.col(1)), off.col(0).cross(off.col(2)),
                                               off.col(1).cross(off.col(2))};
  const auto longest = std::max_element(normals.begin(), normals.end(), [](const auto& p, const auto& q) {
    return p.squaredNorm() < q.squaredNorm();
  });
  const double length = longest->norm();
  return {trace * root, trace * middle, length > 0.0 ? Eigen::Vector3d(*longest / length) : Eigen::Vector3d::UnitZ()};
}

class Surfaces {
 public:
  Surfaces(std::span<const MapCell> cells, const Cube& origin, double voxel, double thickness, int threads)
      : cells_(cells), origin_(origin), voxel_(voxel), edge_(static_cast<float>(voxel)), thickness_(thickness),
        gate_(kGate * static_cast<float>(thickness)), reach_(1.0F / (kRadius * edge_ * kRadius * edge_)),
        threads_(threads) {
    sort();
    planes_.resize(cells.size());
    each([this](uint32_t i, Columns& columns) { planes_[i] = fit(i, columns); });
    moves_.resize(cells.size());
    each([this](uint32_t i, Columns& columns) { moves_[i] = nearest_plane(i, columns); });
    target_.resize(cells.size());
    std::vector<float> bends(cells.size());
    each([&](uint32_t i, Columns& columns) { std::tie(target_[i], bends[i]) = merged(i, columns); });
    for (uint32_t i = 0; i < bends.size(); ++i) {
      moves_[i].height -= bends[i];
      sites_[i].mean = sites_[i].mean + shift(i);
    }
    planes_ = {};
    moves_ = {};
  }

  SurfacePoints points() {
    find_roots();
    const size_t count = number_roots();
    return averaged(count);
  }

 private:
  // By key, so that the cubes about a cube are nine runs that advance together with it.
  void sort() {
    std::vector<std::pair<uint64_t, uint32_t>> sorted(cells_.size());
    for (size_t id = 0; id < cells_.size(); ++id) sorted[id] = {cells_[id].key, static_cast<uint32_t>(id)};
    std::sort(sorted.begin(), sorted.end());
    keys_.assign(cells_.size() + 1, kNoKey);  // the last for `Columns`
    order_.resize(cells_.size());
    sites_.resize(cells_.size());
    for (size_t i = 0; i < sorted.size(); ++i) {
      const MapCell& cell = cells_[sorted[i].second];
      keys_[i] = cell.key;
      order_[i] = sorted[i].second;
      sites_[i] = {{cell.sum[0] / cell.count, cell.sum[1] / cell.count, cell.sum[2] / cell.count}, cell.count};
    }
  }

  // Calls see(i, columns) for all cells. Each call writes what belongs to its own cell only.
  template <typename See>
  void each(See&& see) const {
    parallel_chunks((cells_.size() + kChunk - 1) / kChunk, threads_, [&](size_t chunk) {
      const size_t begin = chunk * kChunk, end = std::min(cells_.size(), begin + kChunk);
      Columns columns(keys_, begin);
      for (size_t i = begin; i < end; ++i) see(static_cast<uint32_t>(i), columns);
    });
  }

  // Cell j's mean from cell i's, by the way between their cubes.
  Vec between(uint32_t i, uint32_t j, const Vec& step) const { return sites_[j].mean - sites_[i].mean + edge_ * step; }

  float weight(uint32_t j, const Vec& d) const {
    const float near = std::max(1.0F - dot(d, d) * reach_, 0.0F);
    return sites_[j].count * near * near;
  }

  // The plane about one cell; once more without the cells that lie off it, where there are any.
  Plane fit(uint32_t i, Columns& columns) const {
    Around around;
    columns.visit(i, [&](uint32_t j, const Vec& step) {
      const Vec d = between(i, j, step);
      const size_t k = around.size++;
      around.x[k] = d.x, around.y[k] = d.y, around.z[k] = d.z;
      around.weight[k] = weight(j, d), around.count[k] = sites_[j].count;
    });
    if (around.size < kMinCells) return {};
    for (size_t k = around.size; k % 4 != 0; ++k)
      around.x[k] = around.y[k] = around.z[k] = around.weight[k] = around.count[k] = 0.0F;
    const Plane rough = fit(around);
    size_t left = around.size;
    for (size_t k = 0; k < around.size; ++k) {
      const float residual = dot(rough.normal, {around.x[k], around.y[k], around.z[k]}) - rough.offset;
      if (std::abs(residual) <= gate_) continue;
      around.weight[k] = 0.0F;
      --left;
    }
    if (left < kMinCells) return {};
    return left < around.size ? fit(around) : rough;
  }

  Plane fit(const Around& around) const {
    using Four = Eigen::Array4f;
    using Load = Eigen::Map<const Four, Eigen::Aligned16>;
    std::array<Four, 11> sums;
    sums.fill(Four::Zero());
    for (size_t k = 0; k < around.size; k += 4) {
      const Four x = Load(&around.x[k]), y = Load(&around.y[k]), z = Load(&around.z[k]), w = Load(&around.weight[k]);
      const Four wx = w * x, wy = w * y, wz = w * z;
      sums[0] += w, sums[1] += w * Load(&around.count[k]);
      sums[2] += wx, sums[3] += wy, sums[4] += wz;
      sums[5] += wx * x, sums[6] += wx * y, sums[7] += wx * z, sums[8] += wy * y, sums[9] += wy * z, sums[10] += wz * z;
    }
    std::array<double, 11> s;
    for (size_t k = 0; k < s.size(); ++k)
      s[k] = (static_cast<double>(sums[k][0]) + sums[k][1]) + (static_cast<double>(sums[k][2]) + sums[k][3]);
    Plane plane{};
    if (!(s[0] > 0.0)) return plane;
    const Eigen::Vector3d mean(s[2] / s[0], s[3] / s[0], s[4] / s[0]);
    Eigen::Matrix3d covariance;
    covariance << s[5], s[6], s[7], s[6], s[8], s[9], s[7], s[9], s[10];
    covariance = covariance / s[0] - mean * mean.transpose();
    const auto [thin, wide, normal] = thinnest(covariance);
    plane.normal = {static_cast<float>(normal[0]), static_cast<float>(normal[1]), static_cast<float>(normal[2])};
    plane.offset = static_cast<float>(normal.dot(mean));
    const double least = kMinSpread * voxel_;
    const bool good = thin <= thickness_ * thickness_ && wide >= least * least && wide >= kFlatness * thin;
    plane.typical = good ? static_cast<float>(s[1] / s[0]) : -1.0F;
    return plane;
  }

  // Whether a cell of `count` points may lie `residual` off the plane: up to the gate, or farther where they are no
  // more than noise throws there (Poisson, four sigmas).
  bool belongs(float residual, float count, const Plane& plane) const {
    if (plane.typical < 0.0F || std::abs(residual) > kFarGate / kGate * gate_) return false;
    const float expected = kBeyond * plane.typical;
    return std::abs(residual) <= gate_ || count <= expected + 4.0F * std::sqrt(expected);
  }

  // Its own plane, or, as on edges, the nearest of its neighbours' planes.
  Move nearest_plane(uint32_t i, Columns& columns) const {
    const float count = sites_[i].count;
    if (belongs(planes_[i].offset, count, planes_[i])) return {i, planes_[i].offset};
    Move best;
    columns.visit(i, [&](uint32_t j, const Vec& step) {
      const Plane& plane = planes_[j];
      if (plane.typical < 0.0F) return;
      const float height = dot(plane.normal, between(i, j, step)) + plane.offset;
      if (belongs(height, count, plane) && (best.plane == kNone || std::abs(height) < std::abs(best.height)))
        best = {j, height};
    });
    return best;
  }

  Vec shift(uint32_t i) const {
    const Move& move = moves_[i];
    return move.plane == kNone ? Vec{0.0F, 0.0F, 0.0F} : move.height * planes_[move.plane].normal;
  }

  // The heaviest of the heavier cells that lie, once moved, where cell i does; itself where there is none. And what the
  // moves of the cells about it have in common along its normal: planes flatten what is round, all to one side, which
  // is to be taken back. The two sides of a border move against each other and have nothing in common.
  // J. W. Tukey, Exploratory Data Analysis (1977), chapter 16: twicing.
  std::pair<uint32_t, float> merged(uint32_t i, Columns& columns) const {
    const Move& own = moves_[i];
    if (own.plane == kNone) return {i, 0.0F};
    const Vec normal = planes_[own.plane].normal, moved = shift(i);
    const float beside = kBeside * edge_, above = kAbove * edge_;
    uint32_t best = i;
    float sum = 0.0F, all = 0.0F;
    columns.visit(i, [&](uint32_t j, const Vec& step) {
      const Move& move = moves_[j];
      if (move.plane == kNone) return;
      const Vec& other = planes_[move.plane].normal;
      const float cosine = dot(normal, other);
      if (std::abs(cosine) < kParallel) return;
      const Vec d = between(i, j, step);
      if (std::abs(dot(normal, d) - own.height) <= gate_) {
        const float w = weight(j, d);
        sum += w * move.height * cosine;
        all += w;
      }
      const float count = sites_[j].count, least = sites_[best].count;
      if (!(count > least || (best == i && count == least && j < i))) return;
      const Vec way = d + move.height * other - moved;
      const float across = dot(way, normal);
      if (std::abs(across) <= above && dot(way, way) - across * across <= beside * beside) best = j;
    });
    return {best, all > 0.0F ? sum / all : 0.0F};
  }

  // Where cell j's mean, now moved, lies from the centre of cell i's cube.
  Vec place(uint32_t j, uint32_t i) const {
    const Cube a = unpack(keys_[i]), b = unpack(keys_[j]);
    const Vec step{static_cast<float>(b.x - a.x), static_cast<float>(b.y - a.y), static_cast<float>(b.z - a.z)};
    return sites_[j].mean + edge_ * step;
  }

  // Follows each cell's heavier ones to the heaviest, unless that lies too far off to be one point with it.
  void find_roots() {
    std::vector<uint32_t> root(target_.size());
    for (uint32_t i = 0; i < root.size(); ++i) {
      uint32_t j = i;
      while (target_[j] != j) j = target_[j];
      const Vec d = place(i, j) - place(j, j);
      root[i] = dot(d, d) <= edge_ * edge_ ? j : i;
    }
    target_ = std::move(root);
  }

  // Numbers the points by the first sight of their cells; returns how many there are.
  size_t number_roots() {
    number_.assign(cells_.size(), kNone);
    for (size_t i = 0; i < target_.size(); ++i)
      if (target_[i] == i) number_[order_[i]] = 0;
    uint32_t count = 0;
    for (uint32_t& number : number_)
      if (number != kNone) number = count++;
    return count;
  }

  SurfacePoints averaged(size_t count) const {
    SurfacePoints out{std::vector<double>(3 * count), std::vector<float>(count), std::vector<float>(count),
                      std::vector<uint32_t>(count, kNone)};
    std::vector<Vec> moved(count, Vec{0.0F, 0.0F, 0.0F});
    for (uint32_t i = 0; i < target_.size(); ++i) {  // from the root's own place: what stays alone stays as it is
      const uint32_t root = target_[i];
      const size_t number = number_[order_[root]];
      const Vec d = place(i, root) - place(root, root);
      const float n = sites_[i].count;
      moved[number] = moved[number] + n * d;
      out.first[number] = std::min(out.first[number], cells_[order_[i]].first());
      out.intensity[number] += cells_[order_[i]].intensity;
      out.counts[number] += n;
    }
    for (uint32_t i = 0; i < target_.size(); ++i) {
      if (target_[i] != i) continue;
      const size_t number = number_[order_[i]];
      const Cube cube = unpack(keys_[i]);
      const Vec own = place(i, i);
      const float n = out.counts[number];
      out.points[3 * number] = (static_cast<double>(origin_.x + cube.x) + 0.5) * voxel_ + own.x + moved[number].x / n;
      out.points[3 * number + 1] = (static_cast<double>(origin_.y + cube.y) + 0.5) * voxel_ + own.y + moved[number].y / n;
      out.points[3 * number + 2] = (static_cast<double>(origin_.z + cube.z) + 0.5) * voxel_ + own.z + moved[number].z / n;
      out.intensity[number] /= out.counts[number];
    }
    return out;
  }

  std::span<const MapCell> cells_;
  Cube origin_;
  double voxel_;
  float edge_;
  double thickness_;
  float gate_;   // kGate in metres
  float reach_;  // one over the square of kRadius in metres
  int threads_;
  // All by the order of keys:
  std::vector<uint64_t> keys_;
  std::vector<uint32_t> order_;  // index in cells_
  std::vector<Site> sites_;
  std::vector<Plane> planes_;
  std::vector<Move> moves_;
  std::vector<uint32_t> target_;
  // By the order of cells_: the point of a cell that stays.
  std::vector<uint32_t> number_;
};

}  // namespace

SurfacePoints surface_points(std::span<const MapCell> cells, const Cube& origin, double voxel, double thickness,
                             int threads) {
  return Surfaces(cells, origin, voxel, thickness, threads).points();
}

}  // namespace heliograph
