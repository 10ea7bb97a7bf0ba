// SPDX-License-Identifier: MIT
#include "tests/check.hpp"

int main() {
  check_alignment();
  check_cloud();
  check_graph_files();
  check_graph_ordering();
  check_graph_solver();
  check_graph_factors();
  check_graph_tree();
  check_forged_tree();
  check_imu();
  check_io();
  check_maps();
  check_registration();
  check_sim();
  check_util();
  std::puts("all native checks passed");
  return 0;
}
