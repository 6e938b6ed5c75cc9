#include <gtest/gtest.h>

#include "libacquire/image_header.h"
#include "libacquire/rig_description.h"
#include "libbrdf/error.h"
#include "tests/seeded_damage.h"
#include "tests/test_support.h"

/// Damaged rig files and images: each is read or refused with one line. A crash, a hang or another exception fails.
namespace lacquer::acquire {
namespace {

std::string content_of(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

template <typename Call>
bool works_or_says_why(const Call& call) {
  try {
    call();
    return true;
  } catch (const Error& e) {
    EXPECT_EQ(std::string(e.what()).find('\n'), std::string::npos) << e.what();
  } catch (const std::exception& e) {
    ADD_FAILURE() << "not a lacquer::Error: " << e.what();
  }
  return false;
}

TEST(HostileRigFile, RandomDamageIsSurvived) {
  const auto file = test::source_dir() / "rigs/simulated-quick.toml";
  const std::string whole = content_of(file);
  std::mt19937 rng(9);
  int n_read = 0;
  for (int i = 0; i < 400; ++i) {
    const std::string text = test::damaged(whole, rng, whole.size());
    n_read += works_or_says_why([&] { parse_rig(text, file); });
  }
  EXPECT_GT(n_read, 5);
  EXPECT_LT(n_read, 395);
}

TEST(HostileRigFile, TextThatIsNotUtf8IsRefusedWithItsLineBeforeTheParserSeesIt) {
  const auto file = test::source_dir() / "rigs/simulated-quick.toml";
  const std::string whole = content_of(file);
  EXPECT_NO_THROW(parse_rig("# \xc3\xa4 \xe2\x82\xac \xf0\x9f\x98\x80\n" + whole, file));
  // Never a first byte, cut off, too long a code, a surrogate, beyond U+10FFFF.
  for (const char* bad : {"\xff", "\xc3", "\xe2\x82", "\xc0\xaf", "\xe0\x80\xaf", "\xed\xa0\x80", "\xf4\x90\x80\x80", "\xf5\x80\x80\x80"})
    try {
      parse_rig("# one\n'" + std::string(bad) + "' = 1\n", "r.toml");
      ADD_FAILURE() << "accepted";
    } catch (const Error& e) {
      EXPECT_EQ(std::string(e.what()), "r.toml:2: not valid TOML: expected UTF-8");
    }
}

TEST(HostileRigFile, DeepNestingIsRefused) {
  for (const std::string& open : {std::string("["), std::string("{a=")})
    works_or_says_why([&] {
      std::string text = "a = ";
      for (int i = 0; i < 200000; ++i) text += open;
      parse_rig(text, "deep.toml");
      FAIL() << "an endless bracket is not a rig";
    });
}

TEST(HostileImage, RandomDamageOfATiffHeaderIsSurvived) {
  std::string whole;
  for (const auto& entry : std::filesystem::directory_iterator(test::source_dir() / "data-samples/session-tiny/frames"))
    if (entry.path().extension() == ".tiff" && (whole.empty() || entry.path().filename() < "L001")) whole = content_of(entry.path());
  ASSERT_FALSE(whole.empty());
  std::mt19937 rng(10);
  for (int i = 0; i < 3000; ++i) {
    const std::string bytes = test::damaged(whole, rng, 400);
    works_or_says_why([&] { read_image_header(std::as_bytes(std::span(bytes)), "t.tiff"); });
  }
}

}  // namespace
}  // namespace lacquer::acquire
