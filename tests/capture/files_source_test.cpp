#include "capture/files_source.h"

#include <fstream>

#include "capture/capture.h"
#include "core/error.h"
#include "tests/capture/support.h"

using namespace stuv;
using namespace stuv::test;
namespace fs = std::filesystem;
using Catch::Matchers::Contains;

namespace {

FilesOptions options_in(const TempFolder& folder, int rows, int cols) {
  FilesOptions options;
  options.pattern = (folder / "in" / "s{set}_c{camera}.png").string();
  options.rows = rows;
  options.cols = cols;
  return options;
}

}  // namespace

TEST_CASE("files: cameras fill the grid in natural order and sets keep their names") {
  const TempFolder folder;
  write_pictures(folder / "in", {"2", "10"}, {"1", "2", "10", "9"});
  const auto source = open_files(options_in(folder, 2, 2));
  capture(*source, folder / "rec", {});
  const Recording recording = open_recording(folder / "rec");
  REQUIRE(recording.sets.size() == 2);
  CHECK(recording.sets[0].name == "2");
  CHECK(recording.sets[1].name == "10");
  std::string order;
  for (const RecordedCamera& camera : recording.cameras)
    order += camera.name + "@" + std::to_string(camera.row) + std::to_string(camera.col) + " ";
  CHECK(order == "1@00 2@01 9@10 10@11 ");
  CHECK(recording.sets[0].frames[3].file == folder / "in" / "s2_c10.png");
}

TEST_CASE("files: copied frames lie in the recording") {
  const TempFolder folder;
  write_pictures(folder / "in", {"1"}, {"1", "2"});
  FilesOptions options = options_in(folder, 1, 2);
  options.copy = true;
  capture(*open_files(options), folder / "rec", {});
  fs::remove_all(folder / "in");
  const Recording recording = open_recording(folder / "rec");
  CHECK(read_image(recording.sets.at(0).frames.at(1).file).bytes == flat_image(8, 6, 99).bytes);
}

TEST_CASE("files: an incomplete set is kept with one warning, or refused") {
  const TempFolder folder;
  write_pictures(folder / "in", {"1", "2"}, {"1", "2", "3"}, {"2/1", "2/3"});
  FilesOptions options = options_in(folder, 1, 3);
  std::vector<std::string> warnings;
  Reporter reporter;
  reporter.warning = [&](std::string_view line) { warnings.emplace_back(line); };
  const CaptureResult result = capture(*open_files(options), folder / "rec", {}, reporter);
  CHECK(result.incomplete_sets == 1);
  CHECK(result.frames == 4);
  REQUIRE(warnings.size() == 1);
  CHECK_THAT(warnings[0], Contains("set 2") && Contains("1, 3"));
  const Recording recording = open_recording(folder / "rec");
  CHECK(recording.sets.at(1).frames.at(0).status == FrameStatus::missing);
  CHECK(recording.sets.at(1).frames.at(1).status == FrameStatus::ok);

  options.complete = true;
  CHECK_THROWS_WITH(open_files(options), Contains("set 2") && Contains("camera 1, 3"));
}

TEST_CASE("files: names lay the grid out, empty ones are empty places") {
  const TempFolder folder;
  write_pictures(folder / "in", {"1"}, {"left", "right", "unused"});
  FilesOptions options = options_in(folder, 1, 3);
  options.names = {"right", "", "left"};
  const auto source = open_files(options);
  REQUIRE(source->cameras().size() == 2);
  CHECK(source->cameras()[0].name == "right");
  CHECK(source->cameras()[1].col == 2);
  options.names = {"right", "gone", "left"};
  CHECK_THROWS_WITH(open_files(options), Contains("camera gone has no picture"));
  options.names = {"right"};
  CHECK_THROWS_WITH(open_files(options), Contains("1 names are listed for the 3 places"));
}

TEST_CASE("files: too few and too many cameras say so") {
  const TempFolder folder;
  write_pictures(folder / "in", {"1"}, {"01", "02", "04", "05"});
  CHECK_THROWS_WITH(open_files(options_in(folder, 1, 5)),
                    Contains("4 cameras found for the 5 places") && Contains("03"));
  CHECK_THROWS_WITH(open_files(options_in(folder, 1, 3)), Contains("4 cameras found for the 3 places"));
}

TEST_CASE("files: damaged and unlike pictures are named before anything is written") {
  const TempFolder folder;
  write_pictures(folder / "in", {"1", "2"}, {"1", "2"});
  const fs::path bad = folder / "in" / "s2_c2.png";
  SECTION("truncated") {
    fs::resize_file(bad, fs::file_size(bad) / 2);
    CHECK_THROWS_WITH(open_files(options_in(folder, 1, 2)), Contains(bad.string()));
  }
  SECTION("no picture at all") {
    std::ofstream(bad, std::ios::trunc) << "hello";
    CHECK_THROWS_WITH(open_files(options_in(folder, 1, 2)), Contains(bad.string()));
  }
  SECTION("of another size") {
    write_image(bad, flat_image(9, 6, 99));
    CHECK_THROWS_WITH(open_files(options_in(folder, 1, 2)), Contains(bad.string()) && Contains("9x6"));
  }
}

TEST_CASE("files: patterns with folders, repeated groups and special characters") {
  const TempFolder folder;
  write_pictures(folder / "in (1)+[x]" / "a1", {"a1"}, {"7"});
  write_pictures(folder / "in (1)+[x]" / "a2", {"a2", "a1"}, {"7"});
  FilesOptions options;
  options.base = folder.path();
  options.pattern = "in (1)+[x]/{set}/s{set}_c{camera}.png";
  options.rows = options.cols = 1;
  CHECK(open_files(options)->set_count() == 2);
  options.pattern = "in (1)+[x]/{set}/s{set}_c{camera}xpng";
  CHECK_THROWS_WITH(open_files(options), Contains("matches no file"));
}

TEST_CASE("files: the program refuses bad input in one line and leaves nothing behind") {
  const TempFolder folder;
  write_pictures(folder / "in", {"1", "2"}, {"1", "2", "3"}, {"2/3"});
  write_pictures(folder / "bad", {"1"}, {"1"});
  fs::resize_file(folder / "bad" / "s1_c1.png", 40);
  const std::string out = " -o " + (folder / "rec").string();
  const auto files = [&](const std::string& in) {
    return "capture --files '" + (folder / in).string() + "/s{set}_c{camera}.png'" + out;
  };
  const std::vector<std::tuple<std::string, int, std::string>> cases = {
      {files("in") + " --grid 1x4", 1, "3 cameras found for the 4 places"},
      {files("in") + " --grid 1x2", 1, "3 cameras found for the 2 places"},
      {files("in") + " --grid 1x3 --complete", 1, "set 2 is incomplete: no picture of camera 3"},
      {files("bad") + " --grid 1x1", 1, "s1_c1.png"},
      {files("nowhere") + " --grid 1x1", 1, "nowhere"},
      {"capture " + (folder / "no.toml").string() + out, 1, "no.toml"},
      {files("in"), 2, "--grid"},
      {files("in") + " --grid 0x3", 2, "--grid"},
  };
  for (const auto& [arguments, exit_code, words] : cases) {
    const ProgramResult result = run_stuv(arguments);
    CAPTURE(arguments, result.err);
    CHECK(result.exit_code == exit_code);
    CHECK(line_count(result.err) == 1);
    CHECK_THAT(result.err, Contains(words));
    CHECK_FALSE(fs::exists(folder / "rec"));
    for (const auto& entry : fs::directory_iterator(folder.path()))
      CHECK(entry.path().filename().string()[0] != '.');
  }
}

TEST_CASE("files: the real array has four sets of 20 cameras, and 113 lacks 16 to 20") {
  STUV_NEED_SHARED_DATA(data);
  const TempFolder folder;
  const ProgramResult result =
      run_stuv("capture --files '" + (data / "array20").string() +
               "/Position{set}_Camera{camera}.png' --grid 1x20 -o " + (folder / "rec").string());
  CAPTURE(result.err);
  REQUIRE(result.exit_code == 0);
  CHECK_THAT(result.err, Contains("set 113 is incomplete: no good frame of camera 16, 17, 18, 19, 20"));
  const Recording recording = open_recording(folder / "rec");
  CHECK(recording.cameras.size() == 20);
  REQUIRE(recording.sets.size() == 4);
  CHECK(recording.sets[0].complete());
  CHECK(recording.sets[3].name == "113");
  CHECK(recording.sets[3].frames[14].status == FrameStatus::ok);
  CHECK(recording.sets[3].frames[15].status == FrameStatus::missing);
}

TEST_CASE(
    "files: a camera without any picture is named, also the first, the last, and where names are no "
    "numbers") {
  const test::TempFolder folder;
  const auto picture = from_float(ImageF(8, 8, 1, 0.5F), PixelType::u8);
  const auto fails_with = [&](const std::string& text) {
    FilesOptions options;
    options.pattern = (folder / "s{set}_{camera}.png").string();
    options.rows = 1;
    options.cols = 4;
    CHECK_THROWS_WITH(open_files(options), Catch::Contains(text));
  };
  for (const char* name : {"02", "03", "04"})
    write_image(folder / (std::string("s1_") + name + ".png"), picture);
  fails_with("without any picture: 01");
  std::filesystem::rename(folder / "s1_04.png", folder / "s1_01.png");
  fails_with("without any picture: 04");
  std::filesystem::rename(folder / "s1_01.png", folder / "s1_left.png");
  fails_with("namely 02, 03, left");
}
