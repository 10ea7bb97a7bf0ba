// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"
#include "cloud/deskew.hpp"
#include "cloud/downsample.hpp"

namespace heliograph {

namespace {

auto deskew_points(const Points& points, const Offsets& offsets, const Stamps& times, const Rotations& R,
                   const Vectors& p, const Matrix4& T_body_lidar, int threads) {
  if (offsets.size() != points.shape(0)) throw std::invalid_argument("one offset a point is needed");
  if (times.size() == 0 || R.shape(0) != times.size() || p.shape(0) != times.size())
    throw std::invalid_argument("the path needs one rotation and one position a time, and at least one");
  const size_t count = points.shape(0);
  std::vector<float> out;
  {
    nb::gil_scoped_release release;
    out = deskew(span_of(points), span_of(offsets), {span_of(times), R.data(), p.data()}, T_body_lidar.data(), threads);
  }
  return to_numpy<float>(std::move(out), {count, 3});
}

auto downsample(const Points& points, float leaf) {
  std::vector<int32_t> kept;
  {
    nb::gil_scoped_release release;
    kept = voxel_downsample(span_of(points), leaf);
  }
  const size_t count = kept.size();
  return to_numpy<int32_t>(std::move(kept), {count});
}

auto gate(const Points& points, float min_range, float max_range) {
  std::vector<int32_t> kept;
  {
    nb::gil_scoped_release release;
    kept = range_gate(span_of(points), min_range, max_range);
  }
  const size_t count = kept.size();
  return to_numpy<int32_t>(std::move(kept), {count});
}

}  // namespace

void bind_cloud(nb::module_& m) {
  using namespace nb::literals;
  m.def("deskew", &deskew_points, "points"_a.noconvert(), "offsets_ns"_a.noconvert(), "times_ns"_a.noconvert(),
        "R_ref_body"_a.noconvert(), "p_ref_body"_a.noconvert(), "T_body_lidar"_a.noconvert(), "threads"_a);
  m.def("voxel_downsample", &downsample, "points"_a.noconvert(), "leaf"_a);
  m.def("range_gate", &gate, "points"_a.noconvert(), "min_range"_a, "max_range"_a);
}

}  // namespace heliograph
