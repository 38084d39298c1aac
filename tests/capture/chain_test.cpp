// Frames of cameras, as their devices deliver them, through the rest of the program.
#include <fmt/format.h>

#include "capture/cameras/camera_source.h"
#include "capture/capture.h"
#include "core/light_field.h"
#include "core/recording.h"
#include "tests/capture/fake_camera.h"
#include "tests/capture/support.h"

using namespace stuv;
using namespace stuv::test;
namespace fs = std::filesystem;

namespace {

const char* const kSetNames[] = {"board00", "board01", "board02", "board03",
                                 "board04", "board05", "board06", "scene00"};

std::vector<std::byte> bytes_of(const fs::path& file) {
  const std::string text = read_text(file);
  const auto bytes = std::as_bytes(std::span(text));
  return {bytes.begin(), bytes.end()};
}

/// A camera that has the pictures of samples/frames in front of it: the JPEG stream as it is, or its pixels.
FakeCameraOptions sample_camera(const std::string& name, bool jpeg) {
  FakeCameraOptions fake;
  fake.fps = 4;  // slow enough that no stall of a busy machine brings two poses into one set
  for (const char* set : kSetNames) {
    const fs::path file =
        fs::path(STUV_SOURCE_DIR) / "samples" / "frames" / fmt::format("{}_{}.jpg", set, name);
    fake.frames.push_back(jpeg ? bytes_of(file) : read_image(file).bytes);
  }
  fake.format = {jpeg ? "MJPG" : "RGB3", 400, 300, jpeg ? 0 : 1200};
  fake.format.full_range = true;
  return fake;
}

}  // namespace

TEST_CASE("cameras: MJPEG and raw frames go from the devices to an all-in-focus picture") {
  const TempFolder folder;
  const fs::path rec = folder / "rec", rig = folder / "rig", scene = folder / "scene";
  CameraSourceOptions options;
  options.rows = options.cols = 3;
  for (int row = 0; row < 3; ++row)
    for (int col = 0; col < 3; ++col) {
      CameraSettings camera;
      camera.name = fmt::format("r{}c{}", row, col);
      camera.id = "fake:" + camera.name;
      camera.row = row;
      camera.col = col;
      options.cameras.push_back(camera);
    }
  const auto source = open_cameras(options, {}, nullptr, {}, [](const CameraSettings& settings) {
    return std::make_unique<FakeCamera>(settings, sample_camera(settings.name, settings.row < 2));
  });
  CaptureOptions limit;
  limit.sets = 8;
  capture(*source, rec, limit);

  std::string scene_set;
  for (const FrameSet& set : open_recording(rec).sets) {
    REQUIRE(set.complete());
    for (const Frame& frame : set.frames) REQUIRE(frame.sequence == set.frames[0].sequence);
    if (set.frames[0].sequence % 8 == 7) scene_set = set.name;
  }
  REQUIRE_FALSE(scene_set.empty());

  const auto run = [](const std::string& arguments) {
    const ProgramResult result = run_stuv(arguments);
    CAPTURE(arguments, result.out, result.err);
    REQUIRE(result.exit_code == 0);
  };
  run(fmt::format("calibrate {} -o {} --board chessboard:8x5:50mm", rec.string(), rig.string()));
  const Json report = read_json(rig / "report.json");
  CHECK(report["rms_px"] < 0.15);
  // samples/frames/how-made.toml: 30 mm, and places off it by 1 mm.
  for (const Json& spacing : report["plane"]["spacing_m"])
    CHECK(spacing.get<double>() == Approx(0.03).margin(8e-4));
  run(fmt::format("rectify {} --rig {} -o {} --set {}", rec.string(), rig.string(), scene.string(),
                  scene_set));
  const fs::path picture = folder / "sharp.png";
  run(fmt::format("render {} -o {} --at 0.015,0.015 --planes 24 --window 3 --method fast", scene.string(),
                  picture.string()));
  CHECK(read_image(picture).width == open_light_field(scene).width);
}
