// SPDX-License-Identifier: MIT
#include "registration/icp.hpp"

#include <algorithm>
#include <cmath>

#include "lie/so3.hpp"
#include "util/parallel.hpp"
#include "util/voxel_key.hpp"

namespace heliograph {

namespace {

constexpr size_t kChunk = 256;
constexpr double kGrazing = 0.05;  // cosine below which a plane shows neither side

struct Motion {
  double R[9], t[3];
};

Motion motion_of(const double* T) {
  return {{T[0], T[1], T[2], T[4], T[5], T[6], T[8], T[9], T[10]}, {T[3], T[7], T[11]}};
}

void apply(const Motion& m, const float* p, double* out) {
  const double x[3] = {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2])};
  lie::so3_rotate(m.R, x, out);
  for (int i = 0; i < 3; ++i) out[i] += m.t[i];
}

void widen(const float* v, double* out) {
  for (int i = 0; i < 3; ++i) out[i] = static_cast<double>(v[i]);
}

// One residual: information matrix in the target's axes, xx xy xz yy yz zz, and the vector that it weighs.
struct Term {
  double omega[6];
  double r[3];
  double length;    // of what the kernel looks at [m]; signed across a plane
  double variance;  // of that [m^2]
};

// Variance of an element's own mean across its surface.
double mean_variance(const SurfaceElement& e) { return static_cast<double>(e.values[0]) / std::max(1.0, static_cast<double>(e.count)); }

// Variance of a target's plane across itself at a place: that of its centre, and its tilt times the distance from it.
double plane_variance(const SurfaceElement& e, const double* from_centre) {
  const double inverse = 1.0 / std::max(1.0, static_cast<double>(e.support));
  double tilt = 0.0;
  for (int k = 1; k < 3; ++k) {
    double axis[3];
    widen(e.axes + 3 * k, axis);
    const double along = lie::dot3(axis, from_centre), value = static_cast<double>(e.values[k]);
    if (value > 0.0) tilt += along * along / value;
  }
  return static_cast<double>(e.values[0]) * inverse * (1.0 + tilt);
}

void add_outer(double* omega, const double* v, double scale) {
  omega[0] += scale * v[0] * v[0];
  omega[1] += scale * v[0] * v[1];
  omega[2] += scale * v[0] * v[2];
  omega[3] += scale * v[1] * v[1];
  omega[4] += scale * v[1] * v[2];
  omega[5] += scale * v[2] * v[2];
}

bool plane_term(const SurfaceElement& t, const SurfaceElement& s, const double* p, double floor2, Term* out) {
  if (t.shape != Shape::plane) return false;
  double n[3], c[3];
  widen(t.axes, n);
  widen(t.centre, c);
  const double d[3] = {p[0] - c[0], p[1] - c[1], p[2] - c[2]};
  out->length = lie::dot3(n, d);
  out->variance = floor2 + plane_variance(t, d) + mean_variance(s);
  for (int i = 0; i < 3; ++i) out->r[i] = d[i];
  std::fill_n(out->omega, 6, 0.0);
  add_outer(out->omega, n, 1.0 / out->variance);
  return true;
}

bool edge_term(const SurfaceElement& t, const SurfaceElement& s, const double* p, double floor2, Term* out) {
  if (t.shape != Shape::line) return false;
  double u[3], c[3];
  widen(t.axes + 6, u);
  widen(t.centre, c);
  const double d[3] = {p[0] - c[0], p[1] - c[1], p[2] - c[2]}, along = lie::dot3(u, d);
  for (int i = 0; i < 3; ++i) out->r[i] = d[i] - along * u[i];
  out->length = std::sqrt(lie::dot3(out->r, out->r));
  out->variance = floor2 + static_cast<double>(t.values[1]) / static_cast<double>(t.support) + mean_variance(s);
  std::fill_n(out->omega, 6, 0.0);
  const double w = 1.0 / out->variance;
  out->omega[0] = out->omega[3] = out->omega[5] = w;
  add_outer(out->omega, u, -w);
  return true;
}

bool point_term(const SurfaceElement& t, const double* p, double floor2, Term* out) {
  double q[3];
  widen(t.mean, q);
  for (int i = 0; i < 3; ++i) out->r[i] = p[i] - q[i];
  out->length = std::sqrt(lie::dot3(out->r, out->r));
  out->variance = floor2;
  std::fill_n(out->omega, 6, 0.0);
  out->omega[0] = out->omega[3] = out->omega[5] = 1.0 / floor2;
  return true;
}

// An element's own uncertainty: thin across its plane, a cube's edge wide along it, since what of a surface two scans
// sample is chance; half an edge in all directions where it has no plane (A. Segal et al., "Generalized-ICP", RSS 2009).
double add_spread(const SurfaceElement& e, const double* R, double across, double along, double* C) {
  if (e.shape != Shape::plane) {
    const double loose = 0.25 * along;
    C[0] += loose;
    C[3] += loose;
    C[5] += loose;
    return loose;
  }
  double axis[3], n[3];
  widen(e.axes, axis);
  if (R != nullptr)
    lie::so3_rotate(R, axis, n);
  else
    std::copy_n(axis, 3, n);
  C[0] += along;
  C[3] += along;
  C[5] += along;
  add_outer(C, n, across - along);
  return across;
}

bool distribution_term(const SurfaceElement& t, const SurfaceElement& s, const double* p, const double* R, double floor2,
                       double along, Term* out) {
  double q[3];
  widen(t.shape == Shape::plane ? t.centre : t.mean, q);
  for (int i = 0; i < 3; ++i) out->r[i] = p[i] - q[i];
  const bool flat = t.shape == Shape::plane;
  // The centre of a plane taken from wider surroundings lies anywhere along it.
  const double reach = flat ? std::max(along, static_cast<double>(t.values[2])) : along;
  double C[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  const double a = add_spread(t, nullptr, floor2 + (flat ? plane_variance(t, out->r) : 0.0), reach, C);
  const double b = add_spread(s, R, floor2 + mean_variance(s), along, C);
  out->variance = a + b;
  const double cof[6] = {C[3] * C[5] - C[4] * C[4], C[2] * C[4] - C[1] * C[5], C[1] * C[4] - C[2] * C[3],
                         C[0] * C[5] - C[2] * C[2], C[1] * C[2] - C[0] * C[4], C[0] * C[3] - C[1] * C[1]};
  const double inverse = 1.0 / (C[0] * cof[0] + C[1] * cof[1] + C[2] * cof[2]);
  for (int i = 0; i < 6; ++i) out->omega[i] = cof[i] * inverse;
  const double *o = out->omega, *r = out->r;
  const double m2 = o[0] * r[0] * r[0] + o[3] * r[1] * r[1] + o[5] * r[2] * r[2] +
                    2.0 * (o[1] * r[0] * r[1] + o[2] * r[0] * r[2] + o[4] * r[1] * r[2]);
  out->length = std::sqrt(std::max(m2, 0.0) * out->variance);
  return true;
}

// Which side of its plane an element shows to the origin: 1, -1, or 0 where it is seen from along it.
double seen_side(const SurfaceElement& e) {
  double n[3], p[3];
  widen(e.axes, n);
  widen(e.mean, p);
  const double towards = lie::dot3(n, p);
  if (towards * towards < kGrazing * kGrazing * lie::dot3(p, p)) return 0.0;
  return towards > 0.0 ? 1.0 : -1.0;
}

size_t strided(size_t count, size_t stride) { return (count + stride - 1) / stride; }

struct Pairing {
  const ElementLevel& target;
  const KdTree* tree;
  const ElementLevel& source;
  Motion motion;
  IcpSettings settings;

  uint64_t cube_of(const double* p) const {
    const double inverse = 1.0 / target.edge;
    return pack(0, {floor_index(p[0] * inverse), floor_index(p[1] * inverse), floor_index(p[2] * inverse)});
  }

  uint32_t partner(const double* p, uint32_t hint) const {
    if (settings.by_cube) {
      const FlatIndex::Slot* slot = target.index.find(cube_of(p));
      return slot == nullptr ? kNoNeighbour : slot->value;
    }
    const float q[3] = {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
    return tree->nearest(q, static_cast<float>(settings.gate * settings.gate), hint).index;
  }

  // The partners of `count` elements at their places, into `found`, which holds a guess of each: step by step for all
  // of them, so that the waits for the index and for the partners overlap.
  void partners(const double* places, size_t count, uint32_t* found) const {
    if (settings.by_cube)
      for (size_t i = 0; i < count; ++i) target.index.prefetch(cube_of(places + 3 * i));
    for (size_t i = 0; i < count; ++i) {
      found[i] = partner(places + 3 * i, found[i]);
      if (found[i] != kNoNeighbour) __builtin_prefetch(&target.elements[found[i]]);
    }
  }

  bool facing_alike(const SurfaceElement& t, const SurfaceElement& s) const {
    double axis[3], n[3], m[3];
    widen(s.axes, axis);
    lie::so3_rotate(motion.R, axis, m);
    widen(t.axes, n);
    const double cosine = lie::dot3(n, m);
    if (std::abs(cosine) < settings.min_cosine) return false;
    const double side = seen_side(t) * seen_side(s);
    return !settings.one_sided || cosine * side >= 0.0;
  }

  bool term(const SurfaceElement& t, const SurfaceElement& s, const double* p, Term* out) const {
    if (t.shape == Shape::plane && s.shape == Shape::plane && !facing_alike(t, s)) return false;
    const double floor2 = settings.sigma * settings.sigma;
    switch (settings.residual) {
      case Residual::plane: return plane_term(t, s, p, floor2, out);
      case Residual::edge: return edge_term(t, s, p, floor2, out);
      case Residual::point: return point_term(t, p, floor2, out);
      case Residual::distribution: break;
    }
    const double edge = target.edge > 0.0 ? target.edge : 0.5 * settings.gate;
    return distribution_term(t, s, p, motion.R, floor2, 0.25 * edge * edge, out);
  }

  double weight(const Term& term) const {
    if (settings.kernel <= 0.0) return 1.0;
    const double c2 = settings.kernel * settings.kernel, ratio = c2 / (c2 + term.length * term.length);
    return ratio * ratio;
  }
};

// Adds w J^T Omega J and w J^T Omega r with J = [-hat(p), I] in the source's axes.
void add_term(const Term& term, const double* R, const float* point, double w, IcpSums* sums) {
  const double* o = term.omega;
  const double omega[9] = {o[0], o[1], o[2], o[1], o[3], o[4], o[2], o[4], o[5]};
  double turned[9], B[9], r[3], p[3], f[3], torque[3];
  lie::so3_between(R, omega, turned);
  lie::multiply3(turned, R, B);
  lie::so3_rotate_back(R, term.r, r);
  widen(point, p);
  lie::so3_rotate(B, r, f);
  lie::cross3(p, f, torque);
  double hat_B[9], columns[9];  // rows of hat_B: p x (columns of B), B being symmetric
  for (int j = 0; j < 3; ++j) lie::cross3(p, B + 3 * j, columns + 3 * j);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) hat_B[3 * i + j] = columns[3 * j + i];
  for (int i = 0; i < 3; ++i) {
    double row[3];
    lie::cross3(p, hat_B + 3 * i, row);  // (hat(p) B hat(p)^T)_i = p x row_i
    for (int j = 0; j < 3; ++j) {
      sums->information[6 * i + j] += w * row[j];
      sums->information[6 * i + 3 + j] += w * hat_B[3 * i + j];
      sums->information[6 * (3 + i) + 3 + j] += w * B[3 * i + j];
    }
    sums->gradient[i] += w * torque[i];
    sums->gradient[3 + i] += w * f[i];
  }
  sums->weight += w;
  sums->square += w * term.length * term.length;
  sums->whitened += w * term.length * term.length / term.variance;
  ++sums->matches;
}

double robust_cost(const Term& term, double kernel) {
  const double l2 = term.length * term.length, c2 = kernel * kernel;
  return 0.5 * l2 * (kernel > 0.0 ? c2 / (c2 + l2) : 1.0) / term.variance;
}

Pairing pairing(const SurfaceCloud& target, size_t target_level, const SurfaceCloud& source, size_t source_level,
                const double* T, const IcpSettings& settings) {
  const ElementLevel& to = target.level(target_level);
  return {to, to.tree.get(), source.level(source_level), motion_of(T), settings};
}

}  // namespace

IcpSums icp_sums(const SurfaceCloud& target, size_t target_level, const SurfaceCloud& source, size_t source_level,
                 const double* T, const IcpSettings& settings, std::vector<uint32_t>* hints, bool keep, int threads) {
  const Pairing pairs = pairing(target, target_level, source, source_level, T, settings);
  const auto& elements = pairs.source.elements;
  const size_t stride = settings.stride, total_count = strided(elements.size(), stride);
  const size_t chunks = (total_count + kChunk - 1) / kChunk;
  hints->resize(total_count, kNoNeighbour);
  std::vector<IcpSums> partial(chunks);
  parallel_chunks(chunks, threads, [&](size_t chunk) {
    IcpSums& sums = partial[chunk];
    const size_t begin = chunk * kChunk, count = std::min(total_count, begin + kChunk) - begin;
    double places[3 * kChunk];
    uint32_t* found = hints->data() + begin;
    for (size_t i = 0; i < count; ++i) apply(pairs.motion, elements[(begin + i) * stride].mean, places + 3 * i);
    if (!keep) pairs.partners(places, count, found);
    for (size_t k = 0; k < count; ++k) {
      if (found[k] == kNoNeighbour) continue;
      const size_t i = (begin + k) * stride;
      Term term;
      if (!pairs.term(pairs.target.elements[found[k]], elements[i], places + 3 * k, &term)) continue;
      sums.cost += robust_cost(term, settings.kernel);
      add_term(term, pairs.motion.R, elements[i].mean, pairs.weight(term), &sums);
    }
  });
  IcpSums total;
  for (const IcpSums& part : partial) {
    for (int i = 0; i < 36; ++i) total.information[i] += part.information[i];
    for (int i = 0; i < 6; ++i) total.gradient[i] += part.gradient[i];
    total.cost += part.cost;
    total.weight += part.weight;
    total.square += part.square;
    total.whitened += part.whitened;
    total.matches += part.matches;
  }
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < i; ++j) total.information[6 * i + j] = total.information[6 * j + i];
  return total;
}

std::vector<IcpMatch> icp_matches(const SurfaceCloud& target, size_t target_level, const SurfaceCloud& source,
                                  size_t source_level, const double* T, const IcpSettings& settings,
                                  const std::vector<uint32_t>& hints, int threads) {
  const Pairing pairs = pairing(target, target_level, source, source_level, T, settings);
  const auto& elements = pairs.source.elements;
  const size_t stride = settings.stride, count = strided(elements.size(), stride);
  const size_t chunks = (count + kChunk - 1) / kChunk;
  std::vector<std::vector<IcpMatch>> partial(chunks);
  parallel_chunks(chunks, threads, [&](size_t chunk) {
    const size_t begin = chunk * kChunk, some = std::min(count, begin + kChunk) - begin;
    double places[3 * kChunk];
    std::vector<uint32_t> partner(some, kNoNeighbour);
    if (!hints.empty()) std::copy_n(hints.begin() + static_cast<std::ptrdiff_t>(begin), some, partner.begin());
    for (size_t k = 0; k < some; ++k) apply(pairs.motion, elements[(begin + k) * stride].mean, places + 3 * k);
    pairs.partners(places, some, partner.data());
    partial[chunk].reserve(some);
    for (size_t k = 0; k < some; ++k) {
      const size_t i = (begin + k) * stride;
      const double* p = places + 3 * k;
      double q[3];
      const uint32_t found = partner[k];
      Term term;
      if (found == kNoNeighbour || !pairs.term(pairs.target.elements[found], elements[i], p, &term)) continue;
      const SurfaceElement& t = pairs.target.elements[found];
      IcpMatch match{};
      widen(elements[i].mean, match.point);
      widen(t.mean, q);
      const double d[3] = {p[0] - q[0], p[1] - q[1], p[2] - q[2]};
      match.residual = term.length;
      match.distance = std::sqrt(lie::dot3(d, d));
      match.weight = pairs.weight(term);
      match.variance = term.variance;
      match.source = static_cast<double>(i);
      match.target = static_cast<double>(found);
      if (t.shape == Shape::plane) {
        double axis[3];
        widen(t.axes, axis);
        lie::so3_rotate_back(pairs.motion.R, axis, match.normal);
        match.tilt = static_cast<double>(t.values[0] / (std::max(1.0F, t.support) * t.values[1]));
      }
      partial[chunk].push_back(match);
    }
  });
  std::vector<IcpMatch> all;
  for (const auto& part : partial) all.insert(all.end(), part.begin(), part.end());
  return all;
}

double overlap_share(const SurfaceCloud& to, size_t to_level, const SurfaceCloud& from, size_t from_level,
                     const double* T, double reach, size_t stride, int threads) {
  const KdTree& tree = *to.level(to_level).tree;
  const auto& elements = from.level(from_level).elements;
  if (elements.empty()) return 0.0;
  const Motion motion = motion_of(T);
  const auto square = static_cast<float>(reach * reach);
  const size_t count = strided(elements.size(), stride), chunks = (count + kChunk - 1) / kChunk;
  std::vector<size_t> near(chunks, 0);
  parallel_chunks(chunks, threads, [&](size_t chunk) {
    uint32_t last = kNoNeighbour;
    for (size_t i = chunk * kChunk; i < std::min(count, (chunk + 1) * kChunk); ++i) {
      double p[3];
      apply(motion, elements[i * stride].mean, p);
      const float q[3] = {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
      // Elements that follow one another mostly lie together: what was near the last one is often near enough to this.
      if (last == kNoNeighbour || square_distance(q, to.level(to_level).elements[last].mean) > square) last = tree.nearest(q, square).index;
      near[chunk] += last != kNoNeighbour;
    }
  });
  size_t total = 0;
  for (const size_t some : near) total += some;
  return static_cast<double>(total) / static_cast<double>(count);
}

}  // namespace heliograph
