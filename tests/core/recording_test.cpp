#include "core/recording.h"

#include "core/error.h"
#include "core/files.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;

namespace {

const std::vector<RecordedCamera> kCameras = {{"left", 0, 0}, {"right", 0, 1}};

void record(RecordingWriter& writer, const std::string& name, bool complete) {
  const auto work = writer.begin_set(name);
  write_text(work / "left.png", "pixels");
  FrameSet set{name, {{FrameStatus::ok, "left.png", 7, 123456789012345, {}}, {}}};
  if (complete) set.frames[1] = {FrameStatus::ok, "/elsewhere/right.png", -1, -1, {}};
  writer.commit_set(set);
}

}  // namespace

TEST_CASE("a recording survives a round trip") {
  const test::TempFolder folder;
  {
    RecordingWriter writer(folder / "rec", 1, 2, kCameras, {{"kind", "test"}}, false);
    record(writer, "set10", true);
    record(writer, "set9", false);
  }
  const Recording back = open_recording(folder / "rec");
  CHECK(back.rows == 1);
  CHECK(back.cols == 2);
  CHECK(back.source["kind"] == "test");
  REQUIRE(back.sets.size() == 2);
  CHECK(back.sets[0].name == "set9");
  CHECK_FALSE(back.sets[0].complete());
  CHECK(back.sets[1].complete());
  CHECK(back.sets[1].frames[0].file == folder / "rec/sets/set10/left.png");
  CHECK(back.sets[1].frames[0].timestamp_ns == 123456789012345);
  CHECK(back.sets[1].frames[1].file == "/elsewhere/right.png");
  CHECK(back.camera_index("right") == 1);
  CHECK(back.camera_index("middle") == -1);
  CHECK_THROWS_WITH(require_complete(back), Contains("set9") && Contains("right"));
}

TEST_CASE("a set that was not finished is not there, the others are") {
  const test::TempFolder folder;
  RecordingWriter writer(folder / "rec", 1, 2, kCameras, {}, false);
  record(writer, "a", true);
  write_text(writer.begin_set("b") / "left.png", "pix");
  const Recording during = open_recording(folder / "rec");
  REQUIRE(during.sets.size() == 1);
  CHECK(during.sets[0].name == "a");
}

TEST_CASE("a recording is only replaced by force, and force replaces recordings only") {
  const test::TempFolder folder;
  { RecordingWriter writer(folder / "rec", 1, 2, kCameras, {}, false); }
  CHECK_THROWS_WITH(RecordingWriter(folder / "rec", 1, 2, kCameras, {}, false), Contains("exists already"));
  CHECK_NOTHROW(RecordingWriter(folder / "rec", 1, 2, kCameras, {}, true));
  std::filesystem::create_directory(folder / "photos");
  write_text(folder / "photos/wedding.txt", "dear");
  CHECK_THROWS_WITH(RecordingWriter(folder / "photos", 1, 2, kCameras, {}, true),
                    Contains("not made by stuv"));
}

TEST_CASE("damaged recordings are named") {
  const test::TempFolder folder;
  CHECK_THROWS_WITH(open_recording(folder / "none"), Contains("none"));
  RecordingWriter writer(folder / "rec", 1, 2, kCameras, {}, false);
  record(writer, "a", true);
  write_text(folder / "rec/sets/a/set.json", "{");
  CHECK_THROWS_WITH(open_recording(folder / "rec"), Contains("a/set.json"));
  write_text(folder / "rec/recording.json", R"({"format": "stuv.recording", "version": 1})");
  CHECK_THROWS_WITH(open_recording(folder / "rec"), Contains("recording.json"));
}
