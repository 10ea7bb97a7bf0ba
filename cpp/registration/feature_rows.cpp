// SPDX-License-Identifier: MIT
#include "registration/feature_rows.hpp"

#include <algorithm>
#include <cmath>

#include "util/parallel.hpp"

namespace heliograph {

namespace {

constexpr size_t kChunk = 256;

struct Row {
  double J[6];
};

// What moves a point along `n`: the rotation, a right perturbation, and the position; a point that goes along in part
// only, by that part.
Row row_along(const double* direction, const double* p, const double* T, double part) {
  double m[3], n[3];
  for (int i = 0; i < 3; ++i) n[i] = part * direction[i];
  for (int i = 0; i < 3; ++i) m[i] = T[i] * n[0] + T[4 + i] * n[1] + T[8 + i] * n[2];
  return {{p[1] * m[2] - p[2] * m[1], p[2] * m[0] - p[0] * m[2], p[0] * m[1] - p[1] * m[0], n[0], n[1], n[2]}};
}

// Two unit vectors across a unit vector and each other; the axis it leans on least makes the first.
void across(const double* n, double* a, double* b) {
  int k = 0;
  for (int i = 1; i < 3; ++i)
    if (std::abs(n[i]) < std::abs(n[k])) k = i;
  double e[3] = {0.0, 0.0, 0.0};
  e[k] = 1.0;
  a[0] = n[1] * e[2] - n[2] * e[1];
  a[1] = n[2] * e[0] - n[0] * e[2];
  a[2] = n[0] * e[1] - n[1] * e[0];
  const double scale = 1.0 / std::sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
  for (int i = 0; i < 3; ++i) a[i] *= scale;
  b[0] = n[1] * a[2] - n[2] * a[1];
  b[1] = n[2] * a[0] - n[0] * a[2];
  b[2] = n[0] * a[1] - n[1] * a[0];
}

void add_outer(const Row& row, double weight, double* H) {
  for (int i = 0; i < 6; ++i)
    for (int j = i; j < 6; ++j) H[6 * i + j] += weight * row.J[i] * row.J[j];
}

struct Sums {
  FeatureKind kind;
  double gate, kernel, sigma;
  NormalEquations out;

  void add(const FeatureMatch& match, const float* point, const double* T, double part) {
    const double p[3] = {static_cast<double>(point[0]), static_cast<double>(point[1]), static_cast<double>(point[2])};
    double d[3], a[3], b[3];
    for (int i = 0; i < 3; ++i) d[i] = T[4 * i] * p[0] + T[4 * i + 1] * p[1] + T[4 * i + 2] * p[2] + T[4 * i + 3] - match.point[i];
    across(match.axis, a, b);
    const bool edge = kind == FeatureKind::edge;
    const double* directions[2] = {edge ? a : match.axis, b};
    double r[2] = {0.0, 0.0}, square = 0.0;
    const int rows = edge ? 2 : 1;
    for (int k = 0; k < rows; ++k) {
      for (int i = 0; i < 3; ++i) r[k] += directions[k][i] * d[i];
      square += r[k] * r[k];
    }
    if (square > gate * gate) return;
    const double c2 = kernel * kernel, ratio = c2 > 0.0 ? c2 / (c2 + square) : 1.0;
    const double w = ratio * ratio, inverse = 1.0 / (sigma * sigma + match.variance), weight = w * inverse;
    for (int k = 0; k < rows; ++k) {
      const Row row = row_along(directions[k], p, T, part);
      add_outer(row, weight, out.information);
      for (int i = 0; i < 6; ++i) out.gradient[i] += weight * r[k] * row.J[i];
    }
    // A tilt moves a plane's normal along either direction across it; of an edge, each row's normal along the line.
    const double noise = weight * match.tilt;
    if (edge) {
      add_outer(row_along(match.axis, p, T, part), 2.0 * noise, out.feigned);
    } else {
      add_outer(row_along(a, p, T, part), noise, out.feigned);
      add_outer(row_along(b, p, T, part), noise, out.feigned);
    }
    out.feigned_square += noise * noise;
    out.weight += rows * weight;
    out.robust_weight += rows * w;
    out.square += w * square;
    out.cost += 0.5 * square * ratio * inverse;
    ++out.matches;
  }
};

}  // namespace

std::vector<FeatureMatch> match_features(const FeatureMap& map, const FeatureScan& scan, double sigma, int threads) {
  const size_t count = scan.points_body.size() / 3;
  std::vector<FeatureMatch> found(count);
  const double* T = scan.T_odom_body;
  parallel_chunks((count + kChunk - 1) / kChunk, threads, [&](size_t chunk) {
    for (size_t k = chunk * kChunk; k < std::min(count, (chunk + 1) * kChunk); ++k) {
      double p[3], q[3];
      for (size_t i = 0; i < 3; ++i) p[i] = static_cast<double>(scan.points_body[3 * k + i]);
      for (int i = 0; i < 3; ++i) q[i] = T[4 * i] * p[0] + T[4 * i + 1] * p[1] + T[4 * i + 2] * p[2] + T[4 * i + 3];
      found[k] = map.match(q, sigma);
    }
  });
  return found;
}

NormalEquations sum_features(FeatureKind kind, std::span<const FeatureMatch> matches, const FeatureScan& scan,
                             std::span<const float> shares, double gate, double kernel, double sigma, int threads) {
  const size_t count = matches.size(), chunks = (count + kChunk - 1) / kChunk;
  std::vector<Sums> partial(chunks, Sums{kind, gate, kernel, sigma, {}});
  parallel_chunks(chunks, threads, [&](size_t chunk) {
    for (size_t k = chunk * kChunk; k < std::min(count, (chunk + 1) * kChunk); ++k)
      if (matches[k].found)
        partial[chunk].add(matches[k], scan.points_body.data() + 3 * k, scan.T_odom_body,
                           shares.empty() ? 1.0 : static_cast<double>(shares[k]));
  });
  NormalEquations total;
  for (const Sums& part : partial) {
    for (int i = 0; i < 36; ++i) {
      total.information[i] += part.out.information[i];
      total.feigned[i] += part.out.feigned[i];
    }
    for (int i = 0; i < 6; ++i) total.gradient[i] += part.out.gradient[i];
    total.feigned_square += part.out.feigned_square;
    total.weight += part.out.weight;
    total.robust_weight += part.out.robust_weight;
    total.square += part.out.square;
    total.cost += part.out.cost;
    total.matches += part.out.matches;
  }
  for (int i = 0; i < 6; ++i)
    for (int j = 0; j < i; ++j) {
      total.information[6 * i + j] = total.information[6 * j + i];
      total.feigned[6 * i + j] = total.feigned[6 * j + i];
    }
  return total;
}

}  // namespace heliograph
