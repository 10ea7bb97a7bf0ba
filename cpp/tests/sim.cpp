// SPDX-License-Identifier: MIT
#include <random>

#include "sim/raycast.hpp"
#include "tests/check.hpp"

namespace {

using heliograph::sim::Hit;
using heliograph::sim::Primitive;
using heliograph::sim::Scene;
using heliograph::sim::Shape;
using Eigen::Vector3d;

Primitive make(Shape shape, const Vector3d& center, const Vector3d& half) {
  return {.R_world_local = Eigen::Matrix3d::Identity(),
          .center = center,
          .half = half,
          .shape = shape,
          .reflectivity = 0.5,
          .contrast = 0.0,
          .period = 1.0};
}

void check_single_primitives() {
  const Scene box({make(Shape::box, {5, 0, 0}, {1, 1, 1})});
  CHECK_NEAR(box.nearest(Vector3d::Zero(), Vector3d::UnitX(), 0.0, 100.0).range, 4.0, 1e-12);
  CHECK_NEAR(box.nearest(Vector3d::Zero(), Vector3d::UnitX(), 4.5, 100.0).range, 6.0, 1e-12);
  CHECK(box.nearest(Vector3d::Zero(), Vector3d::UnitX(), 0.0, 3.0).id == -1);
  CHECK(box.nearest(Vector3d::Zero(), Vector3d::UnitY(), 0.0, 100.0).id == -1);
  CHECK(box.nearest(Vector3d::Zero(), -Vector3d::UnitX(), 0.0, 100.0).id == -1);

  const Scene floor({make(Shape::rectangle, {0, 0, -2}, {3, 3, 0})});
  const Hit below = floor.nearest(Vector3d::Zero(), Vector3d(1, 0, -1).normalized(), 0.0, 100.0);
  CHECK_NEAR(below.range, 2.0 * std::sqrt(2.0), 1e-12);
  CHECK_NEAR(below.brightness, 0.5 / std::sqrt(2.0), 1e-6);
  CHECK(floor.nearest(Vector3d::Zero(), Vector3d::UnitX(), 0.0, 100.0).id == -1);  // parallel to it

  const Scene pillar({make(Shape::cylinder, {4, 0, 0}, {0.5, 0.5, 2})});
  CHECK_NEAR(pillar.nearest(Vector3d::Zero(), Vector3d::UnitX(), 0.0, 100.0).range, 3.5, 1e-12);
  CHECK_NEAR(pillar.nearest({4, 0, 5}, -Vector3d::UnitZ(), 0.0, 100.0).range, 3.0, 1e-12);
  CHECK_NEAR(pillar.nearest({4, 0, 0}, Vector3d::UnitY(), 0.0, 100.0).range, 0.5, 1e-12);  // from inside
}

// The hierarchy against trying each primitive alone.
void check_hierarchy() {
  std::mt19937_64 engine(7);
  std::uniform_real_distribution<double> place(-10.0, 10.0), extent(0.1, 1.5);
  std::vector<Primitive> all;
  std::vector<Scene> alone;
  for (int i = 0; i < 80; ++i) {
    const Vector3d half(extent(engine), extent(engine), extent(engine));
    all.push_back(make(static_cast<Shape>(i % 3), {place(engine), place(engine), place(engine)}, half));
    alone.emplace_back(std::vector<Primitive>{all.back()});
  }
  const Scene scene(all);
  for (int k = 0; k < 500; ++k) {
    const Vector3d origin(place(engine), place(engine), place(engine));
    const Vector3d direction = Vector3d(place(engine), place(engine), place(engine)).normalized();
    Hit want;
    for (std::size_t i = 0; i < alone.size(); ++i) {
      Hit hit = alone[i].nearest(origin, direction, 0.1, 50.0);
      hit.id = hit.id < 0 ? -1 : static_cast<std::int32_t>(i);
      if (hit.id >= 0 && (want.id < 0 || hit.range < want.range)) want = hit;
    }
    for (const std::int32_t hint : {-1, 0, want.id, 79}) {
      const Hit got = scene.nearest(origin, direction, 0.1, 50.0, hint);
      CHECK(got.id == want.id);
      CHECK(got.range == want.range);
    }
  }
}

void check_sweep() {
  using heliograph::sim::Sweep;
  const Scene scene({make(Shape::box, {0, 0, 0}, {6, 5, 4})});
  constexpr std::size_t kRows = 3, kColumns = 7, kRays = kRows * kColumns;
  std::vector<double> directions, poses;
  for (std::size_t i = 0; i < kRays; ++i) directions.insert(directions.end(), {1.0, 0.0, 0.0});
  for (std::size_t c = 0; c < kColumns; ++c) {
    poses.insert(poses.end(), {1, 0, 0, 0.1 * static_cast<double>(c), 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1});
  }
  const Sweep sweep{.rows = kRows,
                    .columns = kColumns,
                    .directions = directions,
                    .T_world_sensor = poses,
                    .min_range = 0.0,
                    .max_range = 100.0};
  for (const int threads : {1, 2, 16}) {
    std::vector<double> range(kRays);
    std::vector<float> brightness(kRays);
    std::vector<std::int32_t> id(kRays);
    heliograph::sim::cast_sweep(scene, sweep, threads, range, brightness, id);
    for (std::size_t i = 0; i < kRays; ++i) {
      CHECK_NEAR(range[i], 6.0 - 0.1 * static_cast<double>(i % kColumns), 1e-12);
      CHECK(id[i] == 0);
    }
  }
  // Equal boxes: the deepest tree there can be, and every box is hit.
  const Scene equal(std::vector<Primitive>(2000, make(Shape::box, {5, 0, 0}, {1, 1, 1})));
  CHECK(equal.nearest(Vector3d::Zero(), Vector3d::UnitX(), 0.0, 100.0).id == 0);
  const Scene empty({});
  CHECK(empty.size() == 0);
  CHECK(empty.nearest(Vector3d::Zero(), Vector3d::UnitX(), 0.0, 100.0).id == -1);
}

}  // namespace

void check_sim() {
  check_single_primitives();
  check_hierarchy();
  check_sweep();
}
