// SPDX-License-Identifier: MIT
// A state as Python's bytes, and back.
#pragma once
#include <nanobind/nanobind.h>

#include <cstdint>
#include <span>
#include <vector>

namespace heliograph {

inline nanobind::bytes to_bytes(const std::vector<uint8_t>& state) {
  return nanobind::bytes(reinterpret_cast<const char*>(state.data()), state.size());
}

inline std::span<const uint8_t> bytes_of(const nanobind::bytes& state) {
  return {reinterpret_cast<const uint8_t*>(state.c_str()), state.size()};
}

}  // namespace heliograph
