#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <cstring>
#include <fstream>
#include <functional>
#include <iterator>
#include <string>
#include <vector>

#include "libbrdf/error.h"
#include "tests/test_support.h"

namespace lacquer::test {

inline std::string slurp(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

/// The call must throw Error{file}: one line that contains every one of `parts`.
inline void expect_file_error(const std::function<void()>& call, const std::vector<std::string>& parts) {
  try {
    call();
  } catch (const Error& e) {
    const std::string what = e.what();
    EXPECT_EQ(e.code(), ErrorCode::file) << what;
    EXPECT_EQ(what.find('\n'), std::string::npos) << what;
    for (const auto& part : parts) EXPECT_NE(what.find(part), std::string::npos) << "'" << part << "' is not in: " << what;
    return;
  }
  FAIL() << "no error; expected one with '" << (parts.empty() ? "" : parts.front()) << "'";
}

/// Debian's own Python, which has its numpy; another one in front of PATH usually has not.
inline const std::string python = "/usr/bin/python3";

inline bool python_has_numpy() { return std::system((python + " -c 'import numpy' 2>/dev/null").c_str()) == 0; }

template <typename T>
std::string raw(const T& value) {
  return {reinterpret_cast<const char*>(&value), sizeof(value)};
}

/// Writes tensor files from the description of the format, independently of the reader.
struct TensorWriter {
  struct Field {
    std::string name;
    std::uint8_t type;
    std::vector<std::uint64_t> shape;
    std::string data;
  };
  std::vector<Field> fields;

  void floats(const std::string& name, std::vector<std::uint64_t> shape, const std::vector<float>& values) {
    std::string data;
    for (const float v : values) data += raw(v);
    set({name, 10, std::move(shape), std::move(data)});
  }
  void bytes(const std::string& name, const std::string& data) { set({name, 1, {data.size()}, data}); }
  void set(Field field) {
    remove(field.name);
    fields.push_back(std::move(field));
  }
  void remove(const std::string& name) { std::erase_if(fields, [&](const Field& f) { return f.name == name; }); }
  Field& at(const std::string& name) {
    for (auto& f : fields)
      if (f.name == name) return f;
    throw std::runtime_error("no field " + name);
  }

  std::string content() const {
    std::uint64_t offset = 12 + 2 + 4;
    for (const auto& f : fields) offset += 2 + f.name.size() + 2 + 1 + 8 + 8 * f.shape.size();
    std::string header = std::string("tensor_file\0", 12) + "\1" + std::string(1, '\0') + raw(static_cast<std::uint32_t>(fields.size()));
    std::string data;
    for (const auto& f : fields) {
      header += raw(static_cast<std::uint16_t>(f.name.size())) + f.name + raw(static_cast<std::uint16_t>(f.shape.size())) + raw(f.type);
      header += raw(offset + data.size());
      for (const auto n : f.shape) header += raw(n);
      data += f.data;
    }
    return header + data;
  }
};

/// The smallest isotropic RGB file: two incident angles, 2 x 2 nodes, every grid 1, warp the identity:
/// f_r cos(theta_o) = rgb D / (4 sigma) = 1/4 in every channel.
inline TensorWriter constant_rgl_file() {
  TensorWriter w;
  w.bytes("description", "test");
  w.floats("theta_i", {2}, {0.0f, 1.5707963f});
  w.floats("phi_i", {1}, {0.0f});
  w.floats("ndf", {2, 2}, std::vector<float>(4, 1.0f));
  w.floats("sigma", {2, 2}, std::vector<float>(4, 1.0f));
  w.floats("vndf", {1, 2, 2, 2}, std::vector<float>(8, 1.0f));
  w.floats("luminance", {1, 2, 2, 2}, std::vector<float>(8, 1.0f));
  w.floats("rgb", {1, 2, 3, 2, 2}, std::vector<float>(24, 1.0f));
  w.bytes("jacobian", "\1");
  return w;
}

}  // namespace lacquer::test
