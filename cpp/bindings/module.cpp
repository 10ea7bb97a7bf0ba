// SPDX-License-Identifier: MIT
// The Python module: arrays in, arrays out. One file a room; this one only gathers them.
#include "bindings/bindings.hpp"
#include "util/isa.hpp"

NB_MODULE(_core, m) {
  m.doc() = "Native kernels of Heliograph; private, wrapped by the Python rooms.";
  nanobind::set_leak_warnings(false);  // an object that a live thread still holds when the interpreter ends is no leak
  m.def("instruction_set", [] { return heliograph::isa_name(heliograph::active_isa()); });
  heliograph::bind_alignment(m);
  heliograph::bind_cloud(m);
  heliograph::bind_features(m);
  heliograph::bind_global_maps(m);
  heliograph::bind_graph_problem(m);
  heliograph::bind_graph_diagnosis(m);
  heliograph::bind_graph_files(m);
  heliograph::bind_graph_ordering(m);
  nanobind::module_ testing = m.def_submodule("testing", "What only tests call: factors and retractions one kind at a time.");
  heliograph::bind_graph_retraction(testing);
  heliograph::bind_graph_factors(testing);
  heliograph::bind_graph_factors(m);
  heliograph::bind_graph_tree(m);
  heliograph::bind_imu(m);
  heliograph::bind_io(m);
  heliograph::bind_kd_trees(m);
  heliograph::bind_lie(m);
  heliograph::bind_maps(m);
  heliograph::bind_registration(m);
  heliograph::bind_sim(m);
}
