#include "capture/capture.h"

#include <fmt/format.h>

#include <fstream>

#include "core/error.h"
#include "tests/capture/support.h"

using namespace stuv;
using namespace stuv::test;
namespace fs = std::filesystem;
using Catch::Matchers::Contains;

namespace {

constexpr unsigned char kTwoBytes[] = {1, 2};

/// Three cameras: pixels, raw bytes, and one that fails in set 1; breaks down before set `breaks_at`.
class FakeSource final : public Source {
 public:
  explicit FakeSource(int breaks_at = 100, bool same_name = false)
      : breaks_at_(breaks_at), same_name_(same_name) {}
  int rows() const override { return 1; }
  int cols() const override { return 3; }
  const std::vector<RecordedCamera>& cameras() const override { return cameras_; }
  Json description() const override { return {{"kind", "fake"}}; }
  std::optional<SourceSet> next() override {
    if (set_ == breaks_at_) throw Error("camera b", "is gone", "plug it in");
    SourceSet set{same_name_ ? "same" : std::to_string(set_), std::vector<SourceFrame>(3)};
    set.frames[0] = {FrameStatus::ok, flat_image(4, 4, 7), set_ * 2, 1000 + set_, ""};
    set.frames[1] = {FrameStatus::ok,
                     RawFrame{std::as_bytes(std::span(kTwoBytes)), nullptr, {"GREY", 2, 1, 2}}, set_,
                     2000 + set_, ""};
    set.frames[2] = {FrameStatus::ok, flat_image(4, 4, 8), set_, 3000 + set_, ""};
    if (set_ == 1) set.frames[2] = {FrameStatus::error, {}, 1, -1, "flagged bad by the driver"};
    ++set_;
    return set;
  }

 private:
  std::vector<RecordedCamera> cameras_ = {{"a", 0, 0}, {"b", 0, 1}, {"c", 0, 2}};
  int set_ = 0, breaks_at_;
  bool same_name_;
};

}  // namespace

TEST_CASE("capture: pixels, raw bytes, status, sequence and time arrive in the recording") {
  const TempFolder folder;
  FakeSource source;
  CaptureOptions options;
  options.sets = 3;
  const CaptureResult result = capture(source, folder / "rec", options);
  CHECK(result.sets == 3);
  CHECK(result.incomplete_sets == 1);
  CHECK(result.frames == 8);
  const Recording recording = open_recording(folder / "rec");
  REQUIRE(recording.sets.size() == 3);
  const FrameSet& set = recording.sets[1];
  CHECK(read_image(set.frames[0].file).bytes == flat_image(4, 4, 7).bytes);
  CHECK(set.frames[0].sequence == 2);
  CHECK(set.frames[0].timestamp_ns == 1001);
  CHECK(set.frames[1].file.extension() == ".raw");
  CHECK(read_text(set.frames[1].file).substr(kRawHeaderBytes) == "\x01\x02");
  CHECK(read_image(set.frames[1].file).bytes == std::vector{std::byte{1}, std::byte{2}});
  CHECK(set.frames[2].status == FrameStatus::error);
  CHECK(set.frames[2].problem == "flagged bad by the driver");
}

TEST_CASE("capture: a device that fails leaves the sets before, or nothing at all") {
  const TempFolder folder;
  FakeSource later(2), at_once(0);
  CHECK_THROWS_WITH(capture(later, folder / "rec", {}), Contains("camera b: is gone"));
  CHECK(open_recording(folder / "rec").sets.size() == 2);
  CHECK_THROWS_AS(capture(at_once, folder / "none", {}), Error);
  CHECK_FALSE(fs::exists(folder / "none"));
}

TEST_CASE("capture: complete, repeated names and existing folders are refused") {
  const TempFolder folder;
  CaptureOptions options;
  options.complete = true;
  FakeSource incomplete, repeating(100, true), fresh;
  CHECK_THROWS_WITH(capture(incomplete, folder / "a", options), Contains("set 1") && Contains("camera c"));
  CHECK_THROWS_WITH(capture(repeating, folder / "b", {}), Contains("same comes twice"));
  CHECK_THROWS_WITH(capture(fresh, folder / "b", {}), Contains("exists already"));
}

TEST_CASE("capture: killed at any moment, the sets that are there are whole") {
  const TempFolder folder;
  const fs::path config = folder / "small.toml";
  std::ofstream(config)
      << "[source]\nkind = \"synthetic\"\n[rig]\nrows = 1\ncols = 3\nwidth = 64\nheight = 48\n"
         "focal_px = 60\n[scene]\nkind = \"wall\"\n[sets]\nboards = 20\nscenes = 5\n";
  const fs::path rec = folder / "rec";
  int killed = 0, status = -1;
  for (double seconds = 0.04; status != 0 && seconds < 60; seconds *= 1.35) {
    const std::string line =
        fmt::format("timeout -s KILL {} {} capture {} -o {} --force >{} 2>&1", seconds, STUV_PROGRAM,
                    config.string(), rec.string(), (folder / "log").string());
    status = std::system(line.c_str());
    killed += status != 0 ? 1 : 0;
    if (!fs::exists(rec / "recording.json")) continue;
    const Recording recording = open_recording(rec);
    for (const FrameSet& set : recording.sets) {
      CHECK(set.complete());
      for (const Frame& frame : set.frames) CHECK(read_image(frame.file).width == 64);
    }
  }
  CHECK(killed > 0);
  CHECK(open_recording(rec).sets.size() == 25);
}
