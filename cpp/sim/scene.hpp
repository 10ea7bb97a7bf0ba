// SPDX-License-Identifier: MIT
// A static world of rectangles, boxes and cylinders, indexed for nearest-hit queries.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "sim/primitive.hpp"

namespace heliograph::sim {

struct Hit {
  double range = 0.0;        // [m]; 0 where nothing was hit
  float brightness = 0.0F;   // reflectivity times the cosine of incidence
  std::int32_t id = -1;      // index of the primitive
};

// Nearest-hit queries through a bounding volume hierarchy with four children a node, whose boxes are tested together
// in single precision; they are widened by a 100 000th of the scene's extent, so that rounding loses no hit of a ray
// from within ten times that extent. Ties go to the lower index, so that the answer does not depend on the tree or on
// the order of the queries.
class Scene {
 public:
  explicit Scene(std::vector<Primitive> primitives);

  std::size_t size() const { return primitives_.size(); }

  // `hint` is a primitive to try first (the neighbouring ray's); any value gives the same answer.
  Hit nearest(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction, double min_range, double max_range,
              std::int32_t hint = -1) const;

 private:
  // Lanes of the four children: `bound[0]` their low corners, `bound[1]` their high ones, by axis. A child >= 0 is a
  // node, a child < 0 the primitive ~child; an unused lane has an empty box.
  struct Node {
    std::array<std::array<Eigen::Array4f, 3>, 2> bound;
    std::array<std::int32_t, 4> child;
  };

  std::vector<Primitive> primitives_;
  std::vector<Node> nodes_;  // the root is the first
};

}  // namespace heliograph::sim
