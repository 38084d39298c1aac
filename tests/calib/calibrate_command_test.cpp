#include "core/json.h"
#include "core/rig.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;

TEST_CASE("the real array of 20 cameras is calibrated as its truth says") {
  STUV_NEED_SHARED_DATA(data);
  const test::TempFolder folder;
  const std::string rec = (folder / "rec").string(), rig = (folder / "rig").string();
  const std::string pattern = (data / "array20" / "Position{set}_Camera{camera}.png").string();
  REQUIRE(test::run_stuv("capture --files '" + pattern + "' --grid 1x20 -o " + rec).exit_code == 0);

  const auto incomplete =
      test::run_stuv("calibrate " + rec + " -o " + rig + " --complete --board chessboard:28x17:20mm");
  CHECK(incomplete.exit_code == 1);
  CHECK_THAT(incomplete.err, Contains("set 113 is incomplete"));
  CHECK(test::line_count(incomplete.err) == 1);
  const auto unnamed = test::run_stuv("calibrate " + rec + " -o " + rig);
  CHECK(unnamed.exit_code == 1);
  CHECK_THAT(unnamed.err, Contains("--board"));
  CHECK_FALSE(std::filesystem::exists(rig));

  const auto run = test::run_stuv("calibrate " + rec + " -o " + rig + " --board chessboard:28x17:20mm");
  INFO(run.out << run.err);
  REQUIRE(run.exit_code == 0);
  const Json report = read_json(std::filesystem::path(rig) / "report.json");
  CHECK(report["rms_px"] <= 0.065);
  CHECK(report["outlier_fraction"] < 0.025);
  CHECK(report["plane"]["spacing_m"][0] > 0.0675);
  CHECK(report["plane"]["spacing_m"][0] < 0.069);
  CHECK(report["plane"]["spacing_m"][1].is_null());
  const Rig read = read_rig(rig);
  CHECK(read.rows == 1);
  CHECK(read.cols == 20);
  for (int c = 1; c < 19; ++c)
    for (int axis = 0; axis < 2; ++axis) {
      CHECK(read.cameras[c].camera.intrinsics[axis] > 1050);
      CHECK(read.cameras[c].camera.intrinsics[axis] < 1070);
    }
}

TEST_CASE("a board that is seen nowhere is named") {
  STUV_NEED_SHARED_DATA(data);
  const test::TempFolder folder;
  const std::string rec = (folder / "rec").string(), rig = (folder / "rig").string();
  const std::string pattern = (data / "array20" / "Position{set}_Camera{camera}.png").string();
  REQUIRE(test::run_stuv("capture --files '" + pattern + "' --grid 1x20 --sets 1 -o " + rec).exit_code == 0);
  // Larger than the board that is there.
  const auto run = test::run_stuv("calibrate " + rec + " -o " + rig + " --board chessboard:60x40:20mm");
  CHECK(run.exit_code == 1);
  CHECK_THAT(run.err, Contains("chessboard:60x40:20mm") && Contains("seen in none"));
  CHECK_FALSE(std::filesystem::exists(rig));
}
