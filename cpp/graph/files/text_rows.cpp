// SPDX-License-Identifier: MIT
#include "graph/files/text_rows.hpp"

#include <algorithm>
#include <charconv>
#include <cstdlib>

namespace heliograph {

namespace {

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; }

// The next word of [at, end), which moves behind it; empty at the end.
std::string_view next_word(const char*& at, const char* end) {
  while (at != end && is_space(*at)) ++at;
  const char* begin = at;
  while (at != end && !is_space(*at)) ++at;
  return {begin, static_cast<size_t>(at - begin)};
}

// std::from_chars takes no leading plus, and a number too small for a double is an error to it.
bool parse(std::string_view word, double* value) {
  const char* begin = word.data() + (word.size() > 1 && word[0] == '+' && word[1] != '-' ? 1 : 0);
  const char* end = word.data() + word.size();
  const auto [stop, error] = std::from_chars(begin, end, *value);
  if (error == std::errc::result_out_of_range && stop == end) {
    *value = std::strtod(std::string(word).c_str(), nullptr);
    return true;
  }
  return error == std::errc() && stop == end;
}

int64_t whole(std::string_view word) {
  int64_t value = 0;
  const char* end = word.data() + word.size();
  const auto [stop, error] = std::from_chars(word.data(), end, value);
  return error == std::errc() && stop == end ? value : kNoInteger;
}

// Neighbouring lines mostly have the same tag, so the last one is tried first.
int32_t index_of(std::string_view word, std::span<const std::string> tags, int32_t last) {
  if (last >= 0 && tags[static_cast<size_t>(last)] == word) return last;
  const auto found = std::find(tags.begin(), tags.end(), word);
  return found == tags.end() ? -1 : static_cast<int32_t>(found - tags.begin());
}

void begin_row(int32_t tag, int64_t line, const char* begin, const char* end, const char* text, TextRows* rows) {
  rows->tag.push_back(tag);
  rows->line.push_back(line);
  rows->range.insert(rows->range.end(), {begin - text, end - text});
  rows->integer.insert(rows->integer.end(), 2, kNoInteger);
  rows->first.push_back(static_cast<int64_t>(rows->number.size()));
}

bool is_comment(std::string_view word) {
  return word[0] == '#' || word[0] == '%' || word[0] == ';' || (word.size() > 1 && word[0] == '/' && word[1] == '/');
}

// Appends one line's numbers, and a row of its own for a comment behind them; false when a word is none.
bool read_line(const char* at, const char* end, const char* text, int64_t line, TextRows* rows) {
  const size_t row = rows->integer.size() - 2;
  for (int k = 0;; ++k) {
    const std::string_view word = next_word(at, end);
    if (word.empty()) return true;
    double value = 0.0;
    if (!parse(word, &value)) {
      if (is_comment(word)) {
        begin_row(-1, line, word.data(), end, text, rows);
        return true;
      }
      rows->bad = {line, word.data() - text, word.data() + word.size() - text};
      return false;
    }
    if (k < 2) rows->integer[row + static_cast<size_t>(k)] = whole(word);
    rows->number.push_back(value);
  }
}

}  // namespace

TextRows read_rows(std::string_view text, std::span<const std::string> tags) {
  TextRows rows;
  rows.number.reserve(text.size() / 8);
  const char* const begin = text.data();
  const char* const end = begin + text.size();
  int32_t last = -1;
  int64_t line = 0;
  for (const char* at = begin; at != end;) {
    const char* stop = std::find(at, end, '\n');
    const char* const next = stop == end ? end : stop + 1;
    ++line;
    while (stop != at && is_space(stop[-1])) --stop;
    while (at != stop && is_space(*at)) ++at;
    if (at != stop) {
      const char* word_end = at;
      const std::string_view word = next_word(word_end, stop);
      const int32_t tag = index_of(word, tags, last);
      if (tag >= 0) last = tag;
      begin_row(tag, line, at, stop, begin, &rows);
      if (tag >= 0 && !read_line(word_end, stop, begin, line, &rows)) break;
    }
    at = next;
  }
  rows.first.push_back(static_cast<int64_t>(rows.number.size()));
  return rows;
}

std::string format_rows(std::string_view tag, std::span<const int64_t> integers, std::span<const double> numbers, size_t rows,
                        std::vector<int64_t>* offset) {
  std::string text;
  offset->assign(1, 0);
  if (rows == 0) return text;
  const size_t ids = integers.size() / rows, columns = numbers.size() / rows;
  text.reserve(rows * (tag.size() + 8 * ids + 12 * columns + 2));
  char buffer[64];
  for (size_t row = 0; row < rows; ++row) {
    text += tag;
    for (size_t k = 0; k < ids; ++k) {
      const auto done = std::to_chars(buffer, buffer + sizeof buffer, integers[row * ids + k]);
      text += ' ';
      text.append(buffer, done.ptr);
    }
    for (size_t k = 0; k < columns; ++k) {
      const auto done = std::to_chars(buffer, buffer + sizeof buffer, numbers[row * columns + k]);
      text += ' ';
      text.append(buffer, done.ptr);
    }
    text += '\n';
    offset->push_back(static_cast<int64_t>(text.size()));
  }
  return text;
}

}  // namespace heliograph
