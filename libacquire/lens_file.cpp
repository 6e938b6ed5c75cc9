#include "libacquire/lens_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <optional>
#include <string_view>

#include "libacquire/lens_residuals.h"
#include "libbrdf/file_error.h"
#include "libbrdf/files.h"

namespace lacquer::acquire {

namespace {

constexpr std::size_t max_numbers = 200000;
constexpr int max_parameters = 20000;
constexpr std::size_t max_corners = 20000;

/// The part of Python's literals that a .cameramodel has: a dict of texts, byte strings, numbers and lists.
class LiteralReader {
 public:
  LiteralReader(std::string_view text, const std::string& file) : text_(text), file_(file) {}

  /// What one entry says; lists of lists come as one row of numbers.
  struct Entry {
    std::string key, text;
    std::vector<double> numbers;
    bool is_list = false;
  };

  /// The entries of the dict, in order.
  std::vector<Entry> dict() {
    std::vector<Entry> entries;
    expect('{');
    while (!accept('}')) {
      if (entries.size() >= 100) fail("more than 100 entries");
      Entry entry;
      entry.key = brdf::printable(quoted(), 60);
      expect(':');
      value(entry, 0);
      entries.push_back(std::move(entry));
      if (!accept(',')) {
        expect('}');
        break;
      }
    }
    skip();
    if (at_ != text_.size()) fail("text after the closing brace");
    return entries;
  }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    const auto line = 1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(std::min(at_, text_.size())), '\n');
    brdf::fail_file(file_, fmt::format("line {}: {}; expected a .cameramodel of mrcal", line, what));
  }

  void skip() {
    while (at_ < text_.size()) {
      const char c = text_[at_];
      if (c == '#')
        at_ = std::min(text_.find('\n', at_), text_.size());
      else if (c == ' ' || c == '\t' || c == '\r' || c == '\n')
        ++at_;
      else
        return;
    }
  }

  bool accept(char c) {
    skip();
    if (at_ >= text_.size() || text_[at_] != c) return false;
    ++at_;
    return true;
  }

  void expect(char c) {
    if (!accept(c)) fail(fmt::format("'{}' is missing", c));
  }

  std::string quoted() {
    skip();
    if (at_ >= text_.size() || (text_[at_] != '\'' && text_[at_] != '"')) fail("a quoted text is missing");
    const char quote = text_[at_++];
    const std::size_t begin = at_;
    for (; at_ < text_.size() && text_[at_] != quote; ++at_) {
      if (text_[at_] == '\n') fail("a text does not end on its line");
      if (text_[at_] == '\\') ++at_;
    }
    if (at_ >= text_.size()) fail("a text does not end");
    return std::string(text_.substr(begin, at_++ - begin));
  }

  void value(Entry& entry, int depth) {
    skip();
    const char c = at_ < text_.size() ? text_[at_] : '\0';
    if (c == '\'' || c == '"') {
      entry.text = quoted();
    } else if (c == 'b' && at_ + 1 < text_.size() && (text_[at_ + 1] == '\'' || text_[at_ + 1] == '"')) {
      ++at_;
      quoted();
    } else if (c == '[' || c == '(') {
      if (depth >= 3) fail("lists are nested more than 3 deep");
      ++at_;
      entry.is_list = true;
      const char end = c == '[' ? ']' : ')';
      while (!accept(end)) {
        value(entry, depth + 1);
        if (!accept(',')) {
          expect(end);
          break;
        }
      }
    } else {
      number(entry);
    }
  }

  void number(Entry& entry) {
    const std::size_t end = std::min(text_.find_first_not_of("+-.0123456789eExX_abcdfnNTFrulst", at_), text_.size());
    const std::string_view word = text_.substr(at_, end - at_);
    if (word == "None" || word == "True" || word == "False") {
      at_ = end;
      return;
    }
    double number = 0;
    const std::string_view digits = word.starts_with('+') ? word.substr(1) : word;
    const auto [last, status] = std::from_chars(digits.data(), digits.data() + digits.size(), number);
    if (word.empty() || status != std::errc() || last != digits.data() + digits.size() || !std::isfinite(number))
      fail(fmt::format("\"{}\" is not a finite number", brdf::printable(std::string(text_.substr(at_, std::max<std::size_t>(end - at_, 1))), 30)));
    if (++n_numbers_ > max_numbers) fail(fmt::format("more than {} numbers", max_numbers));
    entry.numbers.push_back(number);
    at_ = end;
  }

  std::string_view text_;
  const std::string& file_;
  std::size_t at_ = 0, n_numbers_ = 0;
};

/// Number of intrinsics of a model of mrcal; nullopt: mrcal has no such model, or its configuration is not one.
std::optional<int> n_intrinsics(const std::string& model) {
  struct Known {
    const char* name;
    int n;
  };
  constexpr std::array known{Known{"LENSMODEL_PINHOLE", 4},  Known{"LENSMODEL_STEREOGRAPHIC", 4}, Known{"LENSMODEL_LONLAT", 4},
                             Known{"LENSMODEL_LATLON", 4},   Known{"LENSMODEL_OPENCV4", 8},       Known{"LENSMODEL_OPENCV5", 9},
                             Known{"LENSMODEL_OPENCV8", 12}, Known{"LENSMODEL_OPENCV12", 16},     Known{"LENSMODEL_CAHVOR", 9}};
  for (const Known& k : known)
    if (model == k.name) return k.n;
  if (model.starts_with("LENSMODEL_CAHVORE_linearity=")) return 12;
  int order = 0, nx = 0, ny = 0, fov = 0, end = 0;
  if (std::sscanf(model.c_str(), "LENSMODEL_SPLINED_STEREOGRAPHIC_order=%4d_Nx=%4d_Ny=%4d_fov_x_deg=%4d%n", &order, &nx, &ny, &fov, &end) != 4 ||
      static_cast<std::size_t>(end) != model.size())
    return std::nullopt;
  const int n = 4 + 2 * nx * ny;
  if ((order != 2 && order != 3) || nx < order + 1 || ny < order + 1 || n > max_parameters || fov < 1 || fov >= 360) return std::nullopt;
  return n;
}

template <typename Numbers>
std::string list(const Numbers& numbers) {
  return fmt::format("[ {},]", fmt::join(numbers, ", "));
}

const LiteralReader::Entry* find(const std::vector<LiteralReader::Entry>& entries, const char* key) {
  const auto found = std::find_if(entries.begin(), entries.end(), [&](const auto& e) { return e.key == key; });
  return found == entries.end() ? nullptr : &*found;
}

std::string corner_rows(const std::vector<CornerResidual>& corners) {
  std::string text = "\n    # Corners of the boards: found x, y, and found minus predicted, pixels\n    'lacquer_corner_residuals': [\n";
  const std::size_t step = (corners.size() + max_corners - 1) / max_corners;
  for (std::size_t i = 0; i < corners.size(); i += step)
    text += fmt::format("      [ {:.3f}, {:.3f}, {:.4f}, {:.4f}],\n", corners[i].found.x, corners[i].found.y, corners[i].residual.x, corners[i].residual.y);
  return text + "    ],\n";
}

}  // namespace

std::string cameramodel_text(const Lens& lens, const std::string& note, const OptimizationInputs& inputs) { return cameramodel_text(lens, note, inputs, {}); }

std::string cameramodel_text(const Lens& lens, const std::string& note, const OptimizationInputs& inputs, const std::vector<CornerResidual>& corners) {
  std::string text = "# " + note + "\n{\n";
  text += fmt::format("    'lensmodel':  '{}',\n\n", lens.model);
  text += fmt::format("    # fx, fy, cx, cy, then the distortion\n    'intrinsics': {},\n\n", list(lens.intrinsics));
  text += fmt::format("    # rt_fromref\n    'extrinsics': {},\n\n", list(std::array<double, 6>{}));
  text += fmt::format("    'imagersize': {},\n", list(std::array{lens.width, lens.height}));
  if (!lens.covariance.empty()) {
    text += "\n    # Covariance of the intrinsics, the poses of the boards free\n    'lacquer_intrinsics_covariance': [\n";
    const std::size_t n = lens.intrinsics.size();
    for (std::size_t i = 0; i < n; ++i)
      text += fmt::format("      [ {:.9g},],\n", fmt::join(lens.covariance.begin() + static_cast<std::ptrdiff_t>(i * n),
                                                           lens.covariance.begin() + static_cast<std::ptrdiff_t>((i + 1) * n), ", "));
    text += "    ],\n";
  }
  if (!corners.empty()) text += corner_rows(corners);
  if (!inputs.empty()) text += fmt::format("\n    # All that the solver was given, for mrcal's tools\n    'icam_intrinsics': 0,\n    'optimization_inputs': b'{}',\n", inputs);
  return text + "}\n";
}

Lens parse_lens(const std::string& text, const std::string& file) {
  const auto entries = LiteralReader(text, file).dict();
  const auto entry = [&](const char* key) { return find(entries, key); };
  const auto numbers = [&](const char* key, std::size_t n, const char* what) -> const std::vector<double>& {
    const auto* e = entry(key);
    if (!e) brdf::fail_file(file, fmt::format("{}: missing; expected {} numbers: {}", key, n, what));
    if (!e->is_list || e->numbers.size() != n) brdf::fail_file(file, fmt::format("{}: expected {} numbers ({}), got {}", key, n, what, e->numbers.size()));
    return e->numbers;
  };
  Lens lens;
  const auto* model = entry("lensmodel");
  if (!model || model->text.empty()) brdf::fail_file(file, "lensmodel: missing; expected the name of one of mrcal's, e.g. LENSMODEL_OPENCV8");
  lens.model = model->text;
  const auto n = n_intrinsics(lens.model);
  if (!n) brdf::fail_file(file, fmt::format("lensmodel: {} is none of mrcal's lens models", brdf::printable(lens.model, 80)));

  const auto& size = numbers("imagersize", 2, "width and height in pixels");
  for (const double s : size)
    if (!(s >= 1 && s <= 100000 && s == std::floor(s))) brdf::fail_file(file, fmt::format("imagersize: expected pixels from 1 to 100000, got {}", s));
  lens.width = static_cast<int>(size[0]);
  lens.height = static_cast<int>(size[1]);
  numbers("extrinsics", 6, "rotation vector and translation");
  lens.intrinsics = numbers("intrinsics", static_cast<std::size_t>(*n), "fx, fy, cx, cy and the distortion");
  const bool has_core = !lens.model.starts_with("LENSMODEL_CAHVOR");
  for (std::size_t i = 0; i < 4 && has_core; ++i) {
    const double v = lens.intrinsics[i];
    if (i < 2 ? !(v > 0 && v <= 1e7) : !(std::abs(v) <= 1e6))
      brdf::fail_file(file, fmt::format("intrinsics[{}]: expected {}, got {}", i, i < 2 ? "a focal length from 0 to 1e7 px" : "a principal point within 1e6 px", v));
  }
  for (const double v : lens.intrinsics)
    if (!(std::abs(v) <= 1e7)) brdf::fail_file(file, fmt::format("intrinsics: expected numbers up to 1e7, got {}", v));
  if (entry("lacquer_intrinsics_covariance")) {
    const auto size_n = static_cast<std::size_t>(*n);
    lens.covariance = numbers("lacquer_intrinsics_covariance", size_n * size_n, "rows of the covariance of the intrinsics");
    for (std::size_t i = 0; i < size_n; ++i)
      for (std::size_t j = 0; j <= i; ++j) {
        const double a = lens.covariance[i * size_n + j], b = lens.covariance[j * size_n + i];
        const double scale = std::sqrt(std::abs(lens.covariance[i * size_n + i] * lens.covariance[j * size_n + j]));
        if (lens.covariance[i * size_n + i] < 0 || !(std::abs(a - b) <= 1e-6 * scale) || !(std::abs(a) <= 1.000001 * scale))
          brdf::fail_file(file, fmt::format("lacquer_intrinsics_covariance[{}][{}]: not an element of a covariance", i, j));
      }
  }
  return lens;
}

Lens read_lens(const std::filesystem::path& file) { return parse_lens(brdf::read_text(file), file.string()); }

std::vector<CornerResidual> parse_corner_residuals(const std::string& text, const std::string& file) {
  const auto entries = LiteralReader(text, file).dict();
  const auto* e = find(entries, "lacquer_corner_residuals");
  if (!e) return {};
  if (!e->is_list || e->numbers.size() % 4 != 0)
    brdf::fail_file(file, fmt::format("lacquer_corner_residuals: expected rows of 4 numbers (pixel, found minus predicted), got {} numbers", e->numbers.size()));
  std::vector<CornerResidual> corners;
  for (std::size_t i = 0; i < e->numbers.size(); i += 4) {
    const CornerResidual c{{e->numbers[i], e->numbers[i + 1]}, {e->numbers[i + 2], e->numbers[i + 3]}};
    if (!(std::abs(c.found.x) <= 1e5 && std::abs(c.found.y) <= 1e5 && std::abs(c.residual.x) <= 1e5 && std::abs(c.residual.y) <= 1e5))
      brdf::fail_file(file, fmt::format("lacquer_corner_residuals[{}]: expected pixels within 1e5", i / 4));
    corners.push_back(c);
  }
  return corners;
}

std::vector<CornerResidual> read_corner_residuals(const std::filesystem::path& file) { return parse_corner_residuals(brdf::read_text(file), file.string()); }

CameraModel camera_of(const Lens& lens, const std::string& file) {
  if (lens.model != "LENSMODEL_PINHOLE" && lens.model != "LENSMODEL_OPENCV4" && lens.model != "LENSMODEL_OPENCV5" && lens.model != "LENSMODEL_OPENCV8")
    brdf::fail_file(file, fmt::format("lensmodel: {} cannot be used in a rig; expected LENSMODEL_PINHOLE, OPENCV4, OPENCV5 or OPENCV8 (calibrate again with "
                                      "--model, or mrcal-convert-lensmodel)", lens.model));
  CameraModel camera;
  camera.width = lens.width;
  camera.height = lens.height;
  camera.focal = {lens.intrinsics[0], lens.intrinsics[1]};
  camera.centre = {lens.intrinsics[2], lens.intrinsics[3]};
  std::copy(lens.intrinsics.begin() + 4, lens.intrinsics.end(), camera.distortion.begin());
  return camera;
}

}  // namespace lacquer::acquire
