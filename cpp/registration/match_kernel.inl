// SPDX-License-Identifier: MIT
// Compiled once for each instruction set, in a translation unit of its own. Everything here has internal linkage and no
// library template is instantiated, so that no AVX2 code can be merged into the baseline build by the linker.
#include <cmath>
#include <cstdint>

#include "registration/match_view.hpp"

namespace heliograph {
namespace {

struct FoundPlane {
  float normal[3];
  float offset[3];  // query minus a point of the plane
  float variance;   // of the plane at the query, across it [m^2]
  float tilt;       // variance of the normal about either axis across it [rad^2]
  uint32_t id;      // of its cube; of none through neighbours
  uint8_t source;   // 0 none, 1 + level, 255 neighbours
};

inline uint64_t kernel_mix(uint64_t key) {
  key ^= key >> 32;
  key *= 0xd6e8feb86659fd93ULL;
  key ^= key >> 32;
  key *= 0xd6e8feb86659fd93ULL;
  return key ^ (key >> 32);
}

inline int64_t kernel_floor(double x) {
  const auto i = static_cast<int64_t>(x);
  return i - static_cast<int64_t>(x < static_cast<double>(i));
}

inline uint64_t kernel_pack(uint64_t level, int64_t x, int64_t y, int64_t z) {
  return (level << 60) | ((static_cast<uint64_t>(x + 524288) & 0xfffffU) << 40) |
         ((static_cast<uint64_t>(y + 524288) & 0xfffffU) << 20) | (static_cast<uint64_t>(z + 524288) & 0xfffffU);
}

inline bool find(const IndexView& index, uint64_t key, uint32_t* value) {
  for (uint64_t i = kernel_mix(key) & index.mask;; i = (i + 1) & index.mask) {
    const SlotView slot = index.slots[i];
    if (slot.key == key) {
      *value = slot.value;
      return true;
    }
    if (slot.key == ~uint64_t{0}) return false;
  }
}

// False for NaN, and where a cube's index would not fit.
inline bool within_world(const double* q) {
  constexpr double kEnd = 1e12;
  return std::abs(q[0]) < kEnd && std::abs(q[1]) < kEnd && std::abs(q[2]) < kEnd;
}

// Whether cube (x, y, z) of a level has a plane within the gate of q; fills `out` if so.
inline bool try_plane(const MapView& map, int level, const int64_t* c, const double* q, float gate, FoundPlane* out) {
  uint32_t id = 0;
  if (!find(map.voxels, kernel_pack(static_cast<uint64_t>(level), c[0], c[1], c[2]), &id)) return false;
  const PlaneView& plane = map.planes[id];
  if (plane.variance < 0.0F) return false;
  const double edge = map.voxel * static_cast<double>(int64_t{1} << level);
  const float dx = static_cast<float>(q[0] - (static_cast<double>(c[0]) + 0.5) * edge) - plane.centroid[0];
  const float dy = static_cast<float>(q[1] - (static_cast<double>(c[1]) + 0.5) * edge) - plane.centroid[1];
  const float dz = static_cast<float>(q[2] - (static_cast<double>(c[2]) + 0.5) * edge) - plane.centroid[2];
  const float r = plane.normal[0] * dx + plane.normal[1] * dy + plane.normal[2] * dz;
  if (!(r <= gate && r >= -gate)) return false;  // also where q is not a number
  out->normal[0] = plane.normal[0];
  out->normal[1] = plane.normal[1];
  out->normal[2] = plane.normal[2];
  out->offset[0] = dx;
  out->offset[1] = dy;
  out->offset[2] = dz;
  out->tilt = plane.variance * plane.inv_spread;
  out->variance = plane.variance + out->tilt * (dx * dx + dy * dy + dz * dz - r * r);
  out->source = static_cast<uint8_t>(1 + level);
  out->id = id;
  return true;
}

// The finest plane whose cube holds q and whose distance passes the gate.
inline bool find_plane(const MapView& map, const double* q, float gate, FoundPlane* out) {
  if (!within_world(q)) return false;
  const double inverse = 1.0 / map.voxel;
  const int64_t fine[3] = {kernel_floor(q[0] * inverse), kernel_floor(q[1] * inverse), kernel_floor(q[2] * inverse)};
  for (int level = 0; level < map.levels; ++level) {
    const int64_t c[3] = {fine[0] >> level, fine[1] >> level, fine[2] >> level};
    if (try_plane(map, level, c, q, gate, out)) return true;
  }
  return false;
}

constexpr uint64_t kFar = 12, kNear = 6;  // points ahead

inline const SlotView* home(const IndexView& index, uint64_t key) { return index.slots + (kernel_mix(key) & index.mask); }

// The tables are larger than any cache. Asking for what a later point will need overlaps the waits: first its slots ...
inline void prefetch_slots(const MapView& map, const double* q) {
  if (!within_world(q)) return;
  const double inverse = 1.0 / map.voxel;
  const int64_t c[3] = {kernel_floor(q[0] * inverse), kernel_floor(q[1] * inverse), kernel_floor(q[2] * inverse)};
  for (int level = 0; level < map.levels; ++level)
    __builtin_prefetch(
        home(map.voxels, kernel_pack(static_cast<uint64_t>(level), c[0] >> level, c[1] >> level, c[2] >> level)));
}

// ... then, with those there, its finest plane.
inline void prefetch_plane(const MapView& map, const double* q) {
  if (!within_world(q)) return;
  const double inverse = 1.0 / map.voxel;
  uint32_t id = 0;
  const uint64_t key = kernel_pack(0, kernel_floor(q[0] * inverse), kernel_floor(q[1] * inverse), kernel_floor(q[2] * inverse));
  if (find(map.voxels, key, &id)) __builtin_prefetch(map.planes + id);
}

// A gate wider than this share of the coarsest cube means that the pose is poor.
constexpr double kWideShare = 0.4;

// While it is, a point may lie in the cube beside its surface's: the nearest plane of the coarsest cubes around.
inline bool find_plane_around(const MapView& map, const double* q, float gate, FoundPlane* out) {
  if (!within_world(q)) return false;
  const int level = map.levels - 1;
  const double inverse = 1.0 / (map.voxel * static_cast<double>(int64_t{1} << level));
  const int64_t middle[3] = {kernel_floor(q[0] * inverse), kernel_floor(q[1] * inverse), kernel_floor(q[2] * inverse)};
  float nearest = gate;
  bool found = false;
  for (int n = 0; n < 7; ++n) {
    int64_t c[3] = {middle[0], middle[1], middle[2]};
    if (n > 0) c[(n - 1) / 2] += (n - 1) % 2 == 0 ? -1 : 1;
    FoundPlane plane;
    if (!try_plane(map, level, c, q, nearest, &plane)) continue;
    const float r = plane.normal[0] * plane.offset[0] + plane.normal[1] * plane.offset[1] + plane.normal[2] * plane.offset[2];
    nearest = r < 0.0F ? -r : r;
    *out = plane;
    found = true;
  }
  return found;
}

constexpr int kNeighbours = 5;

struct Nearest {
  float distance2[kNeighbours];
  float offset[kNeighbours][3];  // neighbour minus query
  int count;
};

inline void keep_nearest(Nearest* best, float d2, float dx, float dy, float dz) {
  if (best->count == kNeighbours && d2 >= best->distance2[kNeighbours - 1]) return;
  int k = best->count < kNeighbours ? best->count++ : kNeighbours - 1;
  for (; k > 0 && best->distance2[k - 1] > d2; --k) {
    best->distance2[k] = best->distance2[k - 1];
    for (int i = 0; i < 3; ++i) best->offset[k][i] = best->offset[k - 1][i];
  }
  best->distance2[k] = d2;
  best->offset[k][0] = dx;
  best->offset[k][1] = dy;
  best->offset[k][2] = dz;
}

// Distance along one axis from a place inside the middle cube to the cube `step` (-1, 0, 1) away.
inline float axis_gap(float inside, float size, int step) {
  return step == 0 ? 0.0F : (step < 0 ? inside : size - inside);
}

// The nearest stored points among the 27 cubes around q, nearer than `range`. The middle cube comes first; a cube that
// is farther than the worst point kept is not opened.
inline void find_nearest(const MapView& map, const double* q, float range, Nearest* best) {
  constexpr int kOrder[3] = {0, -1, 1};
  best->count = 0;
  if (!within_world(q)) return;
  const double size = map.point_size;
  const auto edge = static_cast<float>(size);
  int64_t c[3];
  float inside[3];
  for (int i = 0; i < 3; ++i) {
    c[i] = kernel_floor(q[i] / size);
    inside[i] = static_cast<float>(q[i] - static_cast<double>(c[i]) * size);
  }
  float limit = range * range;
  uint64_t keys[27];
  float gap2[27];
  for (int n = 0; n < 27; ++n) {  // ask for all slots first, so that the waits overlap
    const int sx = kOrder[n % 3], sy = kOrder[(n / 3) % 3], sz = kOrder[n / 9];
    const float gx = axis_gap(inside[0], edge, sx), gy = axis_gap(inside[1], edge, sy), gz = axis_gap(inside[2], edge, sz);
    gap2[n] = gx * gx + gy * gy + gz * gz;
    keys[n] = kernel_pack(15, c[0] + sx, c[1] + sy, c[2] + sz);
    if (gap2[n] < limit) __builtin_prefetch(home(map.point_index, keys[n]));
  }
  for (int n = 0; n < 27; ++n) {
    if (gap2[n] >= limit) continue;
    const int sx = kOrder[n % 3], sy = kOrder[(n / 3) % 3], sz = kOrder[n / 9];
    uint32_t id = 0;
    if (!find(map.point_index, keys[n], &id)) continue;
    const BucketView& bucket = map.buckets[id];
    const float half = 0.5F * edge;
    const float ox = static_cast<float>(sx) * edge + half - inside[0];
    const float oy = static_cast<float>(sy) * edge + half - inside[1];
    const float oz = static_cast<float>(sz) * edge + half - inside[2];
    for (uint32_t k = 0; k < bucket.count; ++k) {
      const float dx = ox + bucket.x[k], dy = oy + bucket.y[k], dz = oz + bucket.z[k];
      const float d2 = dx * dx + dy * dy + dz * dz;
      if (d2 < limit) keep_nearest(best, d2, dx, dy, dz);
    }
    if (best->count == kNeighbours) limit = best->distance2[kNeighbours - 1];
  }
}

// Unit eigenvector of the smallest eigenvalue of a symmetric 3x3 (xx xy xz yy yz zz), and the eigenvalues ascending.
inline bool smallest_eigenvector(const double* m, double* vector, double* values) {
  const double mean = (m[0] + m[3] + m[5]) / 3.0;
  const double a = m[0] - mean, d = m[3] - mean, f = m[5] - mean;
  const double p2 = (a * a + d * d + f * f + 2.0 * (m[1] * m[1] + m[2] * m[2] + m[4] * m[4])) / 6.0;
  if (!(p2 > 0.0)) return false;
  const double p = std::sqrt(p2);
  const double det = a * (d * f - m[4] * m[4]) - m[1] * (m[1] * f - m[4] * m[2]) + m[2] * (m[1] * m[4] - d * m[2]);
  double cosine = 0.5 * det / (p2 * p);
  cosine = cosine > 1.0 ? 1.0 : (cosine < -1.0 ? -1.0 : cosine);
  const double angle = std::acos(cosine) / 3.0;
  values[2] = mean + 2.0 * p * std::cos(angle);
  values[0] = mean + 2.0 * p * std::cos(angle + 2.0943951023931953);
  values[1] = 3.0 * mean - values[0] - values[2];
  const double xx = m[0] - values[0], yy = m[3] - values[0], zz = m[5] - values[0];
  const double rows[3][3] = {{xx, m[1], m[2]}, {m[1], yy, m[4]}, {m[2], m[4], zz}};
  double longest = 0.0;
  for (int i = 0; i < 3; ++i) {
    const double* u = rows[i];
    const double* v = rows[(i + 1) % 3];
    const double cross[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    const double length = cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2];
    if (length <= longest) continue;
    longest = length;
    const double scale = 1.0 / std::sqrt(length);
    for (int k = 0; k < 3; ++k) vector[k] = scale * cross[k];
  }
  return longest > 0.0;
}

// A plane through the five nearest stored points, where they lie on one.
inline bool find_neighbour_plane(const MapView& map, const double* q, float gate, float range, FoundPlane* out) {
  Nearest best;
  find_nearest(map, q, range, &best);
  if (best.count < kNeighbours) return false;
  double mean[3] = {0.0, 0.0, 0.0};
  for (int k = 0; k < kNeighbours; ++k)
    for (int i = 0; i < 3; ++i) mean[i] += best.offset[k][i] / kNeighbours;
  double m[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  for (int k = 0; k < kNeighbours; ++k) {
    const double x = best.offset[k][0] - mean[0], y = best.offset[k][1] - mean[1], z = best.offset[k][2] - mean[2];
    m[0] += x * x / kNeighbours;
    m[1] += x * y / kNeighbours;
    m[2] += x * z / kNeighbours;
    m[3] += y * y / kNeighbours;
    m[4] += y * z / kNeighbours;
    m[5] += z * z / kNeighbours;
  }
  double normal[3], values[3];
  if (!smallest_eigenvector(m, normal, values)) return false;
  const double thickness2 = map.max_thickness * map.max_thickness;
  if (values[0] > thickness2 || values[1] < 4.0 * values[0] || values[1] < 1e-3) return false;
  for (int k = 0; k < kNeighbours; ++k) {
    double r = 0.0;
    for (int i = 0; i < 3; ++i) r += normal[i] * (best.offset[k][i] - mean[i]);
    if (r * r > 9.0 * thickness2) return false;
  }
  double r = 0.0, d2 = 0.0;
  for (int i = 0; i < 3; ++i) {
    r -= normal[i] * mean[i];
    d2 += mean[i] * mean[i];
    out->normal[i] = static_cast<float>(normal[i]);
    out->offset[i] = static_cast<float>(-mean[i]);
  }
  if (!(r <= gate && r >= -gate)) return false;  // also where q is not a number
  // Five points tell little about their own spread: the thickness allowed stands in for it.
  out->variance = static_cast<float>(thickness2 / kNeighbours * (1.0 + (d2 - r * r) / values[1]));
  // Their own spread, right on average (three of five numbers were fitted), sums up to what the normals' noise feigns.
  const double thin = values[0] > 0.0 ? values[0] / (kNeighbours - 3) : 0.0, apart = values[1] - values[0];
  out->tilt = static_cast<float>(thin * values[1] / (apart * apart));
  out->source = 255;
  return true;
}

inline void to_odom(const double* T, const float* p, double* q) {
  const double x = p[0], y = p[1], z = p[2];
  q[0] = T[0] * x + T[1] * y + T[2] * z + T[3];
  q[1] = T[4] * x + T[5] * y + T[6] * z + T[7];
  q[2] = T[8] * x + T[9] * y + T[10] * z + T[11];
}

inline void rotate_back(const double* T, const double* n, double* out) {
  for (int i = 0; i < 3; ++i) out[i] = T[i] * n[0] + T[4 + i] * n[1] + T[8 + i] * n[2];
}

// Row of the residual n.(R p + t - c) by rotation and position, right perturbations.
inline void pose_row(const MatchInput& in, const float* p, const double* n, double* m, double* J) {
  rotate_back(in.T_odom_body, n, m);  // the normal in the body frame
  J[0] = p[1] * m[2] - p[2] * m[1];
  J[1] = p[2] * m[0] - p[0] * m[2];
  J[2] = p[0] * m[1] - p[1] * m[0];
  J[3] = n[0];
  J[4] = n[1];
  J[5] = n[2];
}

// Derivative of n.(R (E p_l)) by E, the mounting, for a point q of the odom frame seen from the body pose T (3x4).
inline void mounting_part(const double* T, const double* E, const double* q, const double* n, double* J) {
  const double d[3] = {q[0] - T[3], q[1] - T[7], q[2] - T[11]};
  double p[3], l[3], m[3], k[3];
  rotate_back(T, d, p);
  rotate_back(T, n, m);
  const double e[3] = {p[0] - E[3], p[1] - E[7], p[2] - E[11]};
  rotate_back(E, e, l);
  rotate_back(E, m, k);
  J[0] = (l[1] * k[2] - l[2] * k[1]);
  J[1] = (l[2] * k[0] - l[0] * k[2]);
  J[2] = (l[0] * k[1] - l[1] * k[0]);
  for (int i = 0; i < 3; ++i) J[3 + i] = m[i];
}

// ... by the mounting's rotation and lever arm. Matching ties each LiDAR pose to the map, whatever the mounting; so an error
// of the mounting moves the whole map as one piece, by what it did at the very first pose, and only the difference to what
// it does at this pose shows.
inline void mounting_row(const MatchInput& in, const FoundPlane& plane, const double* q, const double* n, double* J) {
  for (int i = 0; i < 6; ++i) J[i] = 0.0;
  if (plane.source == 255) return;  // its points came from many poses: they are not asked while this runs
  double then[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
  mounting_part(in.T_odom_body, in.T_body_lidar, q, n, J);
  mounting_part(in.T_odom_body_first, in.T_body_lidar, q, n, then);
  for (int i = 0; i < 6; ++i) J[i] -= then[i];
}

// ... by velocity and gyroscope bias: a point measured dt before the sweep's end was carried back by both.
inline void motion_row(double dt, const double* n, const double* rotation, double* J) {
  for (int i = 0; i < 3; ++i) {
    J[i] = -dt * n[i];
    J[3 + i] = dt * rotation[i];
  }
}

inline void jacobian_row(const MatchInput& in, uint64_t k, const FoundPlane& plane, const double* q, const double* n,
                         double* J) {
  double m[3];
  pose_row(in, in.points + 3 * k, n, m, J);
  if (in.columns == 6) return;
  if (in.before_end == nullptr) return mounting_row(in, plane, q, n, J + 6);
  motion_row(in.before_end[k], n, J, J + 6);
  if (in.columns == 18) mounting_row(in, plane, q, n, J + 12);
}

inline void accumulate(const double* J, int columns, double r, double w, double inv_var, NormalSums* sums) {
  const double scale = w * inv_var;
  for (int i = 0; i < columns; ++i) {
    const double s = scale * J[i];
    sums->gradient[i] += s * r;
    for (int j = i; j < columns; ++j) sums->information[kRow * i + j] += s * J[j];
  }
  sums->weight += scale;
  sums->robust_weight += w;
  sums->square += w * r * r;
}

// What noise of the normal alone adds to the information in expectation. The row is L n with a lever L, and n is off by a
// tilt of variance `tilt` about either axis across it: w / s^2 L T L^T with T = tilt (1 - m m^T), here in body axes and for
// each power of dt that the motion's columns ask for. Order: T (xx xy xz yy yz zz), [p] T (row-major), [p] T [p]^T.
inline void accumulate_feigned(const float* p, const double* m, double scale, double dt, int powers, NormalSums* sums) {
  const double x = p[0], y = p[1], z = p[2];
  double a[kFeigned] = {};
  a[0] = scale * (1.0 - m[0] * m[0]);
  a[1] = -scale * m[0] * m[1];
  a[2] = -scale * m[0] * m[2];
  a[3] = scale * (1.0 - m[1] * m[1]);
  a[4] = -scale * m[1] * m[2];
  a[5] = scale * (1.0 - m[2] * m[2]);
  const double T[9] = {a[0], a[1], a[2], a[1], a[3], a[4], a[2], a[4], a[5]};
  double* C = a + 6;
  for (int j = 0; j < 3; ++j) {
    C[j] = y * T[6 + j] - z * T[3 + j];
    C[3 + j] = z * T[j] - x * T[6 + j];
    C[6 + j] = x * T[3 + j] - y * T[j];
  }
  a[15] = y * C[2] - z * C[1];
  a[16] = z * C[0] - x * C[2];
  a[17] = x * C[1] - y * C[0];
  a[18] = z * C[3] - x * C[5];
  a[19] = x * C[4] - y * C[3];
  a[20] = x * C[7] - y * C[6];
  double power = 1.0;
  for (int k = 0; k < powers; ++k, power *= dt)
    for (int i = 0; i < kFeigned; ++i) sums->feigned[k * kFeigned + i] += power * a[i];
  sums->feigned_square += scale * scale;
}

// Geman-McClure: rho = r^2 c^2 / (c^2 + r^2) / 2, w = (c^2 / (c^2 + r^2))^2.
inline double robust_weight(double r, double kernel) {
  if (kernel <= 0.0) return 1.0;
  const double share = kernel * kernel / (kernel * kernel + r * r);
  return share * share;
}

inline double robust_cost(double r, double kernel) {
  if (kernel <= 0.0) return 0.5 * r * r;
  return 0.5 * r * r * kernel * kernel / (kernel * kernel + r * r);
}

inline void planes_range(const MatchInput& in, uint64_t begin, uint64_t end, NormalSums* sums) {
  const auto gate = static_cast<float>(in.gate);
  const bool wide = in.gate > in.map.voxel * static_cast<double>(int64_t{1} << (in.map.levels - 1)) * kWideShare;
  int unmatched = 0;
  for (uint64_t k = begin; k < end; ++k) {
    double q[3];
    if (!wide && k + kFar < end) {
      to_odom(in.T_odom_body, in.points + 3 * (k + kFar), q);
      prefetch_slots(in.map, q);
      to_odom(in.T_odom_body, in.points + 3 * (k + kNear), q);
      prefetch_plane(in.map, q);
    }
    const float* p = in.points + 3 * k;
    to_odom(in.T_odom_body, p, q);
    FoundPlane plane;
    bool fallback = false;
    if (!(wide ? find_plane_around(in.map, q, gate, &plane) : find_plane(in.map, q, gate, &plane))) {
      if (in.fallback_stride == 0 || unmatched++ % in.fallback_stride != 0) continue;
      if (!find_neighbour_plane(in.map, q, gate, static_cast<float>(in.fallback_range), &plane)) continue;
      fallback = true;
    }
    const double n[3] = {plane.normal[0], plane.normal[1], plane.normal[2]};
    const double r = n[0] * plane.offset[0] + n[1] * plane.offset[1] + n[2] * plane.offset[2];
    const double inv_var = 1.0 / (in.sigma * in.sigma + static_cast<double>(plane.variance));
    double J[kRow];
    jacobian_row(in, k, plane, q, n, J);
    const double w = robust_weight(r, in.kernel);
    accumulate(J, in.columns, r, w, inv_var, sums);
    double m[3];
    rotate_back(in.T_odom_body, n, m);
    const bool motion = in.before_end != nullptr;
    accumulate_feigned(p, m, w * inv_var * static_cast<double>(plane.tilt), motion ? in.before_end[k] : 0.0,
                       motion ? 3 : 1, sums);
    sums->cost += robust_cost(r, in.kernel) * inv_var;
    sums->matches += 1;
    sums->fallback_matches += fallback ? 1 : 0;
  }
}

inline void points_range(const MatchInput& in, uint64_t begin, uint64_t end, NormalSums* sums) {
  for (uint64_t k = begin; k < end; ++k) {
    const float* p = in.points + 3 * k;
    double q[3];
    to_odom(in.T_odom_body, p, q);
    Nearest best;
    find_nearest(in.map, q, static_cast<float>(in.gate), &best);
    if (best.count == 0) continue;
    const double inv_var = 1.0 / (in.sigma * in.sigma);
    const double distance = std::sqrt(static_cast<double>(best.distance2[0]));
    const double w = robust_weight(distance, in.kernel);
    for (int i = 0; i < 3; ++i) {
      const double n[3] = {i == 0 ? 1.0 : 0.0, i == 1 ? 1.0 : 0.0, i == 2 ? 1.0 : 0.0};
      double J[kRow];
      FoundPlane none;
      none.source = 255;
      jacobian_row(in, k, none, q, n, J);
      accumulate(J, in.columns, -static_cast<double>(best.offset[0][i]), w, inv_var, sums);
    }
    sums->cost += robust_cost(distance, in.kernel) * inv_var;
    sums->matches += 1;
  }
}

inline void query_range(const MatchInput& in, const double* points, uint64_t begin, uint64_t end, float* normal,
                        double* point, float* variance, float* tilt, float* scatter, float* since, uint8_t* source) {
  int unmatched = 0;
  for (uint64_t k = begin; k < end; ++k) {
    const double* q = points + 3 * k;
    FoundPlane plane;
    source[k] = 0;
    scatter[k] = since[k] = -1.0F;
    if (!find_plane(in.map, q, static_cast<float>(in.gate), &plane)) {
      if (in.fallback_stride == 0 || unmatched++ % in.fallback_stride != 0) continue;
      if (!find_neighbour_plane(in.map, q, static_cast<float>(in.gate), static_cast<float>(in.fallback_range), &plane))
        continue;
    }
    for (int i = 0; i < 3; ++i) {
      normal[3 * k + static_cast<uint64_t>(i)] = plane.normal[i];
      point[3 * k + static_cast<uint64_t>(i)] = q[i] - plane.offset[i];
    }
    variance[k] = plane.variance;
    tilt[k] = plane.tilt;
    source[k] = plane.source;
    if (plane.source == 255) continue;
    const Moments& m = in.map.moments[plane.id];
    scatter[k] = in.map.planes[plane.id].variance * (m.fitted > 4.0F ? m.fitted - 3.0F : 1.0F);
    since[k] = m.since;
  }
}

}  // namespace
}  // namespace heliograph
