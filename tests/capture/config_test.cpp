#include "capture/config.h"

#include "core/error.h"
#include "tests/capture/support.h"

using namespace stuv;
using Catch::Matchers::Contains;

TEST_CASE("config: every file in configs/ loads") {
  int files = 0;
  for (const auto& entry :
       std::filesystem::directory_iterator(std::filesystem::path(STUV_SOURCE_DIR) / "configs")) {
    if (entry.path().extension() != ".toml") continue;
    const std::string text = read_text(entry.path());
    if (text.find("[source]") == std::string::npos) continue;  // another room's
    CAPTURE(entry.path());
    CHECK_NOTHROW(read_capture_config(entry.path()));
    ++files;
  }
  CHECK(files >= 5);
}

TEST_CASE("config: values arrive") {
  const auto config =
      read_capture_config(std::filesystem::path(STUV_SOURCE_DIR) / "configs" / "synthetic-3x3-rough.toml");
  const auto& options = std::get<synthetic::SyntheticOptions>(config);
  CHECK(options.rig.seed == 3);
  CHECK(options.rig.spacing_m == std::array{0.06, 0.05});
  CHECK(options.rig.missing == std::vector<std::string>{"r0c1", "r2c2"});
  CHECK(options.rig.jitter.focal_relative == 0.02);
  CHECK(options.board_sets == 12);
  const auto built_in = std::get<synthetic::SyntheticOptions>(default_capture_config());
  CHECK(built_in.rig.rows == 5);
  CHECK(built_in.rig.cols == 5);
}

TEST_CASE("config: what is wrong is named with file, line and key") {
  const auto [text, words] = GENERATE(table<std::string, std::string>({
      {"[source]\nkind = \"synthetic\"\n[rig]\nrosw = 3\n", "bad.toml:4: unknown key rig.rosw"},
      {"[source]\nkind = \"synthetic\"\n[rig.jitter]\nx = 3\n", "bad.toml:4: unknown key rig.jitter.x"},
      {"[source]\nkind = \"synthetic\"\n[rgi]\n", "bad.toml:3: unknown key rgi"},
      {"[source]\nkind = \"synthetic\"\n[rig]\nrows = \"x\"\n",
       "bad.toml:4: rig.rows must be a whole number"},
      {"[source]\nkind = \"synthetic\"\n[rig]\nrows = 0\n", "rig.rows x cols is 0x5"},
      {"[source]\nkind = \"synthetic\"\n[rig]\nfocal_px = nan\n", "rig.focal_px is nan"},
      {"[source]\nkind = \"synthetic\"\n[rig]\nmissing = [\"r9c0\"]\n", "rig.missing names 'r9c0'"},
      {"[source]\nkind = \"synthetic\"\n[board]\ncorners = [2, 7]\n", "board.corners is 2x7"},
      {"[source]\nkind = \"synthetic\"\n[sets]\nboards = 0\nscenes = 0\n", "sets.boards and sets.scenes"},
      {"[source]\nkind = \"files\"\npattern = \"x.png\"\n", "source.pattern is 'x.png'"},
      {"[source]\nkind = \"files\"\npattern = \"{camera}.png\"\nseed = 1\nrows = 1\ncols = 1\n",
       "bad.toml:4: unknown key source.seed"},
      {"[source]\nkind = \"v4l3\"\n", "source.kind is 'v4l3'"},
      {"[source\n", "bad.toml:1"},
  }));
  CHECK_THROWS_WITH(parse_capture_config(text, "bad.toml"), Contains(words));
  CHECK_THROWS_AS(parse_capture_config(text, "bad.toml"), Error);
}
