// SPDX-License-Identifier: MIT
// Ceres on one pose graph: pose_graph GRAPH.g2o OUT.txt lm|dl [--cold]. Residuals are those of the other programs,
// Log(Z^-1 Xi^-1 Xj) whitened by the root of the information, differentiated automatically. The start is in the file; its
// first pose is held. OUT has one pose a line: x y theta, or x y z qx qy qz qw. Prints one JSON object.
#include <ceres/ceres.h>
#include <ceres/version.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <cstdio>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <unordered_map>
#include <vector>

namespace {

struct Edge {
  size_t i, j;
  std::vector<double> relative;
  Eigen::MatrixXd root;  // upper triangular, in the order of the file: translation, rotation
};

struct Graph {
  int width = 0;  // numbers of a pose
  std::vector<std::vector<double>> poses;
  std::vector<Edge> edges;
};

std::vector<double> numbers(std::istream& in, int count) {
  std::vector<double> out(static_cast<size_t>(count));
  for (double& x : out) in >> x;
  return out;
}

Graph read(const char* path) {
  Graph graph;
  std::unordered_map<long, size_t> index;
  std::ifstream file(path);
  for (std::string line, tag; std::getline(file, line);) {
    std::istringstream in(line);
    if (!(in >> tag)) continue;
    graph.width = tag.find("SE2") != std::string::npos ? 3 : 7;
    const int d = graph.width == 3 ? 3 : 6;
    long i = 0, j = 0;
    in >> i;
    if (tag.rfind("VERTEX", 0) == 0) {
      index.emplace(i, graph.poses.size());
      graph.poses.push_back(numbers(in, graph.width));
      continue;
    }
    in >> j;
    Edge edge{index.at(i), index.at(j), numbers(in, graph.width), Eigen::MatrixXd(d, d)};
    for (int a = 0; a < d; ++a)
      for (int b = a; b < d; ++b) {
        in >> edge.root(a, b);
        edge.root(b, a) = edge.root(a, b);
      }
    edge.root = Eigen::MatrixXd(edge.root.llt().matrixU());
    graph.edges.push_back(std::move(edge));
  }
  return graph;
}

// x / tan(x), at zero too.
template <typename T>
T x_over_tan(const T& x) {
  using std::tan;
  if (x * x < T(1e-8)) return T(1.0) - x * x / T(3.0);
  return x / tan(x);
}

struct Planar {
  const Edge* edge;
  template <typename T>
  bool operator()(const T* a, const T* b, T* residual) const {
    using std::atan2;
    using std::cos;
    using std::sin;
    const double* z = edge->relative.data();
    const T dx = b[0] - a[0], dy = b[1] - a[1], ca = cos(a[2]), sa = sin(a[2]);
    const T px = ca * dx + sa * dy - z[0], py = -sa * dx + ca * dy - z[1];
    const double cz = std::cos(z[2]), sz = std::sin(z[2]);
    const T turn = b[2] - a[2] - z[2], theta = atan2(sin(turn), cos(turn));
    const T tx = cz * px + sz * py, ty = -sz * px + cz * py, half = T(0.5) * theta, along = x_over_tan(half);
    const Eigen::Matrix<T, 3, 1> log(along * tx + half * ty, along * ty - half * tx, theta);
    Eigen::Map<Eigen::Matrix<T, 3, 1>> out(residual);
    out = edge->root.template cast<T>() * log;
    return true;
  }
};

struct Spatial {
  const Edge* edge;
  template <typename T>
  bool operator()(const T* pa, const T* qa, const T* pb, const T* qb, T* residual) const {
    using std::atan2;
    using std::sqrt;
    using Vector = Eigen::Matrix<T, 3, 1>;
    const double* z = edge->relative.data();
    const Eigen::Quaterniond q_z = Eigen::Quaterniond(z[6], z[3], z[4], z[5]).normalized();
    const Eigen::Quaternion<T> inverse = q_z.conjugate().cast<T>();
    const Eigen::Map<const Eigen::Quaternion<T>> q_a(qa), q_b(qb);
    const Eigen::Map<const Vector> p_a(pa), p_b(pb);
    const Vector t = inverse * (q_a.conjugate() * (p_b - p_a) - Eigen::Vector3d(z[0], z[1], z[2]).cast<T>());
    Eigen::Quaternion<T> q = inverse * (q_a.conjugate() * q_b);
    if (q.w() < T(0.0)) q.coeffs() = -q.coeffs();
    const T squared = q.vec().squaredNorm();
    Vector phi = T(2.0) * q.vec();
    T factor = T(1.0 / 12.0);
    if (squared > T(1e-12)) {
      const T sine = sqrt(squared), half = atan2(sine, q.w());
      phi = q.vec() * (T(2.0) * half / sine);
      factor = (T(1.0) - x_over_tan(half)) / (T(4.0) * half * half);
    }
    const Vector cross = phi.cross(t);
    Eigen::Matrix<T, 6, 1> log;
    log << t - T(0.5) * cross + factor * phi.cross(cross), phi;
    Eigen::Map<Eigen::Matrix<T, 6, 1>> out(residual);
    out = edge->root.template cast<T>() * log;
    return true;
  }
};

ceres::Solver::Summary solve(const Graph& graph, std::vector<std::vector<double>>* poses, bool dogleg) {
  ceres::Problem problem;
  for (const Edge& edge : graph.edges) {
    double *a = (*poses)[edge.i].data(), *b = (*poses)[edge.j].data();
    if (graph.width == 3)
      problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Planar, 3, 3, 3>(new Planar{&edge}), nullptr, a, b);
    else
      problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Spatial, 6, 3, 4, 3, 4>(new Spatial{&edge}), nullptr, a, a + 3, b,
                               b + 3);
  }
  if (graph.width == 7)
    for (auto& pose : *poses) problem.SetManifold(pose.data() + 3, new ceres::EigenQuaternionManifold);
  problem.SetParameterBlockConstant(poses->front().data());
  if (graph.width == 7) problem.SetParameterBlockConstant(poses->front().data() + 3);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  options.sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  options.trust_region_strategy_type = dogleg ? ceres::DOGLEG : ceres::LEVENBERG_MARQUARDT;
  options.function_tolerance = 1e-5;
  options.max_num_iterations = 100;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return summary;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) return std::fprintf(stderr, "usage: pose_graph GRAPH.g2o OUT.txt lm|dl [--cold]\n"), 2;
  const Graph graph = read(argv[1]);
  const bool dogleg = std::string(argv[3]) == "dl", cold = argc > 4;
  std::vector<std::vector<double>> poses = graph.poses;
  if (!cold) solve(graph, &poses, dogleg);
  poses = graph.poses;
  const ceres::Solver::Summary summary = solve(graph, &poses, dogleg);
  if (std::FILE* out = std::fopen(argv[2], "w")) {
    for (const auto& pose : poses)
      for (size_t k = 0; k < pose.size(); ++k) std::fprintf(out, "%.17g%c", pose[k], k + 1 == pose.size() ? '\n' : ' ');
    std::fclose(out);
  }
  std::printf("{\"seconds\": %.9f, \"iterations\": %zu, \"version\": \"%s\"}\n", summary.total_time_in_seconds,
              summary.iterations.size() - 1, CERES_VERSION_STRING);
}
