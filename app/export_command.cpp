#include <fmt/format.h>

#include <algorithm>

#include "app/camera_formats.h"
#include "app/commands.h"
#include "app/console.h"
#include "calib/board/find_corners.h"
#include "calib/interchange/corners_vnl.h"
#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

struct Flags : CommonFlags {
  fs::path source, output, recording;
  std::string format, depth_m, set, board;
  double fit_px = 0.01;
};

/// camchain.yaml, transforms.json and poses_bounds.npy may be asked for as files.
bool wants_file(const Flags& flags, CameraFormat format) {
  const std::string file = file_name_of(format);
  return !file.empty() && flags.output.extension() == fs::path(file).extension();
}

void set_depths(const Flags& flags, CameraList& cameras) {
  if (flags.depth_m.empty()) return;
  const auto [near_m, far_m] = parse_pair("--depth-m", flags.depth_m);
  if (!(near_m > 0 && near_m < far_m)) throw UsageError("--depth-m wants NEAR,FAR with 0 < NEAR < FAR");
  for (ListedCamera& c : cameras) c.near_m = near_m, c.far_m = far_m;
}

const FrameSet& set_of(const Recording& recording, const std::string& name) {
  const int index = name.empty() ? static_cast<int>(recording.sets.size()) - 1 : recording.set_index(name);
  if (index < 0)
    throw Error(recording.folder.string(), fmt::format("has no set {}", name), "see its folder sets/");
  return recording.sets[index];
}

/// Puts one set's pictures into images/; cameras without a picture are left out.
void add_pictures(const Flags& flags, const fs::path& folder, CameraList& cameras, const Reporter& reporter) {
  const Recording recording = open_recording(flags.recording);
  const FrameSet& set = set_of(recording, flags.set);
  fs::create_directory(folder / "images");
  CameraList kept;
  for (ListedCamera& c : cameras) {
    const int index = recording.camera_index(c.camera.name);
    if (index < 0 || set.frames[index].status != FrameStatus::ok) {
      reporter.warn(
          fmt::format("camera {} has no picture in set {} and is left out", c.camera.name, set.name));
      continue;
    }
    const fs::path& file = set.frames[index].file;
    c.picture = "images/" + c.camera.name + file.extension().string();
    std::error_code ec;
    fs::copy_file(file, folder / c.picture, ec);
    if (ec) throw Error(file.string(), "cannot be copied: " + ec.message(), "check the picture and the disk");
    kept.push_back(std::move(c));
  }
  cameras = std::move(kept);
}

Json manifest(const Flags& flags, CameraFormat format, const CameraList& cameras, const LensFits& fits) {
  Json names = Json::array();
  for (const ListedCamera& c : cameras) names.push_back(c.camera.name);
  return {{"format", "stuv.export"},
          {"version", 1},
          {"written_as", name_of(format)},
          {"rig", flags.source.filename().string()},
          {"cameras", names},
          {"lens_fits", fits_json(fits)}};
}

Board board_of(const Flags& flags, const Recording& recording) {
  if (!flags.board.empty()) return parse_board(flags.board);
  if (recording.source.is_object() && recording.source.contains("board") &&
      recording.source["board"].is_string())
    return parse_board(recording.source["board"]);
  throw UsageError("--format corners wants --board: the recording does not say which it shows");
}

int run_corners(const Flags& flags) {
  check_name("--output", flags.output, {".vnl"});
  check_output(flags.output, flags.force);
  const Recording recording = open_recording(flags.source);
  const Board board = board_of(flags, recording);
  const std::vector<PictureCorners> pictures =
      picture_corners(recording, find_corners(recording, board, console_reporter()));
  AtomicOutput output(flags.output, AtomicOutput::Kind::file, flags.force);
  write_corners_vnl(output.path(), pictures);
  output.commit();
  const auto boards =
      std::count_if(pictures.begin(), pictures.end(), [](const auto& p) { return !p.corners_px.empty(); });
  write_result(flags,
               {{"corners", flags.output.string()}, {"pictures", pictures.size()}, {"boards", boards}});
  fmt::print("{}: boards in {} of {} pictures\n", flags.output.string(), boards, pictures.size());
  return kDone;
}

int run(const Flags& flags) {
  if (flags.format == "corners") return run_corners(flags);
  if (!flags.set.empty() && flags.recording.empty()) throw UsageError("--set wants --recording");
  const CameraFormat format = parse_camera_format("--format", flags.format);
  const bool as_file = wants_file(flags, format);
  if (as_file && !flags.recording.empty())
    throw UsageError("pictures want a folder: name one, or leave --recording away");
  const Rig rig = read_rig(flags.source);
  CameraList cameras = cameras_of(rig);
  const Reporter reporter = console_reporter();
  for (const RigCamera& rc : rig.cameras)
    if (!rc.determined)
      reporter.warn(
          fmt::format("camera {} is not determined by the calibration and is left out", rc.camera.name));
  set_depths(flags, cameras);
  LensFits fits;
  fits.most_px = flags.fit_px;
  AtomicOutput output(flags.output, as_file ? AtomicOutput::Kind::file : AtomicOutput::Kind::folder,
                      flags.force);
  if (!flags.recording.empty()) add_pictures(flags, output.path(), cameras, reporter);
  write_cameras(output.path(), format, cameras, fits);
  const Json result = manifest(flags, format, cameras, fits);
  if (!as_file) write_json(output.path() / "export.json", result);
  output.commit();
  write_result(flags, result);
  print_fits(fits, reporter);
  fmt::print("{}: {} cameras for {}\n", flags.output.string(), cameras.size(), name_of(format));
  return kDone;
}

}  // namespace

void add_export_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      app.add_subcommand("export",
                         "Writes a rig for other tools.\n\n"
                         "  stuv export rig -o colmap_model --format colmap\n"
                         "  stuv export rig -o nerf --format nerfstudio --recording rec --set scene00\n"
                         "  stuv export rig -o camchain.yaml --format kalibr\n"
                         "  stuv export rec -o corners.vnl --format corners --board chessboard:28x17:20mm\n\n"
                         "`stuv import` reads them back.");
  command->add_option("source", flags->source, "The rig's folder; for corners, the recording's")
      ->required()
      ->type_name("RIG");
  command->add_option("-o,--output", flags->output, "Folder, or a .yaml, .json, .npy or .vnl file")
      ->required()
      ->type_name("OUT");
  command->add_option("--format", flags->format, format_names() + " or corners")
      ->required()
      ->type_name("FORMAT");
  command
      ->add_option("--fit-px", flags->fit_px,
                   "Where a format lacks a lens, accept the nearest one it has if that is no more off than "
                   "this [0.01]")
      ->check(CLI::NonNegativeNumber);
  command->add_option("--depth-m", flags->depth_m, "For llff: where the scene lies [what the boards covered]")
      ->type_name("NEAR,FAR");
  command->add_option("--recording", flags->recording, "Put the pictures of one of its sets into images/")
      ->type_name("REC");
  command->add_option("--set", flags->set, "With --recording: which [the last one]");
  command->add_option("--board", flags->board, "For corners: the board [what the recording says]")
      ->type_name("BOARD");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
