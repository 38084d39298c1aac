#include <fmt/format.h>

#include <unistd.h>

#include <atomic>
#include <chrono>
#include <csignal>

#include "app/commands.h"
#include "app/console.h"
#include "calib/board/pattern.h"
#include "capture/cameras/check.h"
#include "capture/cameras/live_view.h"
#include "capture/capture.h"
#include "capture/config.h"
#include "core/files.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path config, output;
  std::string pattern, grid;
  std::size_t sets = 0;
  int every = 1;
  double seconds = 0;
  std::filesystem::path preview, sysfs = "/sys";
  bool check = false, copy = false, complete = false;
};

std::atomic<bool> stop_asked{false};

/// Ctrl-C ends a live capture cleanly; the second one ends the program.
void stop_on_signals() {
  const auto stop = [](int signal) {
    stop_asked = true;
    std::signal(signal, SIG_DFL);
  };
  std::signal(SIGINT, stop);
  std::signal(SIGTERM, stop);
}

void check_usage(const Flags& flags) {
  if (flags.output.empty() != flags.check) throw UsageError("give either -o REC or --check");
  const bool files = !flags.pattern.empty();
  if (files && !flags.config.empty())
    throw UsageError("CONFIG and --files exclude each other: give one of them");
  if (files && flags.grid.empty()) throw UsageError("--files needs --grid ROWSxCOLS");
  if (!files && !flags.grid.empty())
    throw UsageError("--grid belongs to --files; a config has its own rows and cols");
  if (files && flags.pattern.find("{camera}") == std::string::npos)
    throw UsageError(
        "--files wants a pattern with {camera}, and {set} where there are several sets of pictures");
}

/// The synthetic rig draws what it is given: its board, if it is no chessboard, comes from here.
void give_pattern(synthetic::BoardOptions& options) {
  if (options.spec.empty()) return;
  const Board board = parse_board(options.spec);
  options.spec = board_spec(board);
  options.columns = board.columns;
  options.rows = board.rows;
  options.square_m = board.square_m;
  if (board.kind == Board::Kind::chessboard) return;
  options.pattern = std::make_shared<synthetic::BoardPattern>(
      synthetic::BoardPattern{dark_areas(board), board_outline(board), board.inverted});
}

CaptureConfig config_of(const Flags& flags) {
  if (flags.pattern.empty()) {
    CaptureConfig config =
        flags.config.empty() ? default_capture_config() : read_capture_config(flags.config);
    if (auto* files = std::get_if<FilesOptions>(&config)) {
      files->copy |= flags.copy;
      files->complete |= flags.complete;
      if (flags.every > 1) files->every = flags.every;
    } else if (flags.copy || flags.every > 1) {
      throw UsageError("--copy and --every belong to files, and this config is of another kind");
    }
    if (auto* synthetic = std::get_if<synthetic::SyntheticOptions>(&config)) give_pattern(synthetic->board);
    if (auto* cameras = std::get_if<CameraSourceOptions>(&config)) {
      if (flags.seconds > 0) cameras->duration_s = flags.seconds;
    } else if (flags.seconds > 0) {
      throw UsageError("--seconds belongs to cameras, and this config is of another kind");
    }
    return config;
  }
  FilesOptions files;
  files.pattern = flags.pattern;
  std::tie(files.rows, files.cols) = parse_size("--grid", flags.grid);
  files.copy = flags.copy;
  files.complete = flags.complete;
  files.every = flags.every;
  return files;
}

/// One line a camera, drawn over themselves, about once a second; and the contact sheet, if one is wanted.
class Watch {
 public:
  Watch(const CameraSourceOptions& options, std::filesystem::path preview)
      : view_(options.rows, options.cols, places(options)), preview_(std::move(preview)) {}

  void operator()(const std::vector<CameraStatus>& cameras, const SourceSet& set) {
    if (!terminal_ && preview_.empty()) return;
    view_.look(set);
    const auto now = std::chrono::steady_clock::now();
    if (now - drawn_at_ < std::chrono::seconds(1)) return;
    drawn_at_ = now;
    if (terminal_) draw(cameras);
    if (!preview_.empty()) view_.write_preview(preview_);
  }

 private:
  static std::vector<RecordedCamera> places(const CameraSourceOptions& options) {
    std::vector<RecordedCamera> cameras;
    for (const CameraSettings& camera : options.cameras)
      cameras.push_back({camera.name, camera.row, camera.col});
    return cameras;
  }

  void draw(const std::vector<CameraStatus>& cameras) {
    if (lines_ > 0) fmt::print(stderr, "\x1b[{}A", lines_);
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      const CameraStatus& camera = cameras[i];
      const Glance& glance = view_.glance(i);
      fmt::print(stderr, "\r\x1b[K{:<12} {:5.1f} fps {:6} frames {:4} dropped {:4} flawed", camera.name,
                 camera.fps, camera.frames, camera.dropped, camera.flawed);
      if (!camera.live)
        fmt::print(stderr, "  GONE\n");
      else if (glance.known)
        fmt::print(stderr, "  exposure {:3.0f} %  clipped {:4.1f} %  sharpness {:4.1f}\n", 100 * glance.level,
                   100 * glance.clipped, glance.sharpness);
      else
        fmt::print(stderr, "\n");
    }
    lines_ = cameras.size();
  }

  LiveView view_;
  std::filesystem::path preview_;
  const bool terminal_ = ::isatty(STDERR_FILENO) != 0;
  std::size_t lines_ = 0;
  std::chrono::steady_clock::time_point drawn_at_ = std::chrono::steady_clock::now();
};

std::string megabytes(double bytes) { return fmt::format("{:.1f} MB/s", 1e-6 * bytes); }

Json to_json(const RigCheck& check) {
  Json cameras = Json::array(), links = Json::array(), proposals = Json::array();
  for (const CheckedCamera& camera : check.cameras)
    cameras.push_back({{"name", camera.name},
                       {"delivers", camera.delivers},
                       {"settings", camera.settings},
                       {"trouble", camera.trouble}});
  for (const LinkLoad& link : check.links)
    links.push_back({{"name", link.name},
                     {"speed_mbit", link.speed_mbit},
                     {"capacity_bytes_per_s", link.capacity},
                     {"load_bytes_per_s", link.load},
                     {"fits", link.fits()},
                     {"cameras", link.cameras}});
  for (const Proposal& p : check.proposals)
    proposals.push_back({{"link", p.link},
                         {"format", p.fourcc},
                         {"width", p.width},
                         {"height", p.height},
                         {"fps", p.fps},
                         {"load_bytes_per_s", p.load}});
  return {{"good", check.good()}, {"cameras", cameras}, {"usb_links", links}, {"proposals", proposals}};
}

int run_check(const Flags& flags) {
  const CaptureConfig config = config_of(flags);
  const auto* options = std::get_if<CameraSourceOptions>(&config);
  if (options == nullptr) throw UsageError("--check belongs to cameras, and this config is of another kind");
  const RigCheck check = check_rig(*options, flags.sysfs);
  for (const CheckedCamera& camera : check.cameras)
    fmt::print("{}: {}\n", camera.name, camera.trouble.empty() ? "delivers" : camera.trouble);
  for (const LinkLoad& link : check.links)
    fmt::print("{} ({:.0f} Mbit/s): {} of {}{}, cameras {}\n", link.name, link.speed_mbit,
               megabytes(link.load), megabytes(link.capacity), link.fits() ? "" : ", TOO MUCH",
               fmt::join(link.cameras, ", "));
  for (const Proposal& p : check.proposals)
    fmt::print("{} would fit with {} {}x{} at {:.5g} fps: {}\n", p.link, p.fourcc, p.width, p.height, p.fps,
               megabytes(p.load));
  write_result(flags, to_json(check));
  return check.good() ? kDone : kVerdictNotGood;
}

int run(const Flags& flags) {
  check_usage(flags);
  if (flags.check) return run_check(flags);
  check_output(flags.output, flags.force);
  const Reporter reporter = console_reporter();
  const CaptureConfig config = config_of(flags);
  if (std::holds_alternative<CameraSourceOptions>(config)) stop_on_signals();
  StatusFunction status;
  if (const auto* cameras = std::get_if<CameraSourceOptions>(&config))
    status = [watch = std::make_shared<Watch>(*cameras, flags.preview)](
                 const auto& list, const SourceSet& set) { (*watch)(list, set); };
  const std::unique_ptr<Source> source = open_source(config, reporter, &stop_asked, std::move(status));
  CaptureOptions options;
  if (flags.sets > 0) options.sets = flags.sets;
  options.complete = flags.complete;
  options.force = flags.force;
  const CaptureResult result = capture(*source, flags.output, options, reporter);
  write_result(flags, {{"recording", flags.output.string()},
                       {"rows", source->rows()},
                       {"cols", source->cols()},
                       {"cameras", source->cameras().size()},
                       {"sets", result.sets},
                       {"incomplete_sets", result.incomplete_sets},
                       {"frames", result.frames},
                       {"report", result.report}});
  fmt::print("{}: {} sets of {} cameras, {} frames, {} incomplete\n", flags.output.string(), result.sets,
             source->cameras().size(), result.frames, result.incomplete_sets);
  return kDone;
}

}  // namespace

void add_capture_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand(
      "capture",
      "Records frame sets of all cameras.\n\n"
      "  stuv capture -o rec                      the built-in synthetic rig, 5x5 cameras\n"
      "  stuv capture --files 'Position{set}_Camera{camera}.png' --grid 1x20 -o rec\n"
      "  stuv capture --files 'cam_{camera}.mp4' --grid 1x4 --every 10 -o rec\n"
      "  stuv cameras -o rig.toml                 then, with real cameras:\n"
      "  stuv capture rig.toml --check\n"
      "  stuv capture rig.toml -o rec --seconds 10 --preview live\n");
  command->add_option("config", flags->config, "What to record, TOML (see configs/) [a synthetic 5x5 rig]");
  command->add_option("-o,--output", flags->output, "The recording's folder")->type_name("REC");
  command
      ->add_option("--files", flags->pattern,
                   "Pictures on disk: a path with {set} and {camera}; or videos, one a camera, in step")
      ->type_name("PATTERN");
  command->add_option("--grid", flags->grid, "Places of the cameras, filled row by row in natural order")
      ->type_name("ROWSxCOLS");
  command->add_option("--sets", flags->sets, "Stop after so many sets [all there are]")
      ->check(CLI::PositiveNumber);
  command->add_option("--every", flags->every, "Files: every n-th set, or frame of videos [1]")
      ->check(CLI::Range(1, kMostCount));
  command->add_option("--seconds", flags->seconds, "Cameras: stop after so long [until Ctrl-C]")
      ->check(CLI::PositiveNumber);
  command->add_flag("--check", flags->check, "Cameras: open all, add up the USB bandwidth, record nothing");
  command->add_option("--preview", flags->preview, "Cameras: a contact sheet to look at in a browser")
      ->type_name("DIR");
  command->add_option("--sysfs", flags->sysfs, "Where --check reads the USB tree [/sys]")->type_name("DIR");
  command->add_flag("--copy", flags->copy, "Copy the pictures instead of referring to them");
  command->add_flag("--complete", flags->complete, "Fail if a set lacks a camera");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
