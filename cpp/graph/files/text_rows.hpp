// SPDX-License-Identifier: MIT
// Files of one record a line, "TAG number number ...": read into arrays and written back, every digit kept.
#pragma once
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace heliograph {

inline constexpr int64_t kNoInteger = INT64_MIN;

// A word that is not a number; `line` 0 means that there is none.
struct BadWord {
  int64_t line = 0;
  int64_t begin = 0, end = 0;  // byte range
};

struct TextRows {
  std::vector<int32_t> tag;      // (L) index into the known tags, -1: not one of them, its numbers are not read
  std::vector<int64_t> line;     // (L) number of the line, from 1
  std::vector<int64_t> range;    // (L, 2) bytes that the line takes, without spaces around it
  std::vector<int64_t> integer;  // (L, 2) its first two words where they are whole numbers of 64 bits, else kNoInteger
  std::vector<int64_t> first;    // (L + 1) where its numbers begin
  std::vector<double> number;    // all words of known lines after the tag
  BadWord bad;                   // the first one; reading ends there
};

// Lines with nothing but spaces are skipped.
TextRows read_rows(std::string_view text, std::span<const std::string> tags);

// One line a row: the tag, `integers` (rows, ids), then `numbers` (rows, columns) in the fewest digits that read back
// to the same bits. `offset` (rows + 1) receives where each line begins in the result.
std::string format_rows(std::string_view tag, std::span<const int64_t> integers, std::span<const double> numbers, size_t rows,
                        std::vector<int64_t>* offset);

}  // namespace heliograph
