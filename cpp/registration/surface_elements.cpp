// SPDX-License-Identifier: MIT
#include "registration/surface_elements.hpp"

#include <algorithm>
#include <cmath>

#include "util/moments.hpp"
#include "util/parallel.hpp"
#include "util/voxel_key.hpp"

namespace heliograph {

namespace {

constexpr double kMinSpread = 0.15;  // of a cube's edge: smallest standard deviation along a plane in it
constexpr double kFlatness = 9.0;    // smallest ratio of the variances along and across a surface
constexpr double kWidth = 0.01;      // smallest ratio of the variances along a plane: less is a line
constexpr size_t kChunk = 256;

struct Cell {
  Cube cube;
  PointMoments moments;  // about the cube's centre
};

struct Surface {
  double values[3], axes[9], centre[3];
  double count;
  Shape shape;
};

using Cells = std::vector<Cell>;

double middle(int64_t cube, double edge) { return (static_cast<double>(cube) + 0.5) * edge; }

using Four = float __attribute__((vector_size(16)));
using FourInts = int32_t __attribute__((vector_size(16)));

// The moments of a finest cube in one cache line. About its centre no coordinate exceeds half an edge, so single precision
// loses less than the points' own rounding.
struct FineCell {
  Four first{};   // count, x, y, z
  Four second{};  // xx xy xz yy
  Four third{};   // yz zz, unused
  FourInts cube;

  void add(Four d) {
    first += __builtin_shufflevector(d, Four{1.0F, 0.0F, 0.0F, 0.0F}, 4, 0, 1, 2);
    second += __builtin_shufflevector(d, d, 0, 0, 0, 1) * __builtin_shufflevector(d, d, 0, 1, 2, 1);
    third += __builtin_shufflevector(d, d, 1, 2, 3, 3) * __builtin_shufflevector(d, d, 2, 2, 3, 3);
  }

  Cell widened() const {
    Cell out{{cube[0], cube[1], cube[2]}, {}};
    out.moments.count = static_cast<double>(first[0]);
    for (int i = 0; i < 3; ++i) out.moments.sum[i] = static_cast<double>(first[i + 1]);
    for (int i = 0; i < 6; ++i) out.moments.outer[i] = static_cast<double>(i < 4 ? second[i] : third[i - 4]);
    return out;
  }
};

// One pass over the points. Neighbours in memory are mostly neighbours in space, so the last cube is asked first.
Cells finest_cells(std::span<const float> points, double edge, FlatIndex* index, size_t* finite) {
  std::vector<FineCell> fine;
  fine.reserve(points.size() / 24);
  const auto inverse = static_cast<float>(1.0 / edge), width = static_cast<float>(edge);
  uint64_t last_key = kNoKey;
  uint32_t last = 0;
  for (size_t k = 0; k < points.size(); k += 3) {
    const Four p{points[k], points[k + 1], points[k + 2], 0.0F};
    if (!std::isfinite(p[0] + p[1] + p[2])) continue;
    ++*finite;
    const Four scaled = p * inverse;
    FourInts cube = __builtin_convertvector(scaled, FourInts);
    cube += __builtin_convertvector(cube, Four) > scaled;  // a true comparison is -1: the floor
    const uint64_t key = pack(0, {cube[0], cube[1], cube[2]});
    if (key != last_key) {
      const auto [at, is_new] = index->insert(key, static_cast<uint32_t>(fine.size()));
      if (is_new) fine.push_back({.cube = cube});
      last = at;
      last_key = key;
    }
    fine[last].add(p - (__builtin_convertvector(cube, Four) + 0.5F) * width);
  }
  Cells cells;
  cells.reserve(fine.size());
  for (const FineCell& cell : fine) cells.push_back(cell.widened());
  return cells;
}

// The cells twice as wide, and for each finer one which holds it.
Cells parents(const Cells& fine, double edge, FlatIndex* index, std::vector<uint32_t>* parent) {
  Cells cells;
  cells.reserve(fine.size() / 3 + 1);
  parent->resize(fine.size());
  for (size_t i = 0; i < fine.size(); ++i) {
    const Cube& child = fine[i].cube;
    const Cube cube{child.x >> 1, child.y >> 1, child.z >> 1};
    const auto [at, is_new] = index->insert(pack(0, cube), static_cast<uint32_t>(cells.size()));
    if (is_new) cells.push_back({cube, {}});
    (*parent)[i] = at;
    cells[at].moments.add(fine[i].moments, middle(child.x, edge) - middle(cube.x, 2.0 * edge),
                          middle(child.y, edge) - middle(cube.y, 2.0 * edge),
                          middle(child.z, edge) - middle(cube.z, 2.0 * edge));
  }
  return cells;
}

Surface surface_of(const PointMoments& m, const double* origin, double edge, const ElementSettings& s) {
  Surface out{{0, 0, 0}, {0, 0, 1, 0, 1, 0, 1, 0, 0}, {0, 0, 0}, m.count, Shape::scatter};
  for (int i = 0; i < 3; ++i) out.centre[i] = origin[i] + m.sum[i] / m.count;
  // Too few for a surface: their axes are looked at only where no wider cube has one either.
  if (m.count < static_cast<double>(s.min_support)) return out;
  double c[6];
  m.covariance(c);
  symmetric_axes(c, out.values, out.axes);
  const double thickness = s.max_thickness * s.max_thickness, spread = kMinSpread * kMinSpread * edge * edge;
  const double* v = out.values;
  if (v[0] <= thickness && v[1] >= spread && v[1] >= kFlatness * v[0] && v[1] >= kWidth * v[2])
    out.shape = Shape::plane;
  else if (v[1] <= thickness && v[2] >= spread && v[2] >= kFlatness * v[1])
    out.shape = Shape::line;
  return out;
}

SurfaceElement element(const double* mean, double count, const Surface& surface) {
  SurfaceElement e{};
  for (int i = 0; i < 3; ++i) {
    e.mean[i] = static_cast<float>(mean[i]);
    e.centre[i] = static_cast<float>(surface.centre[i]);
    e.values[i] = static_cast<float>(surface.values[i]);
  }
  for (int i = 0; i < 9; ++i) e.axes[i] = static_cast<float>(surface.axes[i]);
  e.count = static_cast<float>(count);
  e.support = static_cast<float>(surface.count);
  e.shape = surface.shape;
  return e;
}

// The axes of points that make no surface.
void add_axes(const PointMoments& m, SurfaceElement* e) {
  if (m.count < 3.0) return;
  double c[6], values[3], axes[9];
  m.covariance(c);
  symmetric_axes(c, values, axes);
  for (int i = 0; i < 3; ++i) e->values[i] = static_cast<float>(values[i]);
  for (int i = 0; i < 9; ++i) e->axes[i] = static_cast<float>(axes[i]);
}

// Whether an element belongs to a wider surface: it lies as near to it as the points that made it.
bool belongs(const SurfaceElement& e, const SurfaceElement& wider) {
  double off = 0.0;
  for (int i = 0; i < 3; ++i)
    off += static_cast<double>(wider.axes[i]) * (static_cast<double>(e.mean[i]) - static_cast<double>(wider.centre[i]));
  return off * off <= 9.0 * static_cast<double>(wider.values[0]) + 1e-6;
}

// Gives an element the surface of a wider one around it.
void adopt(const SurfaceElement& wider, SurfaceElement* e) {
  std::copy_n(wider.centre, 3, e->centre);
  std::copy_n(wider.axes, 9, e->axes);
  std::copy_n(wider.values, 3, e->values);
  e->support = wider.support;
  e->shape = wider.shape;
}

}  // namespace

SurfaceCloud::SurfaceCloud(std::span<const float> points, const ElementSettings& settings, int threads) {
  if (settings.voxel > 0.0)
    make_cubes(points, settings);
  else
    make_points(points, settings, threads);
}

void SurfaceCloud::make_cubes(std::span<const float> points, const ElementSettings& settings) {
  const auto count = static_cast<size_t>(settings.levels);
  std::vector<Cells> cells(count);
  std::vector<std::vector<uint32_t>> parent(count);
  for (size_t l = 0; l < count; ++l) {
    const double edge = settings.voxel * static_cast<double>(uint64_t{1} << l);
    levels_.push_back({edge, {}, FlatIndex(l == 0 ? 14 : 10), nullptr});
    cells[l] = l == 0 ? finest_cells(points, edge, &levels_[0].index, &finite_)
                      : parents(cells[l - 1], edge / 2.0, &levels_[l].index, &parent[l - 1]);
    levels_[l].elements.reserve(cells[l].size());
    for (const Cell& cell : cells[l]) {
      const double origin[3] = {middle(cell.cube.x, edge), middle(cell.cube.y, edge), middle(cell.cube.z, edge)};
      const Surface surface = surface_of(cell.moments, origin, edge, settings);
      levels_[l].elements.push_back(element(surface.centre, cell.moments.count, surface));
    }
  }
  for (size_t l = 0; l < count; ++l)  // upwards, so that the wider ones are still as their own points made them
    for (size_t i = 0; i < cells[l].size(); ++i) {
      SurfaceElement& e = levels_[l].elements[i];
      size_t at = i;
      for (size_t up = l; e.shape != Shape::plane && up + 1 < count; ++up) {
        at = parent[up][at];
        const SurfaceElement& wider = levels_[up + 1].elements[at];
        if ((wider.shape == Shape::plane && belongs(e, wider)) || (wider.shape == Shape::line && e.shape == Shape::scatter))
          adopt(wider, &e);
      }
      if (e.shape == Shape::scatter && e.count < static_cast<float>(settings.min_support)) add_axes(cells[l][i].moments, &e);
    }
}

void SurfaceCloud::make_points(std::span<const float> points, const ElementSettings& settings, int threads) {
  levels_.push_back({0.0, {}, FlatIndex(4), std::make_unique<KdTree>(points)});
  for (uint32_t k = 0; 3 * size_t{k} < points.size(); ++k)
    if (std::isfinite(points[3 * k] + points[3 * k + 1] + points[3 * k + 2])) source_.push_back(k);
  finite_ = source_.size();
  auto& elements = levels_[0].elements;
  elements.resize(finite_);
  const KdTree& tree = *levels_[0].tree;
  const auto wanted = static_cast<size_t>(settings.min_support);
  parallel_chunks((finite_ + kChunk - 1) / kChunk, threads, [&](size_t chunk) {
    std::vector<Neighbour> near(wanted);
    for (size_t i = chunk * kChunk; i < std::min(finite_, (chunk + 1) * kChunk); ++i) {
      const float* p = points.data() + 3 * size_t{source_[i]};
      const size_t found = tree.nearest(p, wanted, std::numeric_limits<float>::max(), near.data());
      PointMoments m;
      for (size_t k = 0; k < found; ++k) {
        const float* q = points.data() + 3 * size_t{near[k].index};
        m.add(static_cast<double>(q[0]) - static_cast<double>(p[0]), static_cast<double>(q[1]) - static_cast<double>(p[1]),
              static_cast<double>(q[2]) - static_cast<double>(p[2]));
      }
      const double origin[3] = {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2])};
      ElementSettings some = settings;
      some.min_support = 3;
      elements[i] = element(origin, 1.0, surface_of(m, origin, 0.0, some));
    }
  });
  // The tree must answer with elements, not points: where some were not finite the two are numbered differently.
  if (3 * finite_ != points.size()) {
    std::vector<float> kept(3 * finite_);
    for (size_t i = 0; i < finite_; ++i) std::copy_n(points.data() + 3 * size_t{source_[i]}, 3, kept.data() + 3 * i);
    levels_[0].tree = std::make_unique<KdTree>(kept);
  }
}

double SurfaceCloud::extent(size_t level) const {
  double side = 0.0;
  for (int k = 0; k < 3; ++k) {
    float low = std::numeric_limits<float>::max(), high = std::numeric_limits<float>::lowest();
    for (const SurfaceElement& e : levels_[level].elements) {
      low = std::min(low, e.mean[k]);
      high = std::max(high, e.mean[k]);
    }
    if (high >= low) side = std::max(side, static_cast<double>(high) - static_cast<double>(low));
  }
  return side;
}

void SurfaceCloud::spread(size_t level, double* sigmas) const {
  PointMoments m;
  const auto& elements = levels_[level].elements;
  for (const SurfaceElement& e : elements)
    m.add(static_cast<double>(e.mean[0] - elements[0].mean[0]), static_cast<double>(e.mean[1] - elements[0].mean[1]),
          static_cast<double>(e.mean[2] - elements[0].mean[2]));
  double c[6] = {0, 0, 0, 0, 0, 0}, axes[9];
  if (m.count > 1.0) m.covariance(c);
  principal_axes(c, sigmas, axes);
  for (int i = 0; i < 3; ++i) sigmas[i] = std::sqrt(sigmas[i]);
}

const KdTree& SurfaceCloud::tree(size_t at) {
  ElementLevel& level = levels_[at];
  if (level.tree == nullptr) {
    std::vector<float> means(3 * level.elements.size());
    for (size_t i = 0; i < level.elements.size(); ++i) std::copy_n(level.elements[i].mean, 3, means.data() + 3 * i);
    level.tree = std::make_unique<KdTree>(means);
  }
  return *level.tree;
}

}  // namespace heliograph
