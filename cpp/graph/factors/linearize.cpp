// SPDX-License-Identifier: MIT
#include <stdexcept>

#include "graph/factors/residual_kind.hpp"
#include "util/isa.hpp"

namespace heliograph {

namespace {

FactorKernels kernels_for(FactorType type) {
  const ResidualKind* brought = brought_residual(type);
#if defined(HELIOGRAPH_HAVE_AVX2)
  if (active_isa() == Isa::avx2) return brought == nullptr ? avx2_factor_kernels() : brought->avx2();
#endif
  return brought == nullptr ? baseline_factor_kernels() : brought->baseline();
}

int columns_of(const FactorGroup& group) {
  int columns = 0;
  for (int a = 0; a < group.arity; ++a) columns += group.dof[static_cast<size_t>(a)];
  return columns;
}

const double* data_or_null(const std::vector<double>& values) { return values.empty() ? nullptr : values.data(); }

FactorView view_of(const FactorGroup& group, const double* x, std::vector<double>* scratch) {
  scratch->resize(scratch_size(group.rows, columns_of(group)));
  FactorView view{};
  view.type = group.type;
  view.arity = group.arity;
  view.rows = group.rows;
  for (size_t a = 0; a < static_cast<size_t>(group.arity); ++a) {
    view.manifold[a] = group.manifold[a];
    view.dof[a] = group.dof[a];
    view.jacobian[a] = group.jacobian[a].data();
  }
  view.values = group.values.data();
  view.x = x;
  view.measurement_size = group.measurement_size;
  view.measurement = group.measurement.data();
  view.noise = group.noise;
  view.shared_noise = group.shared_noise;
  view.sqrt_information = group.sqrt_information.data();
  view.kernel = group.kernel;
  view.kernel_width = group.kernel_width;
  view.weight = data_or_null(group.weight);
  view.shift = data_or_null(group.shift);
  view.residual = group.residual.data();
  view.scratch = scratch->data();
  return view;
}

void require(bool known) {
  if (!known) throw std::invalid_argument("no residual is known for this factor type and its families");
}

}  // namespace

GroupCost linearize_group(const FactorGroup& group, size_t begin, size_t end, const double* x, double* blocks) {
  std::vector<double> scratch;
  GroupCost sum;
  require(kernels_for(group.type).linearize(view_of(group, x, &scratch), begin, end, blocks, &sum));
  return sum;
}

GroupCost cost_of_group(const FactorGroup& group, size_t begin, size_t end, const double* x) {
  std::vector<double> scratch;
  GroupCost sum;
  require(kernels_for(group.type).cost(view_of(group, x, &scratch), begin, end, &sum));
  return sum;
}

void residuals_of_group(const FactorGroup& group, size_t begin, size_t end, const double* x, double* residual,
                        double* squared) {
  std::vector<double> scratch;
  const FactorView view = view_of(group, x, &scratch);
  const FactorKernels kernel = kernels_for(group.type);
  require(kernel.evaluate(view, begin, end, residual, nullptr));
  for (size_t k = begin; k < end; ++k) {
    GroupCost sum;
    kernel.cost(view, k, k + 1, &sum);
    squared[k - begin] = sum.chi2;
  }
}

void jacobians_of_group(const FactorGroup& group, size_t begin, size_t end, const double* x, double* const* jacobian) {
  std::vector<double> scratch;
  const auto rows = static_cast<size_t>(group.rows), columns = static_cast<size_t>(columns_of(group));
  std::vector<double> residual((end - begin) * rows), all((end - begin) * rows * columns);
  require(kernels_for(group.type).evaluate(view_of(group, x, &scratch), begin, end, residual.data(), all.data()));
  const double* row = all.data();
  for (size_t i = 0; i < (end - begin) * rows; ++i) {
    for (size_t a = 0; a < static_cast<size_t>(group.arity); ++a) {
      const auto dof = static_cast<size_t>(group.dof[a]);
      for (size_t q = 0; q < dof; ++q) jacobian[a][i * dof + q] = *row++;
    }
  }
}

}  // namespace heliograph
