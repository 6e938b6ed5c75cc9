#include "libcalib/lens_inputs.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstring>

namespace lacquer::calib {

namespace {

static_assert(std::endian::native == std::endian::little, "numbers are written as they lie in memory");

template <typename T>
std::string bytes_of(const std::vector<T>& values) {
  std::string bytes(values.size() * sizeof(T), '\0');
  if (!values.empty()) std::memcpy(bytes.data(), values.data(), bytes.size());
  return bytes;
}

/// NumPy's format NEP 1, version 1.0. `shape` as Python writes a tuple.
std::string npy(const char* type, const std::string& shape, const std::string& data) {
  std::string header = fmt::format("{{'descr': '{}', 'fortran_order': False, 'shape': {}, }}", type, shape);
  header.append(63 - (10 + header.size()) % 64, ' ');
  header += '\n';
  std::string file = "\x93NUMPY";
  file += '\x01';
  file += '\0';
  file += static_cast<char>(header.size() & 0xff);
  file += static_cast<char>(header.size() >> 8);
  return file + header + data;
}

/// Text as NumPy has it: UTF-32 of fixed length.
std::string npy_texts(const std::vector<std::string>& texts, const std::string& shape) {
  std::size_t length = 1;
  for (const std::string& t : texts) length = std::max(length, t.size());
  std::vector<std::uint32_t> characters;
  for (const std::string& t : texts)
    for (std::size_t i = 0; i < length; ++i) characters.push_back(i < t.size() ? static_cast<std::uint32_t>(static_cast<unsigned char>(t[i]) & 0x7f) : 0u);
  return npy(fmt::format("<U{}", length).c_str(), shape, bytes_of(characters));
}

std::uint32_t crc32(const std::string& data) {
  std::uint32_t crc = ~0u;
  for (const char c : data) {
    crc ^= static_cast<unsigned char>(c);
    for (int k = 0; k < 8; ++k) crc = (crc >> 1) ^ (0xedb88320u & (0u - (crc & 1u)));
  }
  return ~crc;
}

/// A zip archive of stored members.
class Archive {
 public:
  void add(const std::string& key, const std::string& data) {
    const std::string name = key + ".npy";
    const auto size = static_cast<std::uint32_t>(data.size()), offset = static_cast<std::uint32_t>(body_.size());
    std::string common;  // version, flags, method, time, date (1980-01-01), CRC, sizes, length of the name, of the extra field
    append(common, {20, 0, 0, 0, 0x21});
    append32(common, {crc32(data), size, size});
    append(common, {static_cast<std::uint16_t>(name.size()), 0});
    body_ += std::string("PK\x03\x04") + common + name + data;
    directory_ += "PK\x01\x02";
    append(directory_, {20});
    directory_ += common;
    append(directory_, {0, 0, 0});
    append32(directory_, {0, offset});
    directory_ += name;
    ++n_;
  }

  std::string finish() {
    std::string end = "PK\x05\x06";
    append(end, {0, 0, n_, n_});
    append32(end, {static_cast<std::uint32_t>(directory_.size()), static_cast<std::uint32_t>(body_.size())});
    append(end, {0});
    return body_ + directory_ + end;
  }

 private:
  static void append(std::string& to, std::initializer_list<std::uint16_t> values) {
    for (const std::uint16_t v : values) to += static_cast<char>(v & 0xff), to += static_cast<char>(v >> 8);
  }
  static void append32(std::string& to, std::initializer_list<std::uint32_t> values) {
    for (const std::uint32_t v : values)
      for (int k = 0; k < 32; k += 8) to += static_cast<char>((v >> k) & 0xff);
  }
  std::string body_, directory_;
  std::uint16_t n_ = 0;
};

/// RFC 1924's alphabet, big-endian groups of four bytes; the last group is padded with zeros and its digits cut.
std::string base85(const std::string& bytes) {
  constexpr char alphabet[] = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;<=>?@^_`{|}~";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 4) {
    const std::size_t n = std::min<std::size_t>(4, bytes.size() - i);
    std::uint32_t word = 0;
    for (std::size_t k = 0; k < 4; ++k) word = word << 8 | (k < n ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    std::array<char, 5> digits{};
    for (std::size_t k = 5; k-- > 0; word /= 85) digits[k] = alphabet[word % 85];
    text.append(digits.data(), n + 1);
  }
  return text;
}

}  // namespace

acquire::OptimizationInputs optimization_inputs(const LensProblem& p, const LensFreedom& f, const std::vector<BoardView>& views) {
  const std::size_t n = p.poses.size();
  std::vector<double> poses, observed;
  std::vector<std::int32_t> indices;
  std::vector<std::string> names;
  for (std::size_t b = 0; b < n; ++b) {
    poses.insert(poses.end(), p.poses[b].begin(), p.poses[b].end());
    indices.insert(indices.end(), {static_cast<std::int32_t>(b), 0, -1});
    names.push_back(views[b].name);
  }
  for (const glm::dvec3& o : p.observed) observed.insert(observed.end(), {o.x, o.y, o.z});
  Archive archive;
  const auto scalar = [&](const char* key, bool value) { archive.add(key, npy("|b1", "()", std::string(1, value ? '\1' : '\0'))); };
  const auto nothing = [&](const char* key) { archive.add(key, npy_texts({""}, "()")); };  // mrcal stores None so
  archive.add("intrinsics", npy("<f8", fmt::format("(1, {})", p.intrinsics.size()), bytes_of(p.intrinsics)));
  archive.add("extrinsics_rt_fromref", npy("<f8", "(0, 6)", ""));
  archive.add("frames_rt_toref", npy("<f8", fmt::format("({}, 6)", n), bytes_of(poses)));
  nothing("points");
  archive.add("observations_board", npy("<f8", fmt::format("({}, {}, {}, 3)", n, p.board.rows, p.board.columns), bytes_of(observed)));
  archive.add("indices_frame_camintrinsics_camextrinsics", npy("<i4", fmt::format("({}, 3)", n), bytes_of(indices)));
  nothing("observations_point");
  nothing("indices_point_camintrinsics_camextrinsics");
  archive.add("lensmodel", npy_texts({p.model}, "()"));
  archive.add("imagersizes", npy("<i4", "(1, 2)", bytes_of(std::vector<std::int32_t>{p.width, p.height})));
  archive.add("calobject_warp", npy("<f8", "(2,)", bytes_of(std::vector<double>{p.warp[0], p.warp[1]})));
  scalar("do_optimize_intrinsics_core", f.core);
  scalar("do_optimize_intrinsics_distortions", f.distortion);
  scalar("do_optimize_extrinsics", true);
  scalar("do_optimize_frames", f.poses);
  scalar("do_optimize_calobject_warp", f.warp);
  scalar("do_apply_regularization", f.regularise);
  scalar("do_apply_outlier_rejection", false);  // they are marked
  scalar("verbose", false);
  archive.add("calibration_object_spacing", npy("<f8", "()", bytes_of(std::vector<double>{p.board.square_m})));
  archive.add("imagepaths", npy_texts(names, fmt::format("({},)", n)));
  return base85(archive.finish());
}

}  // namespace lacquer::calib
