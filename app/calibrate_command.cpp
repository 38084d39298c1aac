#include <fmt/format.h>

#include <chrono>
#include <cmath>

#include "app/commands.h"
#include "app/console.h"
#include "calib/board/find_corners.h"
#include "calib/board/overlay.h"
#include "calib/interchange/corners_vnl.h"
#include "calib/photometry/board_samples.h"
#include "calib/solve/report.h"
#include "calib/tracking/moving_rig.h"
#include "calib/tracking/sequence.h"
#include "calib/two_view/no_board.h"
#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"
#include "core/rig.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path recording, output;
  std::string board, moving, camera;
  std::filesystem::path overlay;
  std::optional<Lens> lens;
  std::string distance;
  std::filesystem::path lenses, corners;
  double spacing_m = 0;
  bool complete = false, no_board = false, shared_lens = false;
};

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

Board choose_board(const Flags& flags, const Recording& recording) {
  if (!flags.board.empty()) return parse_board(flags.board);
  if (recording.source.is_object() && recording.source.contains("board") &&
      recording.source["board"].is_string())
    return parse_board(recording.source["board"]);
  throw Error(flags.recording.string(), "does not say which board it shows",
              "name it: --board chessboard:28x17:20mm (inner corners, square size)");
}

/// --corners: what somebody found already.
FoundCorners corners_from_file(const Flags& flags, const Board& board, const Recording& recording,
                               const Reporter& reporter) {
  int unused = 0;
  FoundCorners found = read_found_corners(flags.corners, board, recording, unused);
  if (unused > 0)
    reporter.warn(fmt::format("{}: {} of its pictures are not in the recording and are left out",
                              flags.corners.string(), unused));
  return found;
}

Observations observations_of(const Recording& recording, const Board& board, FoundCorners found) {
  const double usual_sigma_px = median_sigma_px(found);
  Observations in;
  in.board = board;
  in.size_px = std::move(found.size_px);
  for (const RecordedCamera& camera : recording.cameras) in.camera_names.push_back(camera.name);
  for (std::size_t s = 0; s < recording.sets.size(); ++s) {
    in.set_names.push_back(recording.sets[s].name);
    for (std::size_t c = 0; c < recording.cameras.size(); ++c) {
      BoardView& view = found.views[s][c];
      if (view.empty()) continue;
      std::vector<double> weights = corner_weights(view, usual_sigma_px);
      in.boards.push_back(
          {static_cast<int>(c), static_cast<int>(s), std::move(view.corners_px), std::move(weights)});
    }
  }
  return in;
}

/// The pictures in which a board was found, with its corners drawn.
void write_overlays(const Flags& flags, const Recording& recording, const Board& board,
                    const FoundCorners& found, const Reporter& reporter) {
  AtomicOutput output(flags.overlay, AtomicOutput::Kind::folder, flags.force);
  const double usual_sigma_px = median_sigma_px(found);
  Json names = Json::array();
  for (std::size_t s = 0; s < recording.sets.size(); ++s) {
    reporter.at("drawing corners", s, recording.sets.size());
    for (std::size_t c = 0; c < recording.cameras.size(); ++c) {
      const BoardView& view = found.views[s][c];
      if (view.empty()) continue;
      const std::string name = recording.sets[s].name + "_" + recording.cameras[c].name + ".png";
      const Image picture = read_image(recording.sets[s].frames[c].file);
      write_image(output.path() / name, draw_board_overlay(picture, board, view, usual_sigma_px));
      names.push_back(name);
    }
  }
  write_json(output.path() / "overlay.json",
             {{"format", "stuv.overlay"}, {"version", 1}, {"pictures", names}});
  output.commit();
}

const char* name_of(Lens lens) {
  if (lens == Lens::opencv5) return "opencv5";
  if (lens == Lens::opencv8) return "opencv8";
  return lens == Lens::splined ? "splined" : "opencv4";
}

Json produced_by(const Flags& flags, const Recording& recording, const Calibration& c) {
  return {{"program", std::string("stuv ") + STUV_VERSION},
          {"board", board_spec(c.observations.board)},
          {"lens", flags.lenses.empty() ? name_of(c.lens) : "held"},
          {"lenses", !flags.lenses.empty() ? flags.lenses.string()
                     : flags.shared_lens   ? "one for all"
                                           : "one a camera"},
          {"sets", recording.sets.size()},
          {"boards", c.observations.boards.size()},
          {"detector", fmt::format("stuv {}, OpenCV", kDetectorVersion)},
          {"solver", "mrcal"}};
}

/// "A,B,METRES"
NoBoardOptions::Distance parse_distance(const std::string& text) {
  const std::vector<std::string> parts = parse_list("--distance", text);
  NoBoardOptions::Distance distance;
  if (parts.size() == 3) {
    distance.a = parts[0];
    distance.b = parts[1];
    distance.m = parse_pair("--distance", parts[2] + ",0").first;
  }
  if (!(distance.m > 0) || !std::isfinite(distance.m))
    throw UsageError(fmt::format("--distance wants two cameras and metres, A,B,0.5, not '{}'", text));
  return distance;
}

/// What the rig's report says of its lenses, in the order of `lenses`; empty where it says nothing.
std::vector<Eigen::MatrixXd> stated_lens_covariances(const std::filesystem::path& rig,
                                                     const std::vector<Camera>& lenses) {
  std::vector<Eigen::MatrixXd> result(lenses.size());
  const std::filesystem::path file = rig / "report.json";
  if (!std::filesystem::exists(file)) return result;
  const Json report = read_json(file);
  for (const Json& c : report.value("cameras", Json::array()))
    for (std::size_t i = 0; i < lenses.size(); ++i)
      if (c.value("name", "") == lenses[i].name) result[i] = lens_covariance_of(c);
  return result;
}

NoBoardOptions no_board_options(const Flags& flags) {
  if (!flags.board.empty()) throw UsageError("--no-board and --board exclude each other");
  NoBoardOptions options;
  if (!flags.distance.empty()) options.distance = parse_distance(flags.distance);
  options.spacing_m = flags.spacing_m;
  if (!options.distance && !(options.spacing_m > 0))
    throw UsageError("--no-board wants a scale: --spacing-m or --distance");
  if (flags.lenses.empty()) return options;
  for (const RigCamera& rc : read_rig(flags.lenses).cameras) options.lenses.push_back(rc.camera);
  options.lens_covariance = stated_lens_covariances(flags.lenses, options.lenses);
  return options;
}

CalibrationOptions calibration_options(const Flags& flags) {
  CalibrationOptions options;
  options.solve.lens = flags.lens.value_or(Lens::opencv4);
  options.solve.choose_lens = !flags.lens;
  options.solve.shared_lens = flags.shared_lens;
  if (flags.lenses.empty()) return options;
  if (flags.shared_lens) throw UsageError("--shared-lens and --lenses exclude each other");
  for (const RigCamera& rc : read_rig(flags.lenses).cameras)
    if (rc.determined) options.solve.known.push_back(rc.camera);
  return options;
}

void print_summary(const Flags& flags, const Calibration& c) {
  const auto step = [](const Eigen::Vector2d& v) {
    return v.norm() > 0 ? fmt::format("{:.2f}", 1e3 * v.norm()) : "-";
  };
  fmt::print("{}: {}x{} lattice, spacing {} x {} mm, rms {:.3f} px, {:.1f} % outliers, {:.2f} mm off plane\n",
             flags.output.string(), c.rig.rows, c.rig.cols, step(c.rig.s_step_m), step(c.rig.t_step_m),
             c.solution.rms_px,
             100.0 * c.solution.outliers / std::max(1, c.solution.inliers + c.solution.outliers),
             1e3 * c.rig.rms_off_plane_m);
  if (c.cross_validation_px) fmt::print("left-out boards: rms {:.3f} px\n", *c.cross_validation_px);
  if (const std::string text = ghosting_text(c.ghosting); !text.empty()) fmt::print("{}\n", text);
  fmt::print("verdict: {}\n", c.good ? "good" : "not good");
  for (const std::string& reason : c.reasons) fmt::print("  {}\n", reason);
  for (const std::string& note : c.notes) fmt::print("note: {}\n", note);
  for (const std::string& next : c.advice) fmt::print("next: {}\n", next);
}

int write_rig_and_report(const Flags& flags, const Calibration& c, double seconds, double seconds_corners,
                         const Photometry* photometry = nullptr) {
  AtomicOutput output(flags.output, AtomicOutput::Kind::folder, flags.force);
  write_rig(output.path(), c.rig);
  const Json report = report_json(c, seconds, seconds_corners);
  write_json(output.path() / "report.json", report);
  write_text(output.path() / "report.html", report_page(c));
  if (photometry != nullptr) write_photometry(output.path(), *photometry);
  output.commit();
  write_result(flags, report);
  print_summary(flags, c);
  if (photometry != nullptr) fmt::print("{}\n", summary_of(*photometry));
  return c.good ? kDone : kVerdictNotGood;
}

int run_without_board(const Flags& flags, const Recording& recording, const Reporter& reporter) {
  const auto begin = Clock::now();
  const NoBoardOptions options = no_board_options(flags);
  const SfmProblem problem = find_tracks(recording, options, reporter);
  const double seconds_tracks = seconds_since(begin);
  Calibration c = calibrate_without_board(problem, recording, options, reporter);
  c.rig.produced_by = {{"program", std::string("stuv ") + STUV_VERSION},
                       {"board", nullptr},
                       {"lenses", options.lenses.empty() ? "one shared focal length" : flags.lenses.string()},
                       {"sets", recording.sets.size()},
                       {"tracks", problem.tracks.size()},
                       {"detector", "OpenCV SIFT"},
                       {"solver", "Ceres"}};
  return write_rig_and_report(flags, c, seconds_since(begin), seconds_tracks);
}

/// The recording's cameras are the frames of one that moved; its first set has their pictures.
std::vector<tracking::MovingFrame> moving_frames(const Flags& flags, const Recording& recording) {
  if (recording.sets.empty()) throw Error(flags.recording.string(), "has no set", "record one");
  std::vector<tracking::SequenceFrame> sequence;
  for (std::size_t i = 0; i < recording.cameras.size(); ++i) {
    tracking::SequenceFrame frame{recording.cameras[i].name, recording.sets[0].frames[i].file, double(i), -1};
    sequence.push_back(std::move(frame));
  }
  tracking::number_frames(sequence);
  const std::vector<std::optional<Pose>> poses = tracking::poses_of(flags.moving, sequence);
  std::vector<tracking::MovingFrame> frames;
  for (std::size_t i = 0; i < sequence.size(); ++i)
    if (poses[i] && recording.sets[0].frames[i].status == FrameStatus::ok)
      frames.push_back({sequence[i].name, sequence[i].file, *poses[i]});
  return frames;
}

int run_moving(const Flags& flags) {
  const auto begin = Clock::now();
  if (flags.camera.empty()) throw UsageError("--moving wants --camera, the lens of the camera that moved");
  check_output(flags.output, flags.force);
  const Camera camera = parse_camera(flags.camera);
  const Recording recording = open_recording(flags.recording);
  Calibration c = tracking::calibrate_moving(moving_frames(flags, recording), camera, {}, console_reporter());
  c.rig.produced_by = {{"program", std::string("stuv ") + STUV_VERSION},
                       {"moving", flags.moving},
                       {"frames", c.rig.cameras.size()},
                       {"solver", "Ceres"}};
  return write_rig_and_report(flags, c, seconds_since(begin), 0);
}

int run(const Flags& flags) {
  if (!flags.corners.empty() && (flags.no_board || !flags.moving.empty()))
    throw UsageError("--corners is for boards: leave --no-board and --moving away");
  if (!flags.moving.empty() && (flags.no_board || !flags.board.empty()))
    throw UsageError("--moving, --no-board and --board exclude each other");
  if (!flags.moving.empty()) return run_moving(flags);
  const auto begin = Clock::now();
  check_output(flags.output, flags.force);
  if (!flags.overlay.empty()) check_output(flags.overlay, flags.force);
  const Recording recording = open_recording(flags.recording);
  if (flags.complete) require_complete(recording);
  const Reporter reporter = console_reporter();
  if (flags.no_board) return run_without_board(flags, recording, reporter);
  const CalibrationOptions options = calibration_options(flags);
  const Board board = choose_board(flags, recording);
  FoundCorners found = flags.corners.empty() ? find_corners(recording, board, reporter)
                                             : corners_from_file(flags, board, recording, reporter);
  const double seconds_corners = seconds_since(begin);
  if (!flags.overlay.empty()) write_overlays(flags, recording, board, found, reporter);
  if (found.boards == 0)
    throw Error(flags.recording.string(),
                fmt::format("board {} is seen in none of {} pictures", board_spec(board), found.pictures),
                board.kind == Board::Kind::chessboard ? "check its inner corners COLSxROWS, light and focus"
                                                      : "check its markers, light and focus");

  Calibration c =
      calibrate(observations_of(recording, board, std::move(found)), recording, options, reporter);
  c.rig.produced_by = produced_by(flags, recording, c);
  const Photometry photometry = photometry_from_boards(recording, c.observations, c.rig, reporter);
  return write_rig_and_report(flags, c, seconds_since(begin), seconds_corners, &photometry);
}

}  // namespace

void add_calibrate_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      app.add_subcommand("calibrate",
                         "Finds boards and solves for all cameras: lenses, places, plane and lattice.\n\n"
                         "  stuv capture -o rec && stuv calibrate rec -o rig\n"
                         "  stuv calibrate rec -o rig --board chessboard:28x17:20mm\n"
                         "  stuv calibrate rec -o rig --no-board --lenses old_rig --spacing-m 0.03\n"
                         "  stuv capture --files 'f_{camera}.png' --grid 1x81 -o rec\n"
                         "  stuv calibrate rec -o rig --moving poses.txt --camera cam.cameramodel\n");
  command->add_option("recording", flags->recording, "The recording's folder")->required()->type_name("REC");
  command->add_option("-o,--output", flags->output, "The rig's folder")->required()->type_name("RIG");
  command
      ->add_option(
          "--board", flags->board,
          "chessboard:COLSxROWS:SQUARE (inner corners), "
          "charuco:COLSxROWS:SQUARE:MARKER:DICT[:inverted][:legacy] (squares), "
          "aprilgrid:COLSxROWS:TAG:GAP (tags; gap in tags or with its unit), or Kalibr's target .yaml "
          "[what the recording says]; `stuv board` prints them")
      ->type_name("BOARD");
  command->add_option("--overlay", flags->overlay, "Folder for the pictures with the corners found drawn")
      ->type_name("DIR");
  command
      ->add_option("--corners", flags->corners,
                   "Solve from the corners in mrcal's corners.vnl instead of looking for boards")
      ->type_name("FILE");
  const std::map<std::string, Lens> lenses = {{"opencv4", Lens::opencv4},
                                              {"opencv5", Lens::opencv5},
                                              {"opencv8", Lens::opencv8},
                                              {"splined", Lens::splined}};
  command
      ->add_option("--lens", flags->lens,
                   "opencv4, opencv5, opencv8 or splined [opencv4; opencv5 where that does not fit]")
      ->transform(CLI::CheckedTransformer(lenses))
      ->type_name("LENS");
  command->add_flag("--shared-lens", flags->shared_lens,
                    "One lens for all cameras, where they are identical");
  command->add_flag("--no-board", flags->no_board, "Solve from the scene: features that several cameras see");
  command
      ->add_option("--lenses", flags->lenses,
                   "Rig whose lenses are held [solved; with --no-board one shared focal length]")
      ->type_name("RIG");
  command->add_option("--spacing-m", flags->spacing_m,
                      "With --no-board: scale by the lattice's spacing along s [m]");
  command
      ->add_option("--distance", flags->distance, "With --no-board: scale by the distance of two cameras [m]")
      ->type_name("A,B,M");
  command
      ->add_option(
          "--moving", flags->moving,
          "The recording's cameras are frames of one camera: their poses from `stuv track`, no board")
      ->type_name("POSES");
  command->add_option("--camera", flags->camera, "With --moving: a .cameramodel or WxH,fx,fy,cx,cy")
      ->type_name("C");
  command->add_flag("--complete", flags->complete, "Refuse a recording with sets that lack cameras");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
