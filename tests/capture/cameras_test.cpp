#include "capture/cameras/camera_source.h"

#include <fmt/format.h>

#include <fstream>
#include <random>

#include "capture/cameras/camera_clock.h"
#include "capture/cameras/camera_list.h"
#include "capture/cameras/explain.h"
#include "capture/cameras/live_view.h"
#include "capture/cameras/set_matcher.h"
#include "capture/capture.h"
#include "capture/config.h"
#include "capture/usb/bandwidth.h"
#include "tests/capture/fake_camera.h"
#include "tests/capture/support.h"

using namespace stuv;
using namespace stuv::test;
namespace fs = std::filesystem;
using Catch::Matchers::Contains;

namespace {

constexpr std::int64_t kMs = 1'000'000;

TimedFrame frame_at(std::int64_t time_ns, std::int64_t sequence) {
  TimedFrame frame;
  frame.time_ns = time_ns;
  frame.sequence = sequence;
  return frame;
}

struct Matched {
  int complete = 0, incomplete = 0, mixed = 0;
  std::int64_t worst_skew_ns = 0;
};

/// Feeds cameras of given phases, with jitter and drops, in the order of arrival, and looks at the sets.
Matched match(const std::vector<double>& phases_ms, double jitter_ms, double drop_share, double drift_ppm = 0,
              int frames = 600) {
  constexpr double period_ms = 33.333;
  std::mt19937 random(7);
  std::normal_distribution<double> noise(0, jitter_ms);
  std::uniform_real_distribution<double> uniform(0, 1);
  struct Arrival {
    std::int64_t time_ns;
    std::size_t camera;
    std::int64_t sequence;
  };
  std::vector<Arrival> arrivals;
  for (std::size_t i = 0; i < phases_ms.size(); ++i)
    for (int k = 0; k < frames; ++k) {
      const double rate = 1 + 1e-6 * drift_ppm * static_cast<double>(i);
      const double time = 1000 + phases_ms[i] + period_ms * rate * k +
                          std::clamp(noise(random), -3 * jitter_ms, 3 * jitter_ms);
      if (uniform(random) >= drop_share) arrivals.push_back({std::llround(time * kMs), i, k});
    }
  std::sort(arrivals.begin(), arrivals.end(),
            [](const Arrival& a, const Arrival& b) { return a.time_ns < b.time_ns; });
  SetMatcher matcher(phases_ms.size(), {});
  Matched result;
  const auto look = [&](const MatchedSet& set) {
    std::int64_t first = INT64_MAX, last = INT64_MIN;
    bool complete = true;
    for (const auto& frame : set.frames) {
      complete &= frame.has_value();
      if (!frame) continue;
      first = std::min(first, frame->time_ns);
      last = std::max(last, frame->time_ns);
    }
    ++(complete ? result.complete : result.incomplete);
    if (complete) result.worst_skew_ns = std::max(result.worst_skew_ns, last - first);
  };
  for (const Arrival& arrival : arrivals) {
    matcher.add(arrival.camera, frame_at(arrival.time_ns, arrival.sequence));
    while (const auto set = matcher.take(arrival.time_ns)) look(*set);
  }
  return result;
}

CameraSourceOptions fake_rig(int count) {
  CameraSourceOptions options;
  options.cols = count;
  for (int i = 0; i < count; ++i) {
    CameraSettings camera;
    camera.id = fmt::format("fake:{}", i);
    camera.name = fmt::format("cam{}", i);
    camera.col = i;
    options.cameras.push_back(camera);
  }
  return options;
}

FakeCameraOptions grey_camera() {
  FakeCameraOptions fake;
  fake.format = {"GREY", 8, 6, 8};
  for (int value = 10; value < 14; ++value) fake.frames.emplace_back(48, static_cast<std::byte>(value));
  return fake;
}

void put(const fs::path& file, const std::string& text) {
  fs::create_directories(file.parent_path());
  std::ofstream(file) << text;
}

}  // namespace

TEST_CASE("clock: counters that wrap, clocks of their own") {
  CameraClock clock;
  CHECK(clock.count(0xFFFFFFFE) == 0);
  CHECK(clock.count(0xFFFFFFFF) == 0);
  CHECK(clock.count(2) == 2);
  CHECK(clock.sequence() == std::int64_t{0x100000002});
  CHECK(clock.count(2) == -1);
  CHECK(clock.count(1) == -1);
  clock.restart();
  CHECK(clock.count(0) == 0);
  CHECK(clock.sequence() == std::int64_t{0x100000003});

  CHECK(clock.system_time_ns(5'000 * kMs, 5'010 * kMs) == 5'000 * kMs);
  CHECK(clock.system_time_ns(5'030 * kMs, 5'010 * kMs) == 5'030 * kMs);
  CHECK(clock.offset_ns() == 0);
  // A clock that runs over 2^63 between two frames.
  const std::int64_t late = INT64_MAX - 10 * kMs;
  const std::int64_t first = clock.system_time_ns(late, 6'000 * kMs);
  const auto wrapped = static_cast<std::int64_t>(static_cast<std::uint64_t>(late) + 33 * kMs);
  CHECK(wrapped < 0);
  CHECK(clock.system_time_ns(wrapped, 6'034 * kMs) - first == 33 * kMs);
}

TEST_CASE("matcher: free running cameras make whole sets of the least skew") {
  // The largest gap of these phases is from 14 to 30 ms: across the period's end they lie within 17.4 ms.
  const Matched result = match({1, 31, 14, 8, 30}, 0.3, 0);
  CHECK(result.incomplete <= 1);  // the last
  CHECK(result.complete > 590);
  CHECK(result.worst_skew_ns < 20 * kMs);
}

TEST_CASE("matcher: stamps that a busy machine makes late do not move frames into other sets") {
  // The phases are 8 ms apart, the stamps up to 7.5 ms off.
  const Matched result = match({0, 8.3, 16.7, 25}, 2.5, 0);
  CHECK(result.complete > 590);
}

TEST_CASE("matcher: dropped frames cost their own set only") {
  const Matched result = match({1, 2, 3, 4, 5, 6, 7, 8, 9}, 0.5, 0.02);
  const double expected = 600 * std::pow(0.98, 9);
  CHECK(result.complete == Approx(expected).epsilon(0.06));
  CHECK(result.complete + result.incomplete == Approx(599).margin(2));
  CHECK(result.worst_skew_ns < 12 * kMs);
}

TEST_CASE("matcher: clocks that drift apart cost a set now and then") {
  // 900 ppm between the first camera and the last: over 6000 frames they slip by more than five periods.
  const Matched result = match({0, 3, 6, 9}, 0.2, 0, 300, 6000);
  CHECK(result.complete > 5900);
  CHECK(result.worst_skew_ns < 34 * kMs);
}

TEST_CASE("matcher: a lost camera is not waited for; a silent one is, but not for ever") {
  SetMatcher matcher(2, {});
  for (int k = 0; k < 5; ++k)
    for (std::size_t i = 0; i < 2; ++i) matcher.add(i, frame_at((1000 + 33 * k) * kMs, k));
  const std::int64_t now = 1140 * kMs;
  int sets = 0;
  while (matcher.take(now)) ++sets;
  CHECK(sets == 5);
  matcher.add(0, frame_at(1165 * kMs, 5));
  CHECK_FALSE(matcher.take(1166 * kMs));
  CHECK(matcher.take(1500 * kMs));
  matcher.set_live(1, false);
  matcher.add(0, frame_at(1198 * kMs, 6));
  CHECK(matcher.take(1199 * kMs));
}

TEST_CASE("matcher: triggered frames need not be even in time") {
  MatcherOptions options;
  options.trigger_window_ns = 10 * kMs;
  SetMatcher matcher(3, options);
  int sets = 0;
  for (const std::int64_t time : {1000, 1100, 1750, 1790, 5000}) {
    for (std::size_t i = 0; i < 3; ++i)
      matcher.add(i, frame_at((time + static_cast<std::int64_t>(i)) * kMs, sets));
    while (const auto set = matcher.take((time + 5) * kMs)) {
      ++sets;
      CHECK(set->frames[2]->time_ns - set->frames[0]->time_ns == 2 * kMs);
    }
  }
  CHECK(sets == 5);
}

TEST_CASE("cameras: frames arrive unchanged, and the report accounts for all of them") {
  const TempFolder folder;
  CameraSourceOptions options = fake_rig(3);
  const auto source = open_cameras(options, {}, nullptr, {}, [](const CameraSettings& settings) {
    return std::make_unique<FakeCamera>(settings, grey_camera());
  });
  CaptureOptions limit;
  limit.sets = 20;
  const CaptureResult result = capture(*source, folder / "rec", limit);
  const Recording recording = open_recording(folder / "rec");
  REQUIRE(recording.sets.size() == 20);
  for (const FrameSet& set : recording.sets)
    for (const Frame& frame : set.frames) {
      const auto value = static_cast<std::byte>(10 + frame.sequence % 4);
      if (frame.status == FrameStatus::ok)
        CHECK(read_image(frame.file).bytes == std::vector<std::byte>(48, value));
    }
  CHECK(read_json(folder / "rec" / "report.json") == result.report);
  for (const Json& camera : result.report["cameras"]) {
    CHECK(camera["frames"].get<int>() == camera["recorded"].get<int>() + camera["outside"].get<int>() +
                                             camera["unmatched"].get<int>() +
                                             camera["queue_full"].get<int>());
    CHECK(camera["dropped"] == 0);
  }
}

TEST_CASE("cameras: MJPEG stays what it was; without Huffman tables, and truncated ones are flawed") {
  const TempFolder folder;
  write_image(folder / "a.jpg", flat_image(32, 16, 200));
  std::string whole = read_text(folder / "a.jpg");
  // UVC cameras leave the standard Huffman tables out: segments FFC4.
  std::string bare = whole;
  for (std::size_t at = bare.find("\xFF\xC4"); at != std::string::npos; at = bare.find("\xFF\xC4"))
    bare.erase(
        at, 2 + (static_cast<unsigned char>(bare[at + 2]) << 8 | static_cast<unsigned char>(bare[at + 3])));
  REQUIRE(bare.size() < whole.size());
  const auto bytes = [](const std::string& text) {
    const auto all = std::as_bytes(std::span(text));
    return std::vector<std::byte>(all.begin(), all.end());
  };
  FakeCameraOptions fake;
  fake.format = {"MJPG", 32, 16, 0};
  fake.frames = {bytes(bare), bytes(whole.substr(0, whole.size() - 8))};
  const auto source = open_cameras(fake_rig(1), {}, nullptr, {}, [&](const CameraSettings& settings) {
    return std::make_unique<FakeCamera>(settings, fake);
  });
  CaptureOptions limit;
  limit.sets = 6;
  capture(*source, folder / "rec", limit);
  int whole_frames = 0;
  for (const FrameSet& set : open_recording(folder / "rec").sets) {
    const Frame& frame = set.frames[0];
    whole_frames += frame.status == FrameStatus::ok ? 1 : 0;
    CHECK((frame.status == FrameStatus::ok) == (frame.sequence % 2 == 0));
    if (frame.status == FrameStatus::error) {
      CHECK(frame.problem == "the JPEG is truncated");
      continue;
    }
    CHECK(read_text(frame.file) == bare);
    CHECK(std::to_integer<int>(read_image(frame.file).bytes[40]) == Approx(200).margin(1));
  }
  CHECK(whole_frames > 0);
}

TEST_CASE("cameras: one that fails is named and opened again, the rest goes on") {
  const TempFolder folder;
  std::vector<std::string> warnings;
  Reporter reporter;
  reporter.warning = [&](std::string_view line) { warnings.emplace_back(line); };
  CameraSourceOptions options = fake_rig(2);
  options.duration_s = 2;
  int opened = 0;
  const auto source = open_cameras(options, reporter, nullptr, {}, [&](const CameraSettings& settings) {
    FakeCameraOptions fake = grey_camera();
    if (settings.name == "cam1" && ++opened == 1) fake.fails_after = 30;
    return std::make_unique<FakeCamera>(settings, fake);
  });
  const Json report = capture(*source, folder / "rec", {}).report;
  CHECK(report["cameras"][1]["lost"] == 1);
  CHECK(report["cameras"][0]["lost"] == 0);
  CHECK(report["sets"]["incomplete"].get<int>() > 10);
  REQUIRE(warnings.size() == 2);
  CHECK_THAT(warnings[0], Contains("camera cam1: is gone"));
  CHECK(warnings[1] == "camera cam1 is back");
  CHECK(open_recording(folder / "rec").sets.back().complete());
}

TEST_CASE("cameras: one that falls silent without a word is lost, the rest goes on") {
  const TempFolder folder;
  std::vector<std::string> warnings;
  Reporter reporter;
  reporter.warning = [&](std::string_view line) { warnings.emplace_back(line); };
  CameraSourceOptions options = fake_rig(2);
  options.duration_s = 5;
  int opened = 0;
  const auto source = open_cameras(options, reporter, nullptr, {}, [&](const CameraSettings& settings) {
    FakeCameraOptions fake = grey_camera();
    if (settings.name == "cam1" && ++opened == 1) fake.silent_after = 30;
    return std::make_unique<FakeCamera>(settings, fake);
  });
  const Json report = capture(*source, folder / "rec", {}).report;
  CHECK(report["cameras"][1]["lost"] == 1);
  CHECK(report["cameras"][0]["lost"] == 0);
  REQUIRE(warnings.size() == 2);
  CHECK_THAT(warnings[0], Contains("camera cam1: has sent nothing for 3 s"));
  CHECK(warnings[1] == "camera cam1 is back");
  CHECK(open_recording(folder / "rec").sets.back().complete());
}

TEST_CASE("cameras: those that do not start are all named; all gone is an error") {
  const auto broken = [](const CameraSettings& settings) -> std::unique_ptr<CameraDevice> {
    throw camera_error(settings.name, "/dev/video9", "start streaming", ENOSPC);
  };
  CHECK_THROWS_WITH(
      open_cameras(fake_rig(2), {}, nullptr, {}, broken),
      Contains("2 of 2 cameras do not start") && Contains("cam0") && Contains("cam1") && Contains("--check"));
  CameraSourceOptions options = fake_rig(1);
  options.give_up_s = 0.3;
  int opened = 0;
  const auto source = open_cameras(options, {}, nullptr, {}, [&](const CameraSettings& settings) {
    if (++opened > 1) throw camera_error(settings.name, "/dev/video9", "open it", ENODEV);
    FakeCameraOptions fake = grey_camera();
    fake.fails_after = 5;
    return std::make_unique<FakeCamera>(settings, fake);
  });
  const TempFolder folder;
  CHECK_THROWS_WITH(capture(*source, folder / "rec", {}), Contains("are all gone") && Contains("is gone"));
  CHECK(fs::exists(folder / "rec" / "report.json"));
}

TEST_CASE("explain: what errno means for cameras, and who holds one") {
  CHECK_THAT(camera_error("a", "/dev/video0", "start streaming", ENOSPC).what(),
             Contains("camera a (/dev/video0)") && Contains("no bandwidth") && Contains("--check"));
  CHECK_THAT(camera_error("a", "/dev/video0", "open it", EACCES).what(), Contains("group video"));
  CHECK_THAT(camera_error("a", "/dev/video0", "stream", EPROTO).what(), Contains("cable"));
  CHECK_THAT(camera_error("a", "/dev/video0", "stream", ENODEV).what(), Contains("unplugged"));
  const TempFolder folder;
  put(folder / "12" / "comm", "cheese\n");
  fs::create_directories(folder / "12" / "fd");
  fs::create_symlink("/dev/video3", folder / "12" / "fd" / "7");
  fs::create_directories(folder / "self" / "fd");
  CHECK(holders_of("/dev/video3", folder.path()) == "pid 12 (cheese)");
  CHECK(holders_of("/dev/video4", folder.path()).empty());
}

TEST_CASE("usb: bandwidth is added up along the tree, and what fits is proposed") {
  const TempFolder folder;
  const fs::path root = folder / "devices" / "pci0" / "usb1";
  const auto device = [&](const fs::path& path, const char* speed) {
    put(path / "speed", std::string(speed) + "\n");
    put(path / "idVendor", "046d\n");
  };
  device(root, "480");
  device(root / "1-2", "480");
  std::vector<CameraLoad> cameras;
  for (int i = 0; i < 4; ++i) {
    const fs::path camera = root / "1-2" / fmt::format("1-2.{}", i + 1);
    device(camera, "480");
    const fs::path video =
        camera / fmt::format("1-2.{}:1.0", i + 1) / "video4linux" / fmt::format("video{}", i);
    fs::create_directories(video);
    cameras.push_back(
        {fmt::format("cam{}", i),
         video,
         {"YUYV", 640, 480, {30}},
         {{"YUYV", 640, 480, {30, 15, 10, 5}}, {"YUYV", 320, 240, {30, 15}}, {"MJPG", 640, 480, {30}}}});
  }
  // 640 x 480 x 2 x 30 = 18.4 MB/s each; USB 2.0 has 48 MB/s for such transfers.
  const std::vector<LinkLoad> links = link_loads(cameras);
  REQUIRE(links.size() == 6);
  CHECK(links[0].name == "usb1");
  CHECK(links[0].capacity == Approx(48e6));
  CHECK(links[0].load == Approx(4 * 1.02 * 18.432e6));
  CHECK_FALSE(links[0].fits());
  CHECK(links[2].fits());
  const std::vector<Proposal> found = proposals(cameras);
  REQUIRE(found.size() == 6);  // three ways, for the controller and for the hub
  CHECK(found[0].fps == 15);
  CHECK(found[1].width == 320);
  CHECK(found[1].fps == 30);
  CHECK(found[2].fourcc == "MJPG");
  for (const Proposal& proposal : found) CHECK(proposal.load <= 48e6);
  // Two fit as pictures, but not as what the device reserves: the one alternate setting of 3 x 1024
  // bytes, 24.6 MB/s.
  cameras.resize(2);
  CHECK(link_loads(cameras)[0].fits());
  for (int i = 0; i < 2; ++i)
    put(root / "1-2" / fmt::format("1-2.{}", i + 1) / "descriptors",
        std::string("\x12\x01\x00\x02\xEF\x02\x01\x40\x6D\x04\x00\x08\x00\x00\x00\x00\x00\x01"
                    "\x07\x05\x81\x05\x00\x14\x01",
                    25));
  CHECK(reserved_rate(cameras[0]) == Approx(3 * 1024 * 8000));
  CHECK_FALSE(link_loads(cameras)[0].fits());
  CHECK(usb_capacity(5000) == Approx(450e6));
}

TEST_CASE("config: the one that `stuv cameras` writes can be read; mistakes are named") {
  CameraInfo info;
  info.id = "serial:046d:0825:\"A\\1";
  info.model = "C270";
  info.device = "/dev/video2";
  info.modes = {{"YUYV", 1280, 720, {10, 5}}, {"YUYV", 640, 480, {30, 15}}, {"MJPG", 640, 480, {30}}};
  CameraInfo other = info;
  other.id = "bus:usb-0000:00:14.0-2";
  CameraInfo third = info;
  third.id = "libcamera:x";
  const auto options =
      std::get<CameraSourceOptions>(parse_capture_config(starting_config({info, other, third}), "rig.toml"));
  CHECK(options.rows == 2);
  CHECK(options.cols == 2);
  REQUIRE(options.cameras.size() == 3);
  CHECK(options.cameras[0].id == info.id);
  CHECK(options.cameras[0].format == "YUYV");
  CHECK(options.cameras[0].width == 640);
  CHECK(options.cameras[0].fps == 30);
  CHECK(options.cameras[2].row == 1);

  const std::string head = "[source]\nkind = \"cameras\"\n";
  const auto [text, words] = GENERATE_COPY(table<std::string, std::string>({
      {head, "there is no [[camera]]"},
      {head + "mode = \"wild\"\n", "source.mode is 'wild'"},
      {head + "[[camera]]\nid = \"a\"\nname = \"x\"\ncol = 3\n", "outside the 1x1 grid"},
      {head + "[[camera]]\nid = \"a\"\nname = \"../x\"\n", "camera.name is '../x'"},
      {head + "[[camera]]\nid = \"a\"\nname = \"x\"\nbuffers = 99\n", "buffers is 99"},
      {head + "[[camera]]\nid = \"a\"\nname = \"x\"\ncontrols = { gain = \"much\" }\n",
       "gain must be a whole number"},
      {head + "[[camera]]\nid = \"a\"\nnmae = \"x\"\n", "unknown key camera.nmae"},
  }));
  CHECK_THROWS_WITH(parse_capture_config(text, "rig.toml"), Contains("rig.toml") && Contains(words));
}

TEST_CASE("preview: a sheet of all cameras at their places") {
  const TempFolder folder;
  LiveView view(1, 2, {{"left", 0, 0}, {"right", 0, 1}});
  const std::vector<std::byte> bright(64 * 48, std::byte{255}), dark(64 * 48, std::byte{20});
  SourceSet set{"0", std::vector<SourceFrame>(2)};
  set.frames[0] = {FrameStatus::ok, RawFrame{bright, nullptr, {"GREY", 64, 48, 64}}, 0, 0, ""};
  set.frames[1] = {FrameStatus::ok, RawFrame{dark, nullptr, {"GREY", 64, 48, 64}}, 0, 0, ""};
  view.look(set);
  view.look(set);
  CHECK(view.glance(0).clipped == 1);
  CHECK(view.glance(1).level == Approx(20 / 255.0));
  view.write_preview(folder / "live");
  const Image sheet = read_image(folder / "live" / "sheet.jpg");
  CHECK(std::to_integer<int>(sheet.bytes[(20 * static_cast<std::size_t>(sheet.width) + 20) * 3]) > 250);
  CHECK(std::to_integer<int>(sheet.bytes[(20 * static_cast<std::size_t>(sheet.width) + 350) * 3]) < 30);
  CHECK_THAT(read_text(folder / "live" / "index.html"), Contains("sheet.jpg") && Contains("right"));
}
