// Runs as root in the guest that tests/vm/boot makes, against the kernel's vivid and vimc; see
// tests/vm/CMakeLists.txt.
#include <fmt/format.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <map>
#include <mutex>
#include <random>
#include <thread>

#include "capture/cameras/camera_list.h"
#include "capture/cameras/camera_source.h"
#include "capture/cameras/check.h"
#include "capture/capture.h"
#include "capture/v4l2/v4l2_camera.h"
#include "core/error.h"
#include "core/image_io.h"
#include "core/rig.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;
namespace fs = std::filesystem;
using Catch::Matchers::Contains;

namespace {

void shell(const std::string& line) {
  INFO(line);
  REQUIRE(std::system((line + " >/dev/null 2>&1").c_str()) == 0);
}

void set_control(int camera, const std::string& name, int value) {
  shell(fmt::format("v4l2-ctl -d /dev/video{} -c {}={}", camera, name, value));
}

CameraSourceOptions vivid_rig(int count, int width = 320, int height = 180, double fps = 30,
                              const std::string& format = "YUYV") {
  CameraSourceOptions options;
  options.cols = count;
  for (int i = 0; i < count; ++i) {
    CameraSettings camera;
    camera.id = fmt::format("bus:platform:vivid-{:03}", i);
    camera.name = fmt::format("cam{}", i);
    camera.col = i;
    camera.format = format;
    camera.width = width;
    camera.height = height;
    camera.fps = fps;
    options.cameras.push_back(camera);
  }
  return options;
}

struct Taken {
  Json report;
  std::vector<std::string> warnings;
  Recording recording;

  const Json& camera(int i) const { return report["cameras"][static_cast<std::size_t>(i)]; }
  int count(int i, const char* what) const { return camera(i)[what]; }
  std::string all_warnings() const { return fmt::format("{}", fmt::join(warnings, "\n")); }
};

/// Records for so long, and does something to the cameras in the middle.
Taken take(CameraSourceOptions options, const fs::path& folder, double seconds,
           const std::function<void()>& meanwhile = {}) {
  options.duration_s = seconds;
  Taken taken;
  Reporter reporter;
  std::mutex mutex;
  reporter.warning = [&](std::string_view line) {
    const std::lock_guard lock(mutex);
    taken.warnings.emplace_back(line);
  };
  const auto source = open_cameras(options, reporter);
  std::thread other([&] {
    std::this_thread::sleep_for(std::chrono::duration<double>(seconds / 4));
    if (meanwhile) meanwhile();
  });
  CaptureOptions capture_options;
  capture_options.force = true;
  try {
    taken.report = capture(*source, folder, capture_options, reporter).report;
  } catch (...) {
    other.join();
    throw;
  }
  other.join();
  taken.recording = open_recording(folder);
  return taken;
}

/// Every frame that a driver delivered is somewhere.
void check_accounts(const Taken& taken) {
  for (const Json& camera : taken.report["cameras"]) {
    CAPTURE(camera.dump());
    CHECK(camera["frames"].get<int>() ==
          camera["recorded"].get<int>() + camera["outside"].get<int>() + camera["unmatched"].get<int>() +
              camera["queue_full"].get<int>() + camera["duplicates"].get<int>());
    CHECK(camera["recorded"].get<int>() > 0);
    int there = 0;
    const int index = taken.recording.camera_index(camera["name"]);
    for (const FrameSet& set : taken.recording.sets)
      there += set.frames[static_cast<std::size_t>(index)].status != FrameStatus::missing ? 1 : 0;
    CHECK(there == camera["recorded"].get<int>());
  }
}

/// Every frame of every set is as long as it should be; a few are decoded.
void check_whole(const Recording& recording) {
  for (std::size_t s = 0; s < recording.sets.size(); ++s)
    for (const Frame& frame : recording.sets[s].frames) {
      if (frame.status != FrameStatus::ok) continue;
      if (s % 40 == 0)
        CHECK(read_image(frame.file).width == 320);
      else
        CHECK(fs::file_size(frame.file) == kRawHeaderBytes + 320 * 180 * 2);
    }
}

/// Names of the bars of "100% Colorbar" as R'G'B' of 0 and 1.
constexpr int kBars[8][3] = {{1, 1, 1}, {1, 1, 0}, {0, 1, 1}, {0, 1, 0},
                             {1, 0, 1}, {1, 0, 0}, {0, 0, 1}, {0, 0, 0}};

}  // namespace

TEST_CASE("vivid: every format is decoded to within a level of its code values, and to the bars' colours",
          "[formats]") {
  const TempFolder folder;
  set_control(0, "test_pattern", 1);
  set_control(0, "osd_text_mode", 2);
  int formats = 0;
  for (const char* fourcc : {"YUYV", "UYVY", "NV12", "RGB3", "BGR3", "GREY", "Y10 ", "Y12 ", "Y16 ",
                             "BA81", "GBRG", "GRBG", "RGGB", "BG10", "GB10", "BA10", "RG10", "BG12",
                             "GB12", "BA12", "RG12", "BYR2", "GB16", "GR16", "RG16"}) {
    CAPTURE(fourcc);
    const fs::path rec = folder / fmt::format("rec{}", formats++);
    const auto source = open_cameras(vivid_rig(1, 320, 180, 30, fourcc));
    CaptureOptions options;
    options.sets = 1;
    capture(*source, rec, options);
    const fs::path file = open_recording(rec).sets.at(0).frames[0].file;
    const std::string text = read_text(file);
    const RawFormat format = parse_raw_header(text, file.string());
    REQUIRE(format.fourcc == fourcc);
    const auto code = [&](std::size_t at, int bytes) {
      const auto* p = reinterpret_cast<const unsigned char*>(text.data()) + kRawHeaderBytes + at;
      return bytes == 1 ? p[0] : p[0] | p[1] << 8;
    };
    const Image image = read_image(file);
    const bool wide = image.type == PixelType::u16, bayer = text.size() > 0 && image.channels == 3 &&
                                                            least_stride(fourcc, 320) <= (wide ? 640 : 320) &&
                                                            std::string(fourcc) != "NV12";
    const ImageF decoded = to_float(image);
    const double level = wide ? 1.0 / 65535 : 1.0 / 255;
    const int bits = std::string(fourcc).find("10") != std::string::npos || std::string(fourcc) == "Y10 " ? 10
                     : std::string(fourcc).find("12") != std::string::npos && std::string(fourcc) != "NV12"
                         ? 12
                     : wide ? 16
                            : 8;
    double worst = 0, worst_colour = 0;
    for (int y = 8; y < 172; ++y)
      for (int bar = 0; bar < 8; ++bar)
        for (int x = bar * 40 + 4; x < bar * 40 + 36; ++x) {
          double expected[3];
          const auto yuv = [&](int luma, int cb, int cr) {
            const double l = (luma - 16) / 219.0, b = (cb - 128) / 224.0, r = (cr - 128) / 224.0;
            expected[0] = l + 1.402 * r;
            expected[1] = l - 0.344136286 * b - 0.714136286 * r;
            expected[2] = l + 1.772 * b;
          };
          const auto at = static_cast<std::size_t>(y) * format.stride;
          const auto pair = static_cast<std::size_t>(x / 2);
          const std::string name = fourcc;
          if (name == "YUYV") {
            yuv(code(at + 2 * x, 1), code(at + 4 * pair + 1, 1), code(at + 4 * pair + 3, 1));
          } else if (name == "UYVY") {
            yuv(code(at + 2 * x + 1, 1), code(at + 4 * pair, 1), code(at + 4 * pair + 2, 1));
          } else if (name == "NV12") {
            const auto chroma = static_cast<std::size_t>(180 + y / 2) * format.stride + 2 * pair;
            yuv(code(at + x, 1), code(chroma, 1), code(chroma + 1, 1));
          } else if (name == "RGB3" || name == "BGR3") {
            for (int c = 0; c < 3; ++c)
              expected[c] = code(at + 3 * x + (name == "RGB3" ? c : 2 - c), 1) / 255.0;
          } else {
            const int size = wide ? 2 : 1;
            const double largest = (1 << bits) - 1;
            // Inside a bar all pixels of a colour are alike: those of the 2x2 block at even places.
            static const std::map<std::string, std::string> orders = {
                {"BA81", "BGGR"}, {"BG10", "BGGR"}, {"BG12", "BGGR"}, {"BYR2", "BGGR"},
                {"GBRG", "GBRG"}, {"GB10", "GBRG"}, {"GB12", "GBRG"}, {"GB16", "GBRG"},
                {"GRBG", "GRBG"}, {"BA10", "GRBG"}, {"BA12", "GRBG"}, {"GR16", "GRBG"},
                {"RGGB", "RGGB"}, {"RG10", "RGGB"}, {"RG12", "RGGB"}, {"RG16", "RGGB"}};
            for (int c = 0; c < 3; ++c) {
              std::size_t place = at + static_cast<std::size_t>(x) * size;
              if (bayer) {
                const auto where = static_cast<int>(orders.at(name).find("RGB"[c]));
                place = static_cast<std::size_t>(y / 2 * 2 + where / 2) * format.stride +
                        static_cast<std::size_t>(x / 2 * 2 + where % 2) * size;
              }
              expected[c] = code(place, size) / largest;
            }
          }
          for (int c = 0; c < 3; ++c) {
            const double value = decoded.at(x, y, image.channels == 3 ? c : 0);
            worst = std::max(worst, std::abs(value - std::clamp(expected[c], 0.0, 1.0)) / level);
            if (image.channels == 3) worst_colour = std::max(worst_colour, std::abs(value - kBars[bar][c]));
          }
        }
    CAPTURE(worst, worst_colour);
    CHECK(worst <= 1.001);
    // The driver's own tables are rounded, to a few of 255.
    CHECK(worst_colour < 0.02);
  }
  CHECK(formats == 25);
}

TEST_CASE("vivid: controls are set and read back; what is refused is named", "[formats]") {
  CameraSettings settings = vivid_rig(1).cameras[0];
  settings.controls = {{"gain", 77}, {"brightness", 33}};
  const Json controls = open_camera(settings)->settings()["controls"];
  CHECK(controls[1]["name"] == "gain");
  CHECK(controls[1]["actual"] == 77);
  CHECK(controls[0]["actual"] == 33);
  settings.controls = {{"zoom", 1}};
  CHECK_THROWS_WITH(open_camera(settings),
                    Contains("cam0") && Contains("has no control 'zoom'") && Contains("brightness"));
  settings.controls = {{"gain", 100000}};
  CHECK_THROWS_WITH(open_camera(settings), Contains("gain is to be 100000") && Contains("it takes 0 to"));
  settings.controls = {};
  settings.width = 321;
  CHECK_THROWS_WITH(open_camera(settings), Contains("makes YUYV 320x180 of YUYV 321x180"));
}

TEST_CASE("vivid: dropped buffers are gaps in the sequence, and the other camera misses nothing",
          "[faults]") {
  const TempFolder folder;
  set_control(0, "percentage_of_dropped_buffers", 30);
  const Taken taken = take(vivid_rig(2), folder / "rec", 4);
  set_control(0, "percentage_of_dropped_buffers", 0);
  check_accounts(taken);
  // On a busy machine vivid itself misses a beat now and then.
  CHECK(taken.count(0, "dropped") > 10);
  CHECK(taken.count(0, "dropped") > 3 * taken.count(1, "dropped"));
  CHECK(taken.report["sets"]["incomplete"].get<int>() > 10);
  CHECK(taken.count(1, "recorded") > taken.count(0, "recorded"));
}

TEST_CASE("vivid: a buffer with the error flag is kept out, and said so", "[faults]") {
  const TempFolder folder;
  const Taken taken =
      take(vivid_rig(2), folder / "rec", 3, [] { set_control(1, "inject_v4l2_buf_flag_error", 1); });
  check_accounts(taken);
  CHECK(taken.count(1, "flawed") == 1);
  int flawed = 0;
  for (const FrameSet& set : taken.recording.sets)
    if (set.frames[1].status == FrameStatus::error) {
      ++flawed;
      CHECK(set.frames[1].problem == "flagged bad by the driver");
    }
  CHECK(flawed == 1);
}

TEST_CASE("vivid: a fatal streaming error closes one camera, which comes back", "[faults]") {
  const TempFolder folder;
  const Taken taken =
      take(vivid_rig(2), folder / "rec", 5, [] { set_control(0, "inject_fatal_streaming_error", 1); });
  check_accounts(taken);
  CHECK(taken.count(0, "lost") == 1);
  CHECK(taken.count(1, "lost") == 0);
  CHECK_THAT(taken.all_warnings(),
             Contains("camera cam0") && Contains("EIO") && Contains("camera cam0 is back"));
  CHECK(taken.recording.sets.back().complete());
}

TEST_CASE("vivid: an unplugged camera is named, the others go on, and it returns by its identity",
          "[faults]") {
  const TempFolder folder;
  const Taken taken = take(vivid_rig(2), folder / "rec", 6, [] { set_control(1, "disconnect", 1); });
  check_accounts(taken);
  CHECK(taken.count(1, "lost") == 1);
  CHECK(taken.count(0, "lost") == 0);
  CHECK(taken.count(0, "recorded") > taken.count(1, "recorded"));
  CHECK_THAT(taken.all_warnings(),
             Contains("camera cam1") && Contains("unplugged") && Contains("camera cam1 is back"));
  CHECK(taken.recording.sets.back().complete());
}

TEST_CASE("vivid: cameras that do not start are all named, with the cause", "[faults]") {
  set_control(0, "inject_vidioc_reqbufs_error", 1);
  CHECK_THROWS_WITH(open_cameras(vivid_rig(2)),
                    Contains("cam0") && Contains("get buffers") && Contains("EINVAL"));
  set_control(1, "inject_vidioc_streamon_error", 1);
  CHECK_THROWS_WITH(open_cameras(vivid_rig(2)),
                    Contains("cam1") && Contains("start streaming") && Contains("EINVAL"));
  CHECK_NOTHROW(open_cameras(vivid_rig(2)));
  CameraSourceOptions gone = vivid_rig(2);
  gone.cameras[1].id = "bus:platform:vivid-077";
  CHECK_THROWS_WITH(open_cameras(gone), Contains("cam1 (bus:platform:vivid-077): is not there"));
  gone.allow_missing = true;
  const TempFolder folder;
  CHECK(take(gone, folder / "rec", 1).recording.sets.size() > 5);
}

TEST_CASE("vivid: who holds a camera is told", "[faults]") {
  const pid_t other = ::fork();
  if (other == 0) {
    ::execlp("v4l2-ctl", "v4l2-ctl", "-d", "/dev/video0", "--stream-mmap", "--stream-count=100000", nullptr);
    ::_exit(1);
  }
  std::this_thread::sleep_for(std::chrono::seconds(2));
  CHECK_THROWS_WITH(open_cameras(vivid_rig(1)),
                    Contains(fmt::format("in use by pid {} (v4l2-ctl) (EBUSY)", other)));
  const RigCheck check = check_rig(vivid_rig(2));
  CHECK_FALSE(check.good());
  CHECK_THAT(check.cameras[0].trouble, Contains("v4l2-ctl"));
  CHECK(check.cameras[1].delivers);
  ::kill(other, SIGKILL);
  ::waitpid(other, nullptr, 0);
}

TEST_CASE("vivid: sequence numbers and timestamps that wrap", "[faults]") {
  const TempFolder folder;
  for (const int wrap : {2, 1}) {
    set_control(0, "wrap_sequence_number", 1);
    set_control(0, "wrap_timestamp", wrap);
    // The numbers wrap after 128 frames, the time after 16 s of streaming (only one of the two is waited
    // for).
    const double seconds = wrap == 1 ? 19 : 6;
    const Taken taken = take(vivid_rig(2), folder / fmt::format("rec{}", wrap), seconds);
    set_control(0, "wrap_sequence_number", 0);
    set_control(0, "wrap_timestamp", 0);
    check_accounts(taken);
    CHECK(taken.count(0, "clock_offset_ns") != 0);
    CHECK(taken.count(0, "frames") + taken.count(0, "dropped") > 140);
    CHECK(taken.count(0, "dropped") < taken.count(0, "frames"));
    CHECK(taken.count(0, "duplicates") < 10);
    CHECK(taken.report["sets"]["complete"] > taken.report["sets"]["incomplete"]);
    CHECK(taken.recording.sets.back().frames[0].sequence > std::int64_t{0xFFFFFFFF});
  }
}

TEST_CASE("vivid: killed at 100 random moments, every set that is there is whole", "[kills]") {
  const TempFolder folder;
  std::mt19937 random(4);  // the same moments every time
  std::uniform_real_distribution<double> moment(0.03, 0.6);
  int with_sets = 0;
  for (int i = 0; i < 100; ++i) {
    const fs::path rec = folder / "rec";
    fs::remove_all(rec);
    const pid_t child = ::fork();
    if (child == 0) {
      try {
        capture(*open_cameras(vivid_rig(2, 320, 180, 60)), rec, {});
      } catch (...) {
      }
      ::_exit(1);
    }
    std::this_thread::sleep_for(std::chrono::duration<double>(moment(random)));
    ::kill(child, SIGKILL);
    ::waitpid(child, nullptr, 0);
    if (!fs::exists(rec)) continue;
    const Recording recording = open_recording(rec);
    check_whole(recording);
    with_sets += recording.sets.empty() ? 0 : 1;
  }
  CHECK(with_sets > 30);
}

TEST_CASE("vivid: a full disk ends in one line, and what was finished stays", "[disk]") {
  const TempFolder folder;
  const fs::path disk = folder / "disk";
  fs::create_directory(disk);
  shell(fmt::format("mount -t tmpfs -o size=5m small {}", disk.string()));
  CHECK_THROWS_WITH(take(vivid_rig(2), disk / "rec", 20),
                    Contains("No space left on device") && Contains("free some space"));
  const Recording recording = open_recording(disk / "rec");
  CHECK(recording.sets.size() > 5);
  check_whole(recording);
  for (const FrameSet& set : recording.sets) CHECK(set.complete());
  shell(fmt::format("umount {}", disk.string()));
}

/// Whether the guest itself keeps time: on each of its processors a thread that goes before all others wakes
/// every 2 ms; how late it wakes is how long that processor stood still, which no program in the guest can
/// help.
class Witness {
 public:
  /// A quarter of a frame at 30 a second, in ms: drivers of a guest that stood still for longer may lose
  /// frames.
  static constexpr double kStoodStill = 8;

  Witness() : late_(std::thread::hardware_concurrency()) {
    for (std::size_t cpu = 0; cpu < late_.size(); ++cpu)
      threads_.emplace_back([this, cpu](const std::stop_token& stop) { watch(cpu, stop); });
  }

  void stop() { threads_.clear(); }

  /// The longest time that a processor stood still between two times of the monotonic clock, once stopped.
  double worst_ms(std::int64_t first_ns = 0, std::int64_t last_ns = INT64_MAX) const {
    double worst = 0;
    for (const auto& late : late_)
      for (const auto& [at_ns, ms] : late)
        if (first_ns <= at_ns && at_ns <= last_ns) worst = std::max(worst, ms);
    return worst;
  }

 private:
  void watch(std::size_t cpu, const std::stop_token& stop) {
    cpu_set_t only;
    CPU_ZERO(&only);
    CPU_SET(cpu, &only);
    sched_param first{};
    first.sched_priority = ::sched_get_priority_max(SCHED_FIFO);
    if (::pthread_setaffinity_np(::pthread_self(), sizeof only, &only) != 0 ||
        ::pthread_setschedparam(::pthread_self(), SCHED_FIFO, &first) != 0)
      std::terminate();  // root in a guest may do both
    while (!stop.stop_requested()) {
      const auto due = std::chrono::steady_clock::now() + std::chrono::milliseconds(2);
      std::this_thread::sleep_until(due);
      const auto now = std::chrono::steady_clock::now();
      late_[cpu].emplace_back(now.time_since_epoch() / std::chrono::nanoseconds(1),
                              std::chrono::duration<double, std::milli>(now - due).count());
    }
  }

  std::vector<std::vector<std::pair<std::int64_t, double>>> late_;
  std::vector<std::jthread> threads_;
};

TEST_CASE("vivid: a disk slower than the cameras costs sets, not memory, and they are counted", "[disk]") {
  const auto resident = [] {
    long pages = 0, there = 0;
    std::ifstream("/proc/self/statm") >> pages >> there;
    return there * ::sysconf(_SC_PAGESIZE);
  };
  bool kept_time = false;
  for (int i = 0; i < 4 && !kept_time; ++i) {
    CameraSourceOptions options = vivid_rig(2);
    options.duration_s = 8;
    Witness witness;
    const auto source = open_cameras(options);
    long early = 0;
    int sets = 0;
    while (const auto set = source->next()) {
      std::this_thread::sleep_for(std::chrono::milliseconds(200));
      if (++sets == 10) early = resident();
    }
    CHECK(resident() - early < 4 << 20);
    witness.stop();
    const Json report = source->report();
    CHECK(report["sets"]["dropped_queue_full"].get<int>() > 80);
    int dropped = 0;
    for (const Json& camera : report["cameras"]) {
      dropped += camera["dropped"].get<int>();
      CHECK(camera["recorded"].get<int>() > sets * 3 / 4);
    }
    kept_time = dropped == 0 || witness.worst_ms() < Witness::kStoodStill;
    if (kept_time) CHECK(dropped == 0);  // the driver always has buffers
  }
  if (!kept_time)
    fmt::print("not shown that the driver always has buffers: the guest stood still each time\n");
}

struct SetTimes {
  double spread_ms = 0;  ///< worst, within a set, of the frames' beats
  double stray_ms = 0;   ///< worst of all stamps, from their camera's beat
};

/// vivid's cameras keep time exactly; on a busy machine its stamps are late. A camera's beat is therefore the
/// median of its stamps less the periods that its numbers count.
SetTimes set_times(const Recording& recording, double period_ms) {
  const auto phase_ms = [&](const Frame& frame) {
    return 1e-6 * static_cast<double>(frame.timestamp_ns) - period_ms * static_cast<double>(frame.sequence);
  };
  std::vector<double> beat(recording.cameras.size());
  SetTimes times;
  for (std::size_t i = 0; i < beat.size(); ++i) {
    std::vector<double> phases;
    for (const FrameSet& set : recording.sets)
      if (set.frames[i].status == FrameStatus::ok) phases.push_back(phase_ms(set.frames[i]));
    REQUIRE_FALSE(phases.empty());
    std::nth_element(phases.begin(), phases.begin() + phases.size() / 2, phases.end());
    beat[i] = phases[phases.size() / 2];
    for (const double phase : phases) times.stray_ms = std::max(times.stray_ms, std::abs(phase - beat[i]));
  }
  for (const FrameSet& set : recording.sets) {
    double first = INFINITY, last = -INFINITY;
    for (std::size_t i = 0; i < beat.size(); ++i) {
      if (set.frames[i].status != FrameStatus::ok) continue;
      const double at = beat[i] + period_ms * static_cast<double>(set.frames[i].sequence);
      first = std::min(first, at);
      last = std::max(last, at);
    }
    times.spread_ms = std::max(times.spread_ms, last - first);
  }
  return times;
}

/// Processor time of the children that have ended.
double children_s() {
  rusage usage{};
  ::getrusage(RUSAGE_CHILDREN, &usage);
  return static_cast<double>(usage.ru_utime.tv_sec + usage.ru_stime.tv_sec) +
         1e-6 * static_cast<double>(usage.ru_utime.tv_usec + usage.ru_stime.tv_usec);
}

struct PeerTimes {
  double s = 0;       ///< for 5 s of frames
  double cpu_ms = 0;  ///< a frame
};

/// v4l2-ctl's own streaming to files, 150 frames a camera.
PeerTimes stream_with_v4l2_ctl(int cameras, const fs::path& disk) {
  std::string line;
  for (int i = 0; i < cameras; ++i)
    line += fmt::format(
        "v4l2-ctl -d /dev/video{0} --set-fmt-video=width=640,height=360,pixelformat=YUYV -p 30; "
        "v4l2-ctl -d /dev/video{0} --stream-mmap=16 --stream-count=150 --stream-to={1}/v{0} & ",
        i, disk.string());
  const double before = children_s();
  const auto begin = std::chrono::steady_clock::now();
  shell("( " + line + " wait )");
  PeerTimes times;
  times.s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  times.cpu_ms = 1000 * (children_s() - before) / (150 * cameras);
  shell(fmt::format("rm {}/v*", disk.string()));
  return times;
}

struct RigRun {
  Json report;
  SetTimes times;
  int dropped = 0;
  double cpu_ms = 0;    ///< a frame
  double stood_ms = 0;  ///< the longest time for which the guest stood still meanwhile

  bool whole() const {
    const Json& sets = report["sets"];
    return sets["complete"] == 300 && sets["incomplete"] == 0 && sets["dropped_queue_full"] == 0 &&
           dropped == 0;
  }
  /// No set mixes two beats. (A camera that lost frames may go on at another one.)
  bool on_beat() const {
    return times.spread_ms < 33.4 &&
           report["skew_ms"]["worst"].get<double>() < times.spread_ms + 2 * times.stray_ms;
  }
};

RigRun record_300_sets(int cameras, const fs::path& folder) {
  RigRun run;
  const double before = children_s();
  Witness witness;
  const pid_t child = ::fork();
  if (child == 0) {
    CameraSourceOptions options = vivid_rig(cameras, 640, 360);
    options.duration_s = 20;
    CaptureOptions capture_options;
    capture_options.sets = 300;
    try {
      capture(*open_cameras(options), folder, capture_options);
    } catch (const std::exception& error) {
      fmt::print("{}\n", error.what());
      std::fflush(stdout);
      ::_exit(1);
    }
    ::_exit(0);
  }
  int status = -1;
  ::waitpid(child, &status, 0);
  witness.stop();
  REQUIRE(status == 0);
  run.report = read_json(folder / "report.json");
  int recorded = 0;
  for (const Json& camera : run.report["cameras"]) {
    recorded += camera["recorded"].get<int>();
    run.dropped += camera["dropped"].get<int>();
  }
  run.cpu_ms = 1000 * (children_s() - before) / recorded;
  const Recording recording = open_recording(folder);
  run.times = set_times(recording, 1000.0 / 30);
  std::int64_t first = INT64_MAX, last = 0;
  for (const FrameSet& set : recording.sets)
    for (const Frame& frame : set.frames)
      if (frame.status == FrameStatus::ok) {
        first = std::min<std::int64_t>(first, frame.timestamp_ns);
        last = std::max<std::int64_t>(last, frame.timestamp_ns);
      }
  run.stood_ms = witness.worst_ms(first, last);
  const Json& sets = run.report["sets"];
  fmt::print(
      "{} cameras: {} sets complete, {} incomplete, {} not taken, {} frames dropped; skew median {:.1f} ms, "
      "worst {:.1f} ms, of the cameras' beats {:.1f} ms, stamps off by up to {:.1f} ms; processor {:.2f} ms "
      "a "
      "frame; the guest stood still for up to {:.1f} ms\n",
      cameras, sets["complete"].get<int>(), sets["incomplete"].get<int>(),
      sets["dropped_queue_full"].get<int>(), run.dropped, run.report["skew_ms"]["median"].get<double>(),
      run.report["skew_ms"]["worst"].get<double>(), run.times.spread_ms, run.times.stray_ms, run.cpu_ms,
      run.stood_ms);
  return run;
}

// Frames of a guest that stands still are lost by its own drivers: such a recording shows nothing, and
// another is made. A recording counts that has all that is asked, or that a guest made which kept time.
TEST_CASE("vivid: 9 and 16 cameras for 10 s, against v4l2-ctl", "[rig]") {
  const TempFolder folder;
  bool shown = true;
  for (const int count : {9, 16}) {
    CAPTURE(count);
    const fs::path disk = folder / "disk";
    fs::create_directory(disk);
    shell(fmt::format("mount -t tmpfs -o size=2600m big {}", disk.string()));
    const PeerTimes peer = stream_with_v4l2_ctl(count, disk);
    fmt::print("{} cameras: v4l2-ctl {:.2f} ms a frame, in {:.1f} s for 5 s of frames\n", count, peer.cpu_ms,
               peer.s);
    bool done = false;
    for (int i = 0; i < 4 && !done; ++i) {
      const RigRun run = record_300_sets(count, disk / "rec");
      fs::remove_all(disk / "rec");
      done = (run.whole() && run.on_beat()) || run.stood_ms < Witness::kStoodStill;
      CHECK(run.cpu_ms < 1.3 * peer.cpu_ms);  // with room for what else the machine does
      if (!done) continue;
      CHECK(run.whole());
      CHECK(run.on_beat());
    }
    shown = shown && done;
    shell(fmt::format("umount {}", disk.string()));
    fs::remove(disk);
  }
  if (!shown) STUV_SKIP("this machine is too slow or too busy: its guest stands still while it records");
}

/// The recording FOLDER/rec, rectified with a rig of equal cameras side by side, to a picture: it has vivid's
/// bars, which all cameras show at the same pixels, as if infinitely far away.
void check_chain(const fs::path& folder) {
  const Recording recording = open_recording(folder / "rec");
  Rig rig;
  rig.rows = 1;
  rig.cols = static_cast<int>(recording.cameras.size());
  rig.s_step_m = {0.1, 0};
  for (const RecordedCamera& recorded : recording.cameras) {
    RigCamera camera;
    camera.camera = {recorded.name, "LENSMODEL_PINHOLE", {300, 300, 159.5, 89.5}, 320, 180, {}};
    camera.col = recorded.col;
    camera.camera.cam_from_rig.t.x() = -0.1 * recorded.col;
    rig.cameras.push_back(camera);
  }
  rig.nearest_seen_m = 1;
  rig.farthest_seen_m = 5;
  fs::create_directory(folder / "rig");
  write_rig(folder / "rig", rig);
  const auto whole = std::find_if(recording.sets.begin(), recording.sets.end(),
                                  [](const FrameSet& set) { return set.complete(); });
  REQUIRE(whole != recording.sets.end());
  for (const std::string& arguments :
       {fmt::format("rectify {0}/rec --rig {0}/rig -o {0}/scene --set {1}", folder.string(), whole->name),
        fmt::format("render {0}/scene -o {0}/sharp.png --planes 4 --window 1", folder.string())}) {
    const ProgramResult result = run_stuv(arguments);
    CAPTURE(arguments, result.out, result.err);
    REQUIRE(result.exit_code == 0);
  }
  const ImageF picture = to_float(read_image(folder / "sharp.png"));
  for (const auto& bar : kBars) {
    int pixels = 0;
    for (int x = 0; x < picture.width; ++x) {
      double off = 0;
      for (int c = 0; c < 3; ++c)
        off = std::max(off, std::abs(static_cast<double>(picture.at(x, picture.height / 2, c)) - bar[c]));
      pixels += off < 0.03 ? 1 : 0;
    }
    CAPTURE(bar[0], bar[1], bar[2]);
    CHECK(pixels > 25);
  }
}

TEST_CASE("vivid: the program itself lists, checks and records", "[program]") {
  const TempFolder folder;
  for (const int camera : {0, 1}) {
    set_control(camera, "test_pattern", 1);
    set_control(camera, "osd_text_mode", 2);
    set_control(camera, "brightness", 128);  // the default; another case changes it
  }
  const std::string config = (folder / "rig.toml").string();
  const ProgramResult cameras = run_stuv("cameras -o " + config);
  CHECK(cameras.exit_code == 0);
  CHECK_THAT(cameras.out, Contains("bus:platform:vivid-001"));
  shell(fmt::format(
      "sed -i 's/^format = .*/format = \"YUYV\"/; s/^width = .*/width = 320/; s/^height = .*/height = 180/; "
      "s/^fps = .*/fps = 30/' {}",
      config));
  const ProgramResult check = run_stuv("capture " + config + " --check");
  CAPTURE(check.out, check.err);
  CHECK(check.exit_code == 0);
  const ProgramResult recorded = run_stuv(
      fmt::format("capture {} -o {} --seconds 3 --preview {} --json {}", config, (folder / "rec").string(),
                  (folder / "live").string(), (folder / "r.json").string()));
  CAPTURE(recorded.err);
  CHECK(recorded.exit_code == 0);
  CHECK(read_json(folder / "r.json")["report"]["sets"]["complete"].get<int>() > 30);
  CHECK(read_image(folder / "live" / "sheet.jpg").width > 600);
  check_chain(folder.path());
  // Ctrl-C ends it cleanly.
  const fs::path rec = folder / "rec2";
  const pid_t child = ::fork();
  if (child == 0) {
    ::execl(STUV_PROGRAM, STUV_PROGRAM, "capture", config.c_str(), "-o", rec.c_str(), nullptr);
    ::_exit(9);
  }
  for (int i = 0; i < 300 && !fs::exists(rec); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  std::this_thread::sleep_for(std::chrono::seconds(1));
  ::kill(child, SIGINT);
  int status = -1;
  ::waitpid(child, &status, 0);
  CHECK(WIFEXITED(status));
  CHECK(WEXITSTATUS(status) == 0);
  CHECK(fs::exists(rec / "report.json"));
  CHECK(open_recording(rec).sets.size() > 3);
}

TEST_CASE("libcamera: nine vimc cameras, all frames accounted for; one is unplugged", "[libcamera]") {
  const TempFolder folder;
  const std::vector<CameraInfo> cameras = list_cameras(*std::make_unique<std::vector<std::string>>());
  CameraSourceOptions options;
  options.cols = 9;
  for (const CameraInfo& info : cameras) {
    if (!info.id.starts_with("libcamera:")) continue;
    CameraSettings camera;
    camera.id = info.id;
    camera.name = fmt::format("cam{}", options.cameras.size());
    camera.col = static_cast<int>(options.cameras.size());
    camera.width = 156;  // vimc scales to multiples of 12
    camera.height = 120;
    camera.buffers = 8;
    options.cameras.push_back(camera);
  }
  REQUIRE(options.cameras.size() == 9);
  REQUIRE(problem_of(options).empty());
  const Taken taken = take(options, folder / "rec", 8);
  check_accounts(taken);
  CHECK(taken.warnings.empty());
  // Nine pipelines are computed here, each at what rate it gets: sets need not be complete.
  fmt::print("vimc: {} sets complete, {} incomplete; first camera {}\n",
             taken.report["sets"]["complete"].dump(), taken.report["sets"]["incomplete"].dump(),
             taken.camera(0).dump());
  REQUIRE(taken.recording.sets.size() > 10);
  for (const Frame& frame : taken.recording.sets[5].frames)
    if (frame.status == FrameStatus::ok) CHECK(read_image(frame.file).width == 156);

  const std::string id = options.cameras[4].id;  // "libcamera:platform/vimc.4 Sensor B"
  const std::string device = id.substr(id.find('/') + 1, id.find(' ') - id.find('/') - 1);
  const Taken unplugged = take(options, folder / "rec2", 10,
                               [&] { std::ofstream("/sys/bus/platform/drivers/vimc/unbind") << device; });
  check_accounts(unplugged);
  CHECK(unplugged.count(4, "lost") == 1);
  CHECK_THAT(unplugged.all_warnings(), Contains("camera cam4") && Contains("unplugged"));
  CHECK(unplugged.count(3, "recorded") > unplugged.count(4, "recorded"));
  CHECK(unplugged.recording.sets.back().frames[4].status == FrameStatus::missing);
}
