#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <vector>

namespace lacquer::brdf {

/// The container of RGL/EPFL's .bsdf files: named arrays of any rank, little endian. Holds the bytes of the file.
class TensorFile {
 public:
  using Shape = std::vector<std::uint64_t>;

  /// Parses the header; every field is known to lie inside the file afterwards. Throws Error{file}.
  TensorFile(const std::filesystem::path& file, std::vector<std::byte> bytes);

  bool has(const std::string& field) const { return fields_.count(field) > 0; }

  /// Shape of a float32 field of this rank; throws Error{file} if it is missing or different.
  const Shape& float_shape(const std::string& field, std::size_t rank) const;
  /// Values of a float32 field in C order, all checked to be in [min, max] (NaN never is).
  std::vector<float> floats(const std::string& field, std::size_t rank, float min, float max) const;

  /// Content of a uint8 field of rank 1.
  std::string bytes(const std::string& field) const;

  const std::filesystem::path& file() const { return file_; }

 private:
  struct Field {
    int type;
    std::uint64_t offset;
    std::uint64_t n_values;
    Shape shape;
  };
  const Field& field(const std::string& name, int type, std::size_t rank) const;

  std::filesystem::path file_;
  std::vector<std::byte> bytes_;
  std::map<std::string, Field> fields_;
};

/// One named array to write.
struct TensorField {
  std::string name;
  int type;  ///< code of the file format
  TensorFile::Shape shape;
  std::string data;  ///< C order

  static TensorField floats(const std::string& name, TensorFile::Shape shape, std::span<const float> values);
  static TensorField bytes(const std::string& name, const std::string& data);
};

/// Writes a tensor file; blocks begin at multiples of 8 bytes, as RGL's own files have it.
void write_tensor_file(const std::filesystem::path& file, const std::vector<TensorField>& fields);

/// First bytes of every tensor file, the NUL at the end included.
inline constexpr char tensor_magic[12] = {'t', 'e', 'n', 's', 'o', 'r', '_', 'f', 'i', 'l', 'e', '\0'};

}  // namespace lacquer::brdf
