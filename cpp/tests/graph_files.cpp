// SPDX-License-Identifier: MIT
#include <array>
#include <limits>
#include <string>
#include <vector>

#include "graph/problem/spanning_start.hpp"
#include "graph/files/text_rows.hpp"
#include "tests/check.hpp"

namespace {

using namespace heliograph;

void check_rows_read() {
  const std::vector<std::string> tags{"A", "BB"};
  const TextRows rows = read_rows("A 1 2.5\r\n\n  # A 3\nBB +7 9223372036854775807 1e-400 -0 \nA", tags);
  CHECK(rows.bad.line == 0);
  CHECK((rows.tag == std::vector<int32_t>{0, -1, 1, 0}));
  CHECK((rows.line == std::vector<int64_t>{1, 3, 4, 5}));
  CHECK((rows.first == std::vector<int64_t>{0, 2, 2, 6, 6}));
  CHECK(rows.integer[0] == 1 && rows.integer[1] == kNoInteger);
  CHECK(rows.integer[5] == std::numeric_limits<int64_t>::max());
  CHECK(rows.number[4] == 0.0 && std::signbit(rows.number[5]));
  CHECK(read_rows("", tags).tag.empty());
  CHECK(read_rows(" \n\t", tags).tag.empty());
  for (const char* bad : {"A 1 x", "A 1 0x", "A +-1", "A 1.2.3", "A ++1", "A +", "A -", "A 1e"}) CHECK(read_rows(bad, tags).bad.line == 1);
}

void check_rows_come_back() {
  const std::vector<int64_t> ids{1, -2};
  const std::vector<double> numbers{0.1, 5e-324, -1.7976931348623157e308, 1.0 / 3.0};
  std::vector<int64_t> offset;
  const std::string text = format_rows("T", ids, numbers, 2, &offset);
  CHECK(offset.size() == 3 && offset[2] == static_cast<int64_t>(text.size()));
  const TextRows rows = read_rows(text, std::vector<std::string>{"T"});
  CHECK((rows.number == std::vector<double>{1, 0.1, 5e-324, -2, -1.7976931348623157e308, 1.0 / 3.0}));
  CHECK(format_rows("T", {}, {}, 0, &offset).empty() && offset.size() == 1);
}

void check_spanning_start() {
  const std::array<double, 9> ahead{1, 0, 1, 0, 1, 0, 0, 0, 1};
  std::vector<double> relative;
  for (int e = 0; e < 3; ++e) relative.insert(relative.end(), ahead.begin(), ahead.end());
  const std::vector<int32_t> i{0, 2, 4}, j{1, 1, 4};  // the last joins a pose with itself
  const SpanningStart start = spanning_start(2, 5, i, j, relative);
  CHECK((start.root == std::vector<int32_t>{0, 0, 0, 3, 4}));
  CHECK((start.parent == std::vector<int32_t>{0, 0, 1, 3, 4}));
  CHECK(start.pose[9 + 2] == 1.0 && start.pose[18 + 2] == 0.0);
  CHECK(spanning_start(3, 0, {}, {}, {}).root.empty());
}

}  // namespace

void check_graph_files() {
  check_rows_read();
  check_rows_come_back();
  check_spanning_start();
}
