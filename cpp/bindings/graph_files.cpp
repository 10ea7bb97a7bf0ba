// SPDX-License-Identifier: MIT
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "bindings/bindings.hpp"
#include "graph/problem/spanning_start.hpp"
#include "graph/files/text_rows.hpp"

namespace heliograph {

namespace {

using Numbers = Array<const double, nb::shape<-1, -1>>;
using Integers = Array<const int64_t, nb::shape<-1, -1>>;

Tuple read_rows_of(nb::bytes text, const std::vector<std::string>& tags) {
  TextRows rows;
  {
    const std::string_view view(text.c_str(), text.size());
    nb::gil_scoped_release release;
    rows = read_rows(view, tags);
  }
  const size_t n = rows.tag.size(), numbers = rows.number.size();
  static TupleType type{"TextRows", "tag line range integer first number bad"};
  return named(type, to_numpy<int32_t>(std::move(rows.tag), {n}), to_numpy<int64_t>(std::move(rows.line), {n}),
               to_numpy<int64_t>(std::move(rows.range), {n, 2}), to_numpy<int64_t>(std::move(rows.integer), {n, 2}),
               to_numpy<int64_t>(std::move(rows.first), {n + 1}), to_numpy<double>(std::move(rows.number), {numbers}),
               nb::make_tuple(rows.bad.line, rows.bad.begin, rows.bad.end));
}

Tuple format_rows_of(const std::string& tag, const Integers& integers, const Numbers& numbers) {
  if (integers.shape(0) != numbers.shape(0)) throw std::invalid_argument("one row of numbers a row of integers is needed");
  std::vector<int64_t> offset;
  std::string text;
  {
    nb::gil_scoped_release release;
    text = format_rows(tag, {integers.data(), integers.size()}, {numbers.data(), numbers.size()}, integers.shape(0), &offset);
  }
  const size_t n = offset.size();
  static TupleType type{"FormattedRows", "text offset"};
  return named(type, nb::bytes(text.data(), text.size()), to_numpy<int64_t>(std::move(offset), {n}));
}

Tuple spanning_start_of(size_t count, const Offsets& i, const Offsets& j, const Array<const double, nb::ndim<3>>& relative) {
  const size_t k = relative.shape(1);
  if ((k != 3 && k != 4) || relative.shape(2) != k) throw std::invalid_argument("relative poses must be (E, 3, 3) or (E, 4, 4)");
  if (i.size() != j.size() || i.size() != relative.shape(0)) throw std::invalid_argument("one i, j and relative pose an edge");
  for (size_t e = 0; e < i.size(); ++e)
    if (i.data()[e] < 0 || j.data()[e] < 0 || static_cast<size_t>(i.data()[e]) >= count || static_cast<size_t>(j.data()[e]) >= count)
      throw std::invalid_argument("an edge names a pose that is not there");
  SpanningStart out;
  {
    nb::gil_scoped_release release;
    out = spanning_start(static_cast<int>(k) - 1, count, span_of(i), span_of(j), {relative.data(), relative.size()});
  }
  static TupleType type{"SpanningStart", "pose root parent"};
  return named(type, to_numpy<double>(std::move(out.pose), {count, k, k}), to_numpy<int32_t>(std::move(out.root), {count}),
               to_numpy<int32_t>(std::move(out.parent), {count}));
}

}  // namespace

void bind_graph_files(nb::module_& m) {
  using namespace nb::literals;
  m.def("read_rows", &read_rows_of, "text"_a, "tags"_a);
  m.def("format_rows", &format_rows_of, "tag"_a, "integers"_a.noconvert(), "numbers"_a.noconvert());
  m.def("spanning_start", &spanning_start_of, "count"_a, "i"_a.noconvert(), "j"_a.noconvert(), "relative"_a.noconvert());
}

}  // namespace heliograph
