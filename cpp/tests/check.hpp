// SPDX-License-Identifier: MIT
// Assert-style checks for the sanitizer build; no framework.
#pragma once
#include <cmath>
#include <cstdio>
#include <cstdlib>

#define CHECK(condition)                                                        \
  do {                                                                          \
    if (!(condition)) {                                                         \
      std::fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition);      \
      std::exit(1);                                                             \
    }                                                                           \
  } while (false)

#define CHECK_NEAR(a, b, tolerance) CHECK(std::abs((a) - (b)) <= (tolerance))

// One function a room; main.cpp calls them all.
void check_alignment();
void check_cloud();
void check_forged_tree();
void check_graph_files();
void check_graph_ordering();
void check_graph_solver();
void check_graph_factors();
void check_graph_tree();
void check_imu();
void check_io();
void check_maps();
void check_registration();
void check_sim();
void check_util();
