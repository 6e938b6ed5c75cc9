#include "libbrdf/tensor_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <array>
#include <bit>
#include <cstring>
#include <span>

#include "libbrdf/file_error.h"
#include "libbrdf/files.h"

namespace lacquer::brdf {

namespace {

static_assert(std::endian::native == std::endian::little, "tensor files are little endian");

constexpr std::uint32_t max_fields = 1000;  // real files have 11
constexpr std::size_t max_rank = 16;

struct ElementType {
  const char* name;
  std::uint64_t size;  // bytes
};
/// Index = the type code of the file; 0 is not in use.
constexpr std::array<ElementType, 12> element_types{{{"invalid", 0}, {"uint8", 1}, {"int8", 1}, {"uint16", 2}, {"int16", 2}, {"uint32", 4},
    {"int32", 4}, {"uint64", 8}, {"int64", 8}, {"float16", 2}, {"float32", 4}, {"float64", 8}}};
constexpr int type_uint8 = 1;
constexpr int type_float32 = 10;

/// Reads the header front to back.
class Cursor {
 public:
  Cursor(const std::filesystem::path& file, std::span<const std::byte> bytes) : file_(file), bytes_(bytes) {}

  std::span<const std::byte> take(std::size_t size) {
    if (size > bytes_.size()) fail_file(file_, "tensor file header is truncated");
    const auto part = bytes_.first(size);
    bytes_ = bytes_.subspan(size);
    return part;
  }
  template <typename T>
  T number() {
    T value;
    std::memcpy(&value, take(sizeof(T)).data(), sizeof(T));
    return value;
  }
  std::string text(std::size_t size) {
    const auto part = take(size);
    return {reinterpret_cast<const char*>(part.data()), part.size()};
  }

 private:
  const std::filesystem::path& file_;
  std::span<const std::byte> bytes_;
};

}  // namespace

TensorFile::TensorFile(const std::filesystem::path& file, std::vector<std::byte> bytes) : file_(file), bytes_(std::move(bytes)) {
  Cursor cursor(file_, bytes_);
  if (bytes_.size() < sizeof(tensor_magic) || std::memcmp(bytes_.data(), tensor_magic, sizeof(tensor_magic)) != 0)
    fail_file(file_, "is not a tensor file: expected it to begin with \"tensor_file\"");
  cursor.take(sizeof(tensor_magic));
  const int major = cursor.number<std::uint8_t>(), minor = cursor.number<std::uint8_t>();
  if (major != 1 || minor != 0) fail_file(file_, fmt::format("expected tensor file version 1.0, got {}.{}", major, minor));
  const auto n_fields = cursor.number<std::uint32_t>();
  if (n_fields > max_fields) fail_file(file_, fmt::format("expected at most {} fields, got {}", max_fields, n_fields));

  for (std::uint32_t i = 0; i < n_fields; ++i) {
    const std::string name = cursor.text(cursor.number<std::uint16_t>());
    const std::size_t rank = cursor.number<std::uint16_t>();
    Field field;
    field.type = cursor.number<std::uint8_t>();
    field.offset = cursor.number<std::uint64_t>();
    if (rank > max_rank) fail_file(file_, fmt::format("{}: expected at most {} dimensions, got {}", printable(name), max_rank, rank));
    if (field.type < 1 || field.type >= static_cast<int>(element_types.size()))
      fail_file(file_, fmt::format("{}: unknown element type {}", printable(name), field.type));

    const std::uint64_t available = field.offset <= bytes_.size() ? bytes_.size() - field.offset : 0;
    const std::uint64_t max_values = available / element_types[static_cast<std::size_t>(field.type)].size;
    field.n_values = 1;
    for (std::size_t k = 0; k < rank; ++k) {
      field.shape.push_back(cursor.number<std::uint64_t>());
      // Division, not multiplication: the product of a hostile shape wraps around.
      if (field.shape.back() != 0 && field.n_values > max_values / field.shape.back())
        fail_file(file_, fmt::format("{}: its values reach beyond the end of the file: truncated?", printable(name)));
      field.n_values *= field.shape.back();
    }
    if (field.n_values > max_values)
      fail_file(file_, fmt::format("{}: its values reach beyond the end of the file: truncated?", printable(name)));
    if (!fields_.emplace(name, std::move(field)).second) fail_file(file_, fmt::format("{}: appears twice", printable(name)));
  }
}

const TensorFile::Field& TensorFile::field(const std::string& name, int type, std::size_t rank) const {
  const auto found = fields_.find(name);
  if (found == fields_.end()) fail_file(file_, fmt::format("{}: field is missing", name));
  const Field& field = found->second;
  if (field.type != type)
    fail_file(file_, fmt::format("{}: expected {}, got {}", name, element_types[static_cast<std::size_t>(type)].name,
                                 element_types[static_cast<std::size_t>(field.type)].name));
  if (field.shape.size() != rank) fail_file(file_, fmt::format("{}: expected {} dimensions, got {}", name, rank, field.shape.size()));
  return field;
}

const TensorFile::Shape& TensorFile::float_shape(const std::string& name, std::size_t rank) const {
  return field(name, type_float32, rank).shape;
}

std::vector<float> TensorFile::floats(const std::string& name, std::size_t rank, float min, float max) const {
  const Field& f = field(name, type_float32, rank);
  std::vector<float> values(f.n_values);
  if (!values.empty()) std::memcpy(values.data(), bytes_.data() + f.offset, f.n_values * sizeof(float));
  for (std::size_t i = 0; i < values.size(); ++i)
    if (!(values[i] >= min && values[i] <= max))
      fail_file(file_, fmt::format("{}: value {}: expected a number from {:g} to {:g}, got {}", name, i, min, max, values[i]));
  return values;
}

std::string TensorFile::bytes(const std::string& name) const {
  const Field& f = field(name, type_uint8, 1);
  return {reinterpret_cast<const char*>(bytes_.data()) + f.offset, f.n_values};
}

TensorField TensorField::floats(const std::string& name, TensorFile::Shape shape, std::span<const float> values) {
  return {name, type_float32, std::move(shape), std::string(reinterpret_cast<const char*>(values.data()), values.size_bytes())};
}

TensorField TensorField::bytes(const std::string& name, const std::string& data) { return {name, type_uint8, {data.size()}, data}; }

void write_tensor_file(const std::filesystem::path& file, const std::vector<TensorField>& fields) {
  const auto raw = [](auto value) { return std::string(reinterpret_cast<const char*>(&value), sizeof(value)); };
  const auto aligned = [](std::uint64_t offset) { return (offset + 7) / 8 * 8; };
  std::uint64_t offset = sizeof(tensor_magic) + 2 + 4;
  for (const auto& f : fields) offset += 2 + f.name.size() + 2 + 1 + 8 + 8 * f.shape.size();

  std::string content = std::string(tensor_magic, sizeof(tensor_magic)) + '\1' + '\0' + raw(static_cast<std::uint32_t>(fields.size()));
  for (const auto& f : fields) {
    offset = aligned(offset);
    content += raw(static_cast<std::uint16_t>(f.name.size())) + f.name + raw(static_cast<std::uint16_t>(f.shape.size()));
    content += raw(static_cast<std::uint8_t>(f.type)) + raw(offset);
    for (const std::uint64_t n : f.shape) content += raw(n);
    offset += f.data.size();
  }
  for (const auto& f : fields) {
    content.resize(aligned(content.size()));
    content += f.data;
  }
  write_text_atomically(file, content);
}

}  // namespace lacquer::brdf
