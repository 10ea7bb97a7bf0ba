// SPDX-License-Identifier: MIT
// Numbers to bytes and back, for states that a later process goes on from: every read is checked against what is left.
#pragma once
#include <cmath>
#include <cstdint>
#include <cstring>
#include <span>
#include <stdexcept>
#include <type_traits>
#include <utility>
#include <vector>

namespace heliograph {

[[noreturn]] inline void damaged_state() { throw std::invalid_argument("the saved state is damaged or cut short"); }

class ByteWriter {
 public:
  template <typename T>
  void put(const T& value) {
    static_assert(std::is_arithmetic_v<T>);
    const auto* from = reinterpret_cast<const uint8_t*>(&value);
    bytes_.insert(bytes_.end(), from, from + sizeof(T));
  }
  template <typename T>
  void put_all(std::span<const T> values) {
    static_assert(std::is_arithmetic_v<T>);
    const auto* from = reinterpret_cast<const uint8_t*>(values.data());
    bytes_.insert(bytes_.end(), from, from + values.size_bytes());
  }
  std::vector<uint8_t> take() { return std::move(bytes_); }

 private:
  std::vector<uint8_t> bytes_;
};

class ByteReader {
 public:
  explicit ByteReader(std::span<const uint8_t> bytes) : bytes_(bytes) {}

  template <typename T>
  T get() {
    T value;
    get_all(std::span<T>(&value, 1));
    return value;
  }
  // Numbers that are not finite are in no state of ours.
  template <typename T>
  void get_all(std::span<T> values) {
    static_assert(std::is_arithmetic_v<T>);
    if (values.size_bytes() > bytes_.size()) damaged_state();
    if (!values.empty()) std::memcpy(values.data(), bytes_.data(), values.size_bytes());
    bytes_ = bytes_.subspan(values.size_bytes());
    if constexpr (std::is_floating_point_v<T>)
      for (const T value : values)
        if (!std::isfinite(value)) damaged_state();
  }
  // How many things of at least so many bytes each follow: no more memory is asked for than the bytes left allow.
  size_t count(size_t bytes_each) {
    const auto wide = get<uint64_t>();
    if (wide > bytes_.size() / bytes_each || wide > uint64_t{0xfffffffe}) damaged_state();
    return static_cast<size_t>(wide);
  }
  void expect_end() const {
    if (!bytes_.empty()) damaged_state();
  }

 private:
  std::span<const uint8_t> bytes_;
};

}  // namespace heliograph
