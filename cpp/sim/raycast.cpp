// SPDX-License-Identifier: MIT
#include "sim/raycast.hpp"

#include <algorithm>
#include <thread>
#include <vector>

namespace heliograph::sim {

namespace {

using RowMatrix4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

}  // namespace

void cast_sweep(const Scene& scene, const Sweep& sweep, int threads, std::span<double> range,
                std::span<float> brightness, std::span<std::int32_t> id) {
  const auto cast_columns = [&](std::size_t begin, std::size_t end) {
    std::vector<std::int32_t> above(sweep.rows, -1);  // what each row hit in the previous column
    for (std::size_t column = begin; column < end; ++column) {
      const Eigen::Map<const RowMatrix4> T(sweep.T_world_sensor.data() + 16 * column);
      const Eigen::Matrix3d R = T.topLeftCorner<3, 3>();
      const Eigen::Vector3d origin = T.topRightCorner<3, 1>();
      for (std::size_t row = 0; row < sweep.rows; ++row) {
        const std::size_t i = row * sweep.columns + column;
        const Eigen::Map<const Eigen::Vector3d> direction(sweep.directions.data() + 3 * i);
        const Hit hit = scene.nearest(origin, R * direction, sweep.min_range, sweep.max_range, above[row]);
        range[i] = hit.range;
        brightness[i] = hit.brightness;
        id[i] = above[row] = hit.id;
      }
    }
  };
  const auto workers = static_cast<std::size_t>(std::max(1, threads));
  std::vector<std::thread> pool;
  for (std::size_t w = 1; w < workers; ++w) {
    pool.emplace_back(cast_columns, sweep.columns * w / workers, sweep.columns * (w + 1) / workers);
  }
  cast_columns(0, sweep.columns / workers);
  for (std::thread& worker : pool) worker.join();
}

}  // namespace heliograph::sim
