// SPDX-License-Identifier: MIT
#include "bindings/bindings.hpp"
#include "io/decode.hpp"

#include <optional>
#include <string_view>

namespace heliograph {

namespace {

// A NumPy array of one or two dimensions with any byte strides; nb::ndarray has none that split an element.
class Buffer {
 public:
  explicit Buffer(nb::handle array) {
    if (PyObject_GetBuffer(array.ptr(), &view_, PyBUF_STRIDES | PyBUF_FORMAT) != 0) throw nb::python_error();
  }
  ~Buffer() { PyBuffer_Release(&view_); }
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;

  size_t rows() const { return view_.ndim == 2 ? static_cast<size_t>(view_.shape[0]) : 1; }
  size_t columns() const { return view_.ndim == 0 ? 0 : static_cast<size_t>(view_.shape[view_.ndim - 1]); }

  Column column(size_t rows, size_t columns) const {
    if (view_.ndim < 1 || view_.ndim > 2 || this->rows() != rows || this->columns() != columns)
      throw std::invalid_argument("point columns must all have the same one or two dimensions");
    const std::ptrdiff_t row_stride = view_.ndim == 2 ? view_.strides[0] : 0;
    return {static_cast<const std::byte*>(view_.buf), row_stride, view_.strides[view_.ndim - 1], type()};
  }

 private:
  ColumnType type() const {
    const char* format = view_.format;
    if (*format == '@' || *format == '=' || *format == '<') ++format;  // wheels exist for little-endian machines only
    const bool is_signed = *format != '\0' && std::string_view("bhil").find(*format) != std::string_view::npos;
    const bool is_unsigned = *format != '\0' && std::string_view("BHIL").find(*format) != std::string_view::npos;
    if (*format == 'f') return ColumnType::f32;
    if (*format == 'd') return ColumnType::f64;
    if (is_signed && view_.itemsize == 1) return ColumnType::i8;
    if (is_signed && view_.itemsize == 2) return ColumnType::i16;
    if (is_signed && view_.itemsize == 4) return ColumnType::i32;
    if (is_unsigned && view_.itemsize == 1) return ColumnType::u8;
    if (is_unsigned && view_.itemsize == 2) return ColumnType::u16;
    if (is_unsigned && view_.itemsize == 4) return ColumnType::u32;
    throw std::invalid_argument("a point column must be a native float or an integer of at most 32 bits");
  }

  Py_buffer view_{};
};

std::optional<Column> optional_column(std::optional<Buffer>* buffer, nb::handle array, size_t rows, size_t columns) {
  if (array.is_none()) return std::nullopt;
  buffer->emplace(array);
  return (*buffer)->column(rows, columns);
}

Tuple decode(nb::handle x, nb::handle y, nb::handle z, nb::handle time, nb::handle intensity, nb::handle ring) {
  const Buffer bx(x), by(y), bz(z);
  std::optional<Buffer> bt, bi, br;
  const size_t rows = bx.rows(), columns = bx.columns();
  const PointColumns in{rows,
                        columns,
                        bx.column(rows, columns),
                        by.column(rows, columns),
                        bz.column(rows, columns),
                        optional_column(&bt, time, rows, columns),
                        optional_column(&bi, intensity, rows, columns),
                        optional_column(&br, ring, rows, columns)};
  DecodedPoints out;
  {
    nb::gil_scoped_release release;
    out = decode_points(in);
  }
  const size_t n = out.kept.size();
  const auto or_none = [](bool given, auto&& array) { return given ? nb::cast(array) : nb::none(); };
  static TupleType type{"DecodedPoints", "points kept times first_time intensity ring"};
  return named(
      type,
      to_numpy<float>(std::move(out.points), {n, 3}), to_numpy<uint32_t>(std::move(out.kept), {n}),
      or_none(in.time.has_value(), to_numpy<double>(std::move(out.times), {in.time ? n : 0})), out.first_time,
      or_none(in.intensity.has_value(), to_numpy<float>(std::move(out.intensity), {in.intensity ? n : 0})),
      or_none(in.ring.has_value(), to_numpy<uint16_t>(std::move(out.ring), {in.ring ? n : 0})));
}

Tuple offsets(const Array<const double, nb::shape<-1>>& times, double first, double ns_per_unit, double longest_ns) {
  SweepOffsets out;
  {
    nb::gil_scoped_release release;
    out = sweep_offsets(span_of(times), first, ns_per_unit, longest_ns);
  }
  const size_t n = out.offsets_ns.size();
  static TupleType type{"SweepOffsets", "offsets_ns largest outside"};
  return named(type, to_numpy<int32_t>(std::move(out.offsets_ns), {n}), out.largest, out.outside);
}

}  // namespace

void bind_io(nb::module_& m) {
  using namespace nb::literals;
  m.def("decode_points", &decode, "x"_a, "y"_a, "z"_a, "time"_a.none(), "intensity"_a.none(), "ring"_a.none());
  m.def("sweep_offsets", &offsets, "times"_a.noconvert(), "first"_a, "ns_per_unit"_a, "longest_ns"_a);
}

}  // namespace heliograph
