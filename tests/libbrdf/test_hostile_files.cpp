#include <cmath>
#include <random>

#include "libbrdf/files.h"
#include "libbrdf/mbsdf.h"
#include "libbrdf/table_files.h"
#include "tests/libbrdf/exr_writer.h"
#include "tests/seeded_damage.h"

/// Damaged and malicious files: each loads or throws lacquer::Error. A crash, a hang, std::bad_alloc or a value that is not finite fails.
namespace lacquer::brdf {
namespace {

using test::expect_file_error;
using test::TemporaryFolder;
using test::TensorWriter;

void expect_finite_values(const Brdf& brdf) {
  for (const double theta_i : {0.0, 0.3, 1.2, 1.5707})
    for (const double theta_o : {0.0, 0.8, 1.57})
      for (const double phi : {0.0, 1.0, 3.14159265358979}) {
        const auto f = brdf.value({direction(theta_i, 0.5), direction(theta_o, 0.5 + phi)});
        EXPECT_TRUE(!f || (std::isfinite(f->r) && std::isfinite(f->g) && std::isfinite(f->b))) << theta_i << " " << theta_o;
      }
}

/// Loads the content; what is loaded must be usable, what is not must be an Error of one line. Returns whether it loaded.
bool loads_or_says_why(const std::filesystem::path& file, const std::string& content) {
  test::write_file(file, content);
  try {
    expect_finite_values(*load_brdf(file));
    return true;
  } catch (const Error& e) {
    const std::string what = e.what();
    EXPECT_EQ(e.code(), ErrorCode::file) << what;
    EXPECT_EQ(what.find('\n'), std::string::npos) << what;
    EXPECT_NE(what.find(file.filename().string()), std::string::npos) << what;
  } catch (const std::exception& e) {
    ADD_FAILURE() << "not a lacquer::Error: " << e.what();
  }
  return false;
}

TEST(HostileFiles, EmptyMissingAndForeignFilesNameWhatIsUnderstood) {
  TemporaryFolder folder;
  for (const std::string& content : {std::string(), std::string("hello"), std::string("\x89PNG\r\n\x1a\n"), std::string(5000, '\0'), std::string("[1]"), std::string(5000, ' ')}) {
    test::write_file(folder / "x.bin", content);
    expect_file_error([&] { load_brdf(folder / "x.bin"); }, {"x.bin", "expected one of", "MERL", ".bsdf", "fit.json", "table.exr"});
  }
  expect_file_error([&] { load_brdf(folder / "none"); }, {"none", "No such file"});
  expect_file_error([&] { load_brdf(folder.path()); }, {"folder"});
}

TEST(HostileFiles, FormatIsFoundFromTheContentNotTheName) {
  TemporaryFolder folder;
  test::write_file(folder / "a.exr", " \n{\"kd\": [1, 1, 1], \"lobes\": []}");
  EXPECT_EQ(load_brdf(folder / "a.exr")->description(), "Cook-Torrance, 0 lobes");
  test::write_file(folder / "b.json", test::constant_rgl_file().content());
  EXPECT_EQ(load_brdf(folder / "b.json")->description().find("RGL"), 0u);
}

TEST(HostileFiles, MerlWithOtherDimensionsIsRecognisedAndRefused) {
  TemporaryFolder folder;
  std::string small;
  for (const std::int32_t n : {2, 3, 4}) small += test::raw(n);
  test::write_file(folder / "m.binary", small + std::string(3 * 24 * 8, '\0'));
  expect_file_error([&] { load_brdf(folder / "m.binary"); }, {"m.binary", "588 bytes, expected 34992012", "MERL"});
}

TEST(HostileRgl, EveryTruncationIsAnError) {
  TemporaryFolder folder;
  const std::string whole = test::constant_rgl_file().content();
  ASSERT_TRUE(loads_or_says_why(folder / "t.bsdf", whole));
  for (std::size_t size = 0; size < whole.size(); ++size)
    EXPECT_FALSE(loads_or_says_why(folder / "t.bsdf", whole.substr(0, size))) << size;
}

void expect_rgl_error(const TensorWriter& file, const std::vector<std::string>& parts) {
  TemporaryFolder folder;
  test::write_file(folder / "t.bsdf", file.content());
  expect_file_error([&] { load_brdf(folder / "t.bsdf"); }, parts);
}

TEST(HostileRgl, SizesThatOverflowOrExceedTheFileAreRefusedBeforeAllocation) {
  for (const std::vector<std::uint64_t>& shape :
       {std::vector<std::uint64_t>{1ull << 32, 1ull << 32}, {1ull << 63, 2}, {~0ull, ~0ull}, {1ull << 62, 4}, {0, 1ull << 63}, {1ull << 40, 0}}) {
    TensorWriter file = test::constant_rgl_file();
    file.at("ndf").shape = shape;
    expect_rgl_error(file, {"t.bsdf: ndf"});
  }
  TensorWriter deep = test::constant_rgl_file();
  deep.at("description").shape.assign(60000, 1);
  expect_rgl_error(deep, {"description: expected at most 16 dimensions, got 60000"});
}

TEST(HostileRgl, NamesTheFieldThatIsWrong) {
  const auto with = [](const std::function<void(TensorWriter&)>& change) {
    TensorWriter file = test::constant_rgl_file();
    change(file);
    return file;
  };
  const std::vector<float> ones(4, 1.0f);
  for (const char* field : {"theta_i", "phi_i", "ndf", "sigma", "vndf", "jacobian"})
    expect_rgl_error(with([&](auto& f) { f.remove(field); }), {std::string("t.bsdf: ") + field + ": field is missing"});
  expect_rgl_error(with([](auto& f) { f.remove("rgb"); }), {"expected a field rgb or the fields spectra and wavelengths"});
  expect_rgl_error(with([](auto& f) { f.at("ndf").type = 5; }), {"ndf: expected float32, got uint32"});
  expect_rgl_error(with([](auto& f) { f.at("ndf").type = 12; }), {"ndf: unknown element type 12"});
  expect_rgl_error(with([](auto& f) { f.at("ndf").shape = {4}; }), {"ndf: expected 2 dimensions, got 1"});
  expect_rgl_error(with([](auto& f) { f.at("ndf").shape = {4, 1}; }), {"ndf: dimension 1: expected at least 2 nodes, got 1"});
  expect_rgl_error(with([](auto& f) { f.at("vndf").shape = {2, 1, 2, 2}; }), {"vndf: dimension 0: expected 1, got 2"});
  expect_rgl_error(with([](auto& f) { f.at("rgb").shape = {1, 2, 2, 3, 2}; }), {"rgb: dimension 2: expected 3, got 2"});
  expect_rgl_error(with([](auto& f) { f.floats("ndf", {2, 2}, {1, std::nanf(""), 1, 1}); }), {"ndf: value 1", "nan"});
  expect_rgl_error(with([](auto& f) { f.floats("sigma", {2, 2}, {1, 1, -1, 1}); }), {"sigma: value 2", "-1"});
  expect_rgl_error(with([](auto& f) { f.floats("vndf", {1, 2, 2, 2}, std::vector<float>(8, 0.0f)); }), {"vndf", "0 everywhere"});
  expect_rgl_error(with([](auto& f) { f.floats("theta_i", {2}, {0.5f, 0.5f}); }), {"theta_i: expected ascending"});
  expect_rgl_error(with([](auto& f) { f.floats("theta_i", {2}, {0.5f, 5.0f}); }), {"theta_i: value 1"});
  expect_rgl_error(with([](auto& f) { f.floats("theta_i", {0}, {}); }), {"theta_i: expected at least one value"});
  expect_rgl_error(with([](auto& f) { f.bytes("jacobian", std::string(1, '\0')); }), {"jacobian: expected the one value 1"});
  expect_rgl_error(with([&](auto& f) { f.fields.push_back(f.fields.back()); }), {"jacobian: appears twice"});
}

TEST(HostileRgl, VersionAndFieldCountAreChecked) {
  TemporaryFolder folder;
  std::string content = test::constant_rgl_file().content();
  content[12] = 2;
  test::write_file(folder / "t.bsdf", content);
  expect_file_error([&] { load_brdf(folder / "t.bsdf"); }, {"expected tensor file version 1.0, got 2.0"});
  content = test::constant_rgl_file().content();
  content.replace(14, 4, "\xff\xff\xff\xff");
  test::write_file(folder / "t.bsdf", content);
  expect_file_error([&] { load_brdf(folder / "t.bsdf"); }, {"at most 1000 fields, got 4294967295"});
}

TEST(HostileRgl, TinyAndHugeNumbersGiveNoInfinity) {
  TemporaryFolder folder;
  constexpr float tiny = 1e-45f, huge = 3e38f;
  for (const float sigma : {0.0f, tiny, huge})
    for (const float density : {tiny, huge}) {
      TensorWriter file = test::constant_rgl_file();
      file.floats("sigma", {2, 2}, std::vector<float>(4, sigma));
      file.floats("ndf", {2, 2}, std::vector<float>(4, huge));
      file.floats("vndf", {1, 2, 2, 2}, std::vector<float>(8, density));
      file.floats("rgb", {1, 2, 3, 2, 2}, std::vector<float>(24, huge));
      EXPECT_TRUE(loads_or_says_why(folder / "t.bsdf", file.content()));
    }
}

TEST(HostileRgl, RandomDamageIsSurvived) {
  TemporaryFolder folder;
  const std::string whole = test::constant_rgl_file().content();
  std::mt19937 rng(1);
  int n_loaded = 0;
  for (int i = 0; i < 600; ++i) n_loaded += loads_or_says_why(folder / "t.bsdf", test::damaged(whole, rng, 400));
  EXPECT_GT(n_loaded, 20);  // the damage is not so heavy that only the first check is ever reached
  EXPECT_LT(n_loaded, 590);
}

TEST(HostileJson, RandomDamageIsSurvived) {
  TemporaryFolder folder;
  const std::string whole = test::slurp(test::source_dir() / "data-samples/paints/white.json");
  std::mt19937 rng(2);
  int n_loaded = 0;
  for (int i = 0; i < 600; ++i) n_loaded += loads_or_says_why(folder / "p.json", test::damaged(whole, rng, whole.size()));
  EXPECT_GT(n_loaded, 20);
  EXPECT_LT(n_loaded, 590);
}

TEST(HostileJson, EveryTruncationIsAnError) {
  TemporaryFolder folder;
  std::string whole = test::slurp(test::source_dir() / "data-samples/paints/white.json");
  whole.resize(whole.find_last_of('}') + 1);
  for (std::size_t size = 0; size < whole.size(); ++size) EXPECT_FALSE(loads_or_says_why(folder / "p.json", whole.substr(0, size))) << size;
}

/// A compressed one-channel table with a few cells in every row.
std::string small_exr(const TemporaryFolder& folder) {
  HalfAngleTable table(1);
  auto& channel = table.channels[0];
  for (std::size_t i = 0; i < TableGrid::n_cells; i += 1001) {
    channel.origin[i] = CellOrigin::measured;
    channel.mean[i] = static_cast<float>(i);
    channel.count[i] = 1;
  }
  write_table(folder / "good.exr", table);
  return test::slurp(folder / "good.exr");
}

TEST(HostileExr, TruncationIsAnError) {
  TemporaryFolder folder;
  const std::string whole = small_exr(folder);
  for (std::size_t size = 0; size < 1200; size += size < 40 ? 1 : 23)
    EXPECT_FALSE(loads_or_says_why(folder / "t.exr", whole.substr(0, size))) << size;
  for (const std::size_t size : {whole.size() / 2, whole.size() - 1}) EXPECT_FALSE(loads_or_says_why(folder / "t.exr", whole.substr(0, size))) << size;
}

TEST(HostileExr, RandomDamageOfTheHeaderIsSurvived) {
  TemporaryFolder folder;
  const std::string whole = small_exr(folder);
  std::mt19937 rng(3);
  int n_loaded = 0;
  for (int i = 0; i < 16; ++i) n_loaded += loads_or_says_why(folder / "t.exr", test::damaged(whole, rng, 1300));
  EXPECT_LT(n_loaded, 16);
}

TEST(HostileExr, RandomDamageOfThePixelsIsSurvived) {
  TemporaryFolder folder;
  const std::string whole = small_exr(folder);
  std::mt19937 rng(4);
  for (int i = 0; i < 5; ++i) loads_or_says_why(folder / "t.exr", test::damaged(whole, rng, whole.size()));
}

TEST(HostileExr, AttributesThatAskForGigabytesAreRefusedBeforeAllocation) {
  TemporaryFolder folder;
  const test::ExrWriter exr;
  std::string content = exr.content();
  for (const char* name : {"lacquer.provenance", "channels", "dataWindow"}) {
    std::string damaged = content;
    const std::size_t type = damaged.find(name) + std::string(name).size() + 1;
    damaged.replace(damaged.find('\0', type) + 1, 4, test::raw(std::int32_t{2000000000}));
    test::write_file(folder / "t.exr", damaged);
    expect_file_error([&] { load_brdf(folder / "t.exr"); }, {"t.exr", "damaged or truncated"});
  }
}

TEST(HostileMerl, TruncationsAndDamagedHeadersAreErrors) {
  TemporaryFolder folder;
  const auto file = folder / "m.binary";
  const std::string dims = test::raw(std::int32_t{90}) + test::raw(std::int32_t{90}) + test::raw(std::int32_t{180});
  for (const std::uintmax_t size : {12u, 13u, 1000u, 34992011u, 34992013u, 69984012u, 1u << 31}) {
    test::write_file(file, dims);
    std::filesystem::resize_file(file, size);  // sparse: costs nothing
    expect_file_error([&] { load_brdf(file); }, {"m.binary", "expected 34992012"});
  }
  std::mt19937 rng(5);
  for (int i = 0; i < 200; ++i) {
    std::string damaged = dims;
    for (std::size_t k = 0, n = 1 + rng() % 4; k < n; ++k) damaged[rng() % 12] = static_cast<char>(rng());
    if (damaged == dims) continue;
    test::write_file(file, damaged);
    std::filesystem::resize_file(file, 34992012);
    expect_file_error([&] { load_brdf(file); }, {"m.binary"});
  }
}

TEST(HostileMbsdf, RandomDamageIsSurvived) {
  TemporaryFolder folder;
  write_mbsdf(folder / "good.mbsdf", CookTorranceBrdf({.kd = glm::dvec3(0.5), .lobes = {}}), {.n_theta = 3, .n_phi = 4});
  const std::string whole = test::slurp(folder / "good.mbsdf");
  std::mt19937 rng(6);
  int n_loaded = 0;
  for (int i = 0; i < 600; ++i) n_loaded += loads_or_says_why(folder / "t.mbsdf", test::damaged(whole, rng, 200));
  EXPECT_GT(n_loaded, 20);
  EXPECT_LT(n_loaded, 590);
}

TEST(HostileCsv, RandomDamageIsSurvived) {
  TemporaryFolder folder;
  HalfAngleTable table(1);
  for (std::size_t i = 0; i < 6; ++i) {
    table.channels[0].origin[200000 * i] = CellOrigin::measured;
    table.channels[0].mean[200000 * i] = static_cast<float>(i);
  }
  write_table_csv(folder / "good.csv", table);
  const std::string whole = test::slurp(folder / "good.csv");
  std::mt19937 rng(7);
  int n_loaded = 0;
  for (int i = 0; i < 60; ++i) n_loaded += loads_or_says_why(folder / "t.csv", test::damaged(whole, rng, whole.size()));
  EXPECT_GT(n_loaded, 2);
  EXPECT_LT(n_loaded, 59);
}

TEST(HostileNpy, RandomDamageOfTheHeaderIsSurvived) {
  TemporaryFolder folder;
  write_table_npy(folder / "t.npy", HalfAngleTable(1), false);
  const std::string header = test::slurp(folder / "t.npy").substr(0, 128);
  std::mt19937 rng(8);
  for (int i = 0; i < 300; ++i) {
    test::write_file(folder / "t.npy", test::damaged(header, rng, header.size()));
    const auto size = std::filesystem::file_size(folder / "t.npy");
    if (i % 50 == 0) std::filesystem::resize_file(folder / "t.npy", size + 4 * TableGrid::n_cells);  // sparse; 0 in every cell
    try {
      expect_finite_values(*load_brdf(folder / "t.npy"));
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::file) << e.what();
    }
  }
}

}  // namespace
}  // namespace lacquer::brdf
