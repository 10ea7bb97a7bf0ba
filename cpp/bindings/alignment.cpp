// SPDX-License-Identifier: MIT
// Registration of two clouds: prepared clouds and what is asked of two of them.
#include "bindings/bindings.hpp"
#include "registration/features.hpp"
#include "registration/icp.hpp"
#include "registration/range_image.hpp"

namespace heliograph {

namespace {

IcpSettings icp_settings(int residual, bool by_cube, double gate, double kernel, double sigma, double min_cosine,
                         bool one_sided, size_t stride) {
  if (residual < 0 || residual > 3) throw std::invalid_argument("residual must be 0 to 3");
  if (!(gate > 0.0) || !(sigma > 0.0)) throw std::invalid_argument("gate and sigma must be positive");
  return {static_cast<Residual>(residual), by_cube, gate, kernel, sigma, min_cosine, one_sided, stride};
}

void check_level(const SurfaceCloud& cloud, size_t level) {
  if (level >= cloud.levels()) throw std::invalid_argument("the cloud has no such level");
}

// What a pair is matched with: the clouds at one level each, kept between iterations with the partners found last.
class Matcher {
 public:
  static constexpr size_t kColumns = 13;

  Matcher(SurfaceCloud& target, size_t target_level, const SurfaceCloud& source, size_t source_level, size_t stride)
      : target_(target), source_(source), target_level_(target_level), source_level_(source_level), stride_(stride) {
    check_level(target, target_level);
    check_level(source, source_level);
    if (stride < 1) throw std::invalid_argument("stride must be positive");
  }

  Tuple sums(const Matrix4& T, int residual, bool by_cube, double gate, double kernel, double sigma, double min_cosine,
             bool one_sided, bool keep, int threads) {
    const IcpSettings settings = icp_settings(residual, by_cube, gate, kernel, sigma, min_cosine, one_sided, stride_);
    if (keep && hints_.empty()) throw std::invalid_argument("there are no partners to keep yet");
    const IcpSums s = unlocked([&] {
      if (!by_cube) target_.tree(target_level_);
      return icp_sums(target_, target_level_, source_, source_level_, T.data(), settings, &hints_, keep, threads);
    });
    return Tuple(nb::make_tuple(to_numpy<double>({s.information, s.information + 36}, {6, 6}),
                                to_numpy<double>({s.gradient, s.gradient + 6}, {6}), s.cost, s.weight, s.square,
                                s.whitened, s.matches));
  }

  auto matches(const Matrix4& T, int residual, bool by_cube, double gate, double kernel, double sigma, double min_cosine,
               bool one_sided, int threads) {
    const IcpSettings settings = icp_settings(residual, by_cube, gate, kernel, sigma, min_cosine, one_sided, stride_);
    const std::vector<IcpMatch> m = unlocked([&] {
      if (!by_cube) target_.tree(target_level_);
      return icp_matches(target_, target_level_, source_, source_level_, T.data(), settings, hints_, threads);
    });
    std::vector<double> rows;
    rows.reserve(kColumns * m.size());
    for (const IcpMatch& match : m) {
      for (const double* v : {match.point, match.normal}) rows.insert(rows.end(), v, v + 3);
      for (const double x : {match.residual, match.distance, match.weight, match.variance, match.tilt, match.source, match.target})
        rows.push_back(x);
    }
    return to_numpy<double>(std::move(rows), {m.size(), kColumns});
  }

 private:
  SurfaceCloud& target_;
  const SurfaceCloud& source_;
  size_t target_level_, source_level_, stride_;
  std::vector<uint32_t> hints_;
};

Tuple elements(const SurfaceCloud& cloud, size_t at) {
  check_level(cloud, at);
  const auto& some = cloud.level(at).elements;
  const size_t n = some.size();
  std::vector<float> mean, centre, axes, values, count, support;
  std::vector<uint8_t> shape;
  for (const SurfaceElement& e : some) {
    mean.insert(mean.end(), e.mean, e.mean + 3);
    centre.insert(centre.end(), e.centre, e.centre + 3);
    axes.insert(axes.end(), e.axes, e.axes + 9);
    values.insert(values.end(), e.values, e.values + 3);
    count.push_back(e.count);
    support.push_back(e.support);
    shape.push_back(static_cast<uint8_t>(e.shape));
  }
  return Tuple(nb::make_tuple(to_numpy<float>(std::move(mean), {n, 3}), to_numpy<float>(std::move(centre), {n, 3}),
                              to_numpy<float>(std::move(axes), {n, 3, 3}), to_numpy<float>(std::move(values), {n, 3}),
                              to_numpy<float>(std::move(count), {n}), to_numpy<float>(std::move(support), {n}),
                              to_numpy<uint8_t>(std::move(shape), {n})));
}

Tuple sets_of(const Points& p, const Points& q, const Points& normal_p, const Points& normal_q, double tolerance,
                 double max_angle, size_t seeds, int threads) {
  const size_t n = p.shape(0);
  if (q.shape(0) != n || normal_p.shape(0) != n || normal_q.shape(0) != n)
    throw std::invalid_argument("p, q and their normals differ in length");
  std::vector<std::vector<uint32_t>> sets = unlocked([&] {
    std::vector<PlacePair> pairs(n);
    for (size_t i = 0; i < n; ++i)
      for (size_t k = 0; k < 3; ++k) {
        pairs[i].p[k] = p.data()[3 * i + k];
        pairs[i].q[k] = q.data()[3 * i + k];
        pairs[i].normal_p[k] = normal_p.data()[3 * i + k];
        pairs[i].normal_q[k] = normal_q.data()[3 * i + k];
      }
    return consistent_sets(pairs, tolerance, max_angle, seeds, threads);
  });
  nb::list out;
  for (auto& set : sets) {
    const size_t m = set.size();
    out.append(to_numpy<uint32_t>(std::move(set), {m}));
  }
  return Tuple(nb::tuple(out));
}

void bind_surface_cloud(nb::module_& m) {
  using namespace nb::literals;
  nb::class_<SurfaceCloud>(m, "SurfaceCloud")
      .def("__init__",
           [](SurfaceCloud* self, const Points& points, double voxel, int levels, double max_thickness, int min_support,
              int threads) {
             if (levels < 1 || levels > 8) throw std::invalid_argument("levels must be 1 to 8");
             unlocked([&] { new (self) SurfaceCloud(span_of(points), {voxel, levels, max_thickness, min_support}, threads); });
           },
           "points"_a.noconvert(), "voxel"_a, "levels"_a, "max_thickness"_a, "min_support"_a, "threads"_a)
      .def("levels", &SurfaceCloud::levels)
      .def("finite", &SurfaceCloud::finite)
      .def("size", [](const SurfaceCloud& cloud, size_t level) { check_level(cloud, level); return cloud.level(level).elements.size(); }, "level"_a)
      .def("extent", [](const SurfaceCloud& cloud, size_t level) { check_level(cloud, level); return cloud.extent(level); }, "level"_a)
      .def("spread",
           [](const SurfaceCloud& cloud, size_t level) {
             check_level(cloud, level);
             std::vector<double> sigmas(3);
             cloud.spread(level, sigmas.data());
             return to_numpy<double>(std::move(sigmas), {3});
           },
           "level"_a)
      .def("source", [](const SurfaceCloud& cloud) {
             std::vector<uint32_t> index = cloud.source();
             const size_t n = index.size();
             return to_numpy<uint32_t>(std::move(index), {n});
           })
      .def("elements", &elements, "level"_a)
      .def("overlap",
           [](SurfaceCloud& to, size_t level, const SurfaceCloud& from, size_t from_level, const Matrix4& T, double reach, int threads,
              size_t stride) {
             check_level(to, level);
             check_level(from, from_level);
             if (stride < 1) throw std::invalid_argument("stride must be positive");
             return unlocked([&] {
               to.tree(level);
               return overlap_share(to, level, from, from_level, T.data(), reach, stride, threads);
             });
           },
           "level"_a, "source"_a, "source_level"_a, "T"_a.noconvert(), "reach"_a, "threads"_a, "stride"_a = 1);
}

void bind_range_image(nb::module_& m) {
  using namespace nb::literals;
  nb::class_<RangeImage>(m, "RangeImage")
      .def("__init__",
           [](RangeImage* self, const Points& points, double cell) {
             if (!(cell >= 1e-3 && cell <= 1.0)) throw std::invalid_argument("cell must be 0.001 to 1 rad");
             unlocked([&] { new (self) RangeImage(span_of(points), cell); });
           },
           "points"_a.noconvert(), "cell"_a)
      .def("sight",
           [](const RangeImage& image, SurfaceCloud& to, const SurfaceCloud& from, size_t level, const Matrix4& T,
              double reach, int threads) {
             check_level(to, level);
             check_level(from, level);
             const Sighting s = unlocked([&] {
               to.tree(level);
               return image.sight(to, from, level, T.data(), reach, threads);
             });
             return Tuple(nb::make_tuple(s.near, s.expected, s.through));
           },
           "target"_a, "source"_a, "level"_a, "T"_a.noconvert(), "reach"_a, "threads"_a);
}

}  // namespace

void bind_alignment(nb::module_& m) {
  using namespace nb::literals;
  bind_surface_cloud(m);
  bind_range_image(m);
  using Features = Array<const float, nb::shape<-1, kFeature>>;
  m.def("point_features",
        [](SurfaceCloud& cloud, size_t level, double radius, int threads) {
          check_level(cloud, level);
          std::vector<float> out = unlocked([&] { return point_features(cloud, level, radius, threads); });
          const size_t n = out.size() / kFeature;
          return to_numpy<float>(std::move(out), {n, kFeature});
        },
        "cloud"_a, "level"_a, "radius"_a, "threads"_a);
  m.def("nearest_features",
        [](const Features& a, const Features& b, size_t count, int threads) {
          std::vector<int32_t> out = unlocked([&] { return nearest_features(span_of(a), span_of(b), count, threads); });
          return to_numpy<int32_t>(std::move(out), {a.shape(0), count});
        },
        "a"_a.noconvert(), "b"_a.noconvert(), "count"_a, "threads"_a);
  m.def("consistent_sets", &sets_of, "p"_a.noconvert(), "q"_a.noconvert(), "normal_p"_a.noconvert(),
        "normal_q"_a.noconvert(), "tolerance"_a, "max_angle"_a, "seeds"_a, "threads"_a);
  nb::class_<Matcher>(m, "Matcher")
      .def(nb::init<SurfaceCloud&, size_t, const SurfaceCloud&, size_t, size_t>(), "target"_a, "target_level"_a, "source"_a,
           "source_level"_a, "stride"_a = 1, nb::keep_alive<1, 2>(), nb::keep_alive<1, 4>())
      .def("sums", &Matcher::sums, "T"_a.noconvert(), "residual"_a, "by_cube"_a, "gate"_a, "kernel"_a, "sigma"_a,
           "min_cosine"_a, "one_sided"_a, "keep"_a, "threads"_a)
      .def("matches", &Matcher::matches, "T"_a.noconvert(), "residual"_a, "by_cube"_a, "gate"_a, "kernel"_a, "sigma"_a,
           "min_cosine"_a, "one_sided"_a, "threads"_a);
}

}  // namespace heliograph
