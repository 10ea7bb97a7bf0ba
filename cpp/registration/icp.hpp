// SPDX-License-Identifier: MIT
// One iteration of registration between two prepared clouds: association, residuals, normal equations.
#pragma once
#include <cstdint>
#include <vector>

#include "registration/surface_elements.hpp"

namespace heliograph {

enum class Residual : int { point = 0, plane = 1, edge = 2, distribution = 3 };

struct IcpSettings {
  Residual residual;
  bool by_cube;         // an element's partner is that of the target's cube that holds it, not the nearest
  double gate;          // largest distance of partners [m]
  double kernel;        // scale of the Geman-McClure kernel [m]; 0: least squares
  double sigma;         // smallest standard deviation of a residual [m]: what the surfaces' model leaves out
  double min_cosine;    // of the angle between the normals of partners that are planes
  bool one_sided;       // each cloud is seen from its origin: a plane's two sides are two planes
  size_t stride = 1;    // every so-many-th element of the source is matched
};

struct IcpSums {
  double information[36] = {};  // sum of w J^T Omega J, row-major; right perturbation (rotation, translation)
  double gradient[6] = {};      // sum of w J^T Omega r
  double cost = 0.0;            // sum of rho
  double weight = 0.0;          // sum of w
  double square = 0.0;          // sum of w r^2, r the residual's length [m^2]
  double whitened = 0.0;        // sum of w r^T Omega r
  int64_t matches = 0;
};

// One match: where, along which normal, and how well it fits.
struct IcpMatch {
  double point[3];   // the source's element, its own frame [m]
  double normal[3];  // of the target's plane, in the source's axes; zero where it has none
  double residual;   // signed across a plane, else a length [m]
  double distance;   // between the partners [m]
  double weight;     // of the kernel
  double variance;   // of the residual [m^2]
  double tilt;       // variance of the normal's direction [rad^2]
  double source, target;  // which elements
};

// `T` takes the source to the target (row-major 4x4). `hints` holds one guess an element that is matched and receives the
// partners found; any guess gives the same result. With `keep` the guesses are the partners, unasked.
IcpSums icp_sums(const SurfaceCloud& target, size_t target_level, const SurfaceCloud& source, size_t source_level,
                 const double* T, const IcpSettings& settings, std::vector<uint32_t>* hints, bool keep, int threads);

std::vector<IcpMatch> icp_matches(const SurfaceCloud& target, size_t target_level, const SurfaceCloud& source,
                                  size_t source_level, const double* T, const IcpSettings& settings,
                                  const std::vector<uint32_t>& hints, int threads);

// The share of every stride-th element of `from`, brought by T into the frame of `to`, that has an element of `to`
// within `reach`.
double overlap_share(const SurfaceCloud& to, size_t to_level, const SurfaceCloud& from, size_t from_level,
                     const double* T, double reach, size_t stride, int threads);

}  // namespace heliograph
