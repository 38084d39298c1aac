#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <thread>

#include "app/commands.h"
#include "app/console.h"
#include "calib/tracking/overlay.h"
#include "calib/tracking/report.h"
#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"

namespace stuv {
namespace {

using namespace tracking;
namespace fs = std::filesystem;

struct Flags : CommonFlags {
  std::string pattern, camera, frames, teach, start, truth;
  fs::path model, output, keyframes, overlay, plots;
  double crease_deg = 20;
  TrackerOptions tracker;
};

/// "1,14,27" by name or number, or "FIRST:LAST" and "FIRST:LAST:STEP" by number.
std::vector<SequenceFrame> choose_frames(std::vector<SequenceFrame> frames, const std::string& text) {
  if (text.empty()) return frames;
  std::vector<SequenceFrame> chosen;
  if (text.find(':') != std::string::npos) {
    int first = 0, last = 0, step = 1;
    char end = 0;
    const int read = std::sscanf(text.c_str(), "%d:%d:%d%c", &first, &last, &step, &end);
    if (read < 2 || read > 3 || step < 1)
      throw UsageError(fmt::format("--frames wants a list or FIRST:LAST[:STEP], not '{}'", text));
    for (const SequenceFrame& f : frames)
      if (f.time >= first && f.time <= last && std::fmod(f.time - first, step) == 0) chosen.push_back(f);
  } else {
    const std::vector<std::string> names = parse_list("--frames", text);
    for (const SequenceFrame& f : frames)
      if (std::any_of(names.begin(), names.end(),
                      [&](const std::string& n) { return n == f.name || n == fmt::format("{}", f.time); }))
        chosen.push_back(f);
  }
  if (chosen.empty()) throw UsageError(fmt::format("--frames {} leaves no frame", text));
  return chosen;
}

int run_teach(const Flags& flags, const Camera& camera, const ObjectModel& model,
              const std::vector<SequenceFrame>& frames) {
  const std::vector<std::optional<Pose>> poses = poses_of(flags.teach, frames);
  AtomicOutput output(flags.output, AtomicOutput::Kind::folder, flags.force);
  std::vector<Keyframe> keyframes;
  Json list = Json::array();
  FrameReader reader;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (!poses[i]) continue;
    keyframes.push_back(
        teach_keyframe(frames[i].name, grey_of(reader.read(frames[i], camera)), model, camera, *poses[i]));
    list.push_back({{"frame", frames[i].name}, {"keypoints", keyframes.back().points.size()}});
  }
  if (keyframes.empty())
    throw Error(flags.teach, "has no pose for any of the frames",
                "its first column must be the number in the files' names");
  write_keyframes(output.path(), keyframes);
  output.commit();
  write_result(flags, {{"keyframes", list}});
  for (const Keyframe& k : keyframes) {
    fmt::print("{}: frame {}, {} keypoints on the object\n", flags.output.string(), k.name, k.points.size());
    if (k.points.size() < static_cast<std::size_t>(HypothesisOptions{}.least_matches))
      fmt::print(
          "note: frame {} has too few keypoints to start from; take one that shows more of the object\n",
          k.name);
  }
  return kDone;
}

/// Pictures with the wireframe drawn: a folder of them or a video, as --overlay is named; nothing without it.
class Overlays {
 public:
  Overlays(const Flags& flags, const ObjectModel& model, const Camera& camera, double fps)
      : model_(model), camera_(camera) {
    if (flags.overlay.empty()) return;
    const bool is_video = is_video_name(flags.overlay);
    output_.emplace(flags.overlay, is_video ? AtomicOutput::Kind::file : AtomicOutput::Kind::folder,
                    flags.force);
    if (is_video) video_.emplace(output_->path(), fps);
  }
  void add(const SequenceFrame& frame, const Image& picture, const TrackedFrame& tracked) {
    if (!output_) return;
    const Image drawn = draw_overlay(picture, tracked.has_pose ? &model_ : nullptr, camera_,
                                     tracked.cam_from_object, tracked.lost);
    if (video_) return video_->add(drawn);
    const std::string name = "overlay_" + frame.name + ".png";
    write_image(output_->path() / name, drawn);
    names_.push_back(name);
  }
  void commit() {
    if (!output_) return;
    if (video_)
      video_->close();
    else
      write_json(output_->path() / "overlay.json",
                 {{"format", "stuv.overlay"}, {"version", 1}, {"pictures", names_}});
    output_->commit();
  }

 private:
  const ObjectModel& model_;
  const Camera& camera_;
  std::optional<AtomicOutput> output_;
  std::optional<VideoWriter> video_;
  std::vector<std::string> names_;
};

/// Of the video that the frames come from, or what videos of pictures are played at.
double fps_of(const SequenceFrame& frame) { return frame.in_video >= 0 ? VideoReader(frame.file).fps() : 30; }

std::vector<TimedPose> found_poses(const Track& track) {
  std::vector<TimedPose> poses;
  for (std::size_t i = 0; i < track.frames.size(); ++i)
    if (!track.tracked[i].lost) poses.push_back({track.frames[i].time, track.tracked[i].cam_from_object});
  return poses;
}

Json settings_json(const Flags& flags) {
  return {{"program", std::string("stuv ") + STUV_VERSION},
          {"particles", flags.tracker.particles},
          {"adaptive", flags.tracker.adaptive},
          {"autoregression", flags.tracker.autoregression},
          {"noise_px", flags.tracker.noise_px},
          {"search_px", flags.tracker.search_px},
          {"spacing_px", flags.tracker.spacing_px},
          {"seed", flags.tracker.seed}};
}

void print_summary(const Flags& flags, const Json& json) {
  const auto frames = json["frames_total"].get<int>(), lost = json["frames_lost"].get<int>();
  fmt::print("{}: {} frames, {} lost, {:.1f} ms a frame\n", flags.output.string(), frames, lost,
             1e3 * json["seconds"]["total"].get<double>() / std::max(1, frames));
  if (json.contains("error") && json["error"]["rms_translation_m"].is_number())
    fmt::print("against the truth: rms {:.2f} mm, {:.2f} degrees over {} frames\n",
               1e3 * json["error"]["rms_translation_m"].get<double>(),
               180 / M_PI * json["error"]["rms_rotation_rad"].get<double>(),
               json["error"]["frames"].get<int>());
}

int run_track(const Flags& flags, const Camera& camera, const ObjectModel& model,
              std::vector<SequenceFrame> frames) {
  std::vector<Keyframe> keyframes;
  if (!flags.keyframes.empty()) keyframes = read_keyframes(flags.keyframes);
  Track track;
  track.frames = std::move(frames);
  if (!flags.truth.empty()) track.truth = poses_of(flags.truth, track.frames);
  Tracker tracker(model, camera, keyframes, flags.tracker);
  if (!flags.start.empty()) {
    const std::vector<std::optional<Pose>> starts = poses_of(flags.start, track.frames);
    const auto first =
        std::find_if(starts.begin(), starts.end(), [](const auto& p) { return p.has_value(); });
    if (first == starts.end())
      throw Error(flags.start, "has no pose for any of the frames",
                  "its first column must be the number in the files' names");
    // Frames before the first that has a pose cannot be tracked forwards.
    const auto skipped = first - starts.begin();
    track.frames.erase(track.frames.begin(), track.frames.begin() + skipped);
    if (!track.truth.empty()) track.truth.erase(track.truth.begin(), track.truth.begin() + skipped);
    tracker.start(**first);
  }
  const Reporter reporter = console_reporter();
  AtomicOutput output(flags.output, AtomicOutput::Kind::file, flags.force);
  FrameReader reader;
  Overlays overlays(flags, model, camera, fps_of(track.frames.front()));
  for (const SequenceFrame& frame : track.frames) {
    const Image picture = reader.read(frame, camera);
    track.tracked.push_back(tracker.track(grey_of(picture)));
    overlays.add(frame, picture, track.tracked.back());
    reporter.at("tracking", track.tracked.size(), track.frames.size());
  }
  const std::vector<TimedPose> found = found_poses(track);
  write_text(output.path(), trajectory_text(found));
  overlays.commit();
  if (!flags.plots.empty()) write_text(flags.plots, track_page(track));
  Json json = track_json(track);
  json["settings"] = settings_json(flags);
  write_result(flags, json);
  output.commit();
  print_summary(flags, json);
  if (2 * found.size() >= track.frames.size()) return kDone;
  fmt::print("verdict: not good, most frames are lost; check model, camera and keyframes\n");
  return kVerdictNotGood;
}

int run(const Flags& flags) {
  if (flags.teach.empty() && flags.keyframes.empty() && flags.start.empty())
    throw UsageError(
        "give --keyframes (made by --teach) or --start: there is nothing to find the first pose by");
  check_output(flags.output, flags.force);
  if (!flags.plots.empty()) check_output(flags.plots, flags.force);
  ModelOptions how;
  how.crease_rad = flags.crease_deg * M_PI / 180;
  const Camera camera = parse_camera(flags.camera);
  const ObjectModel model = read_obj(flags.model, how);
  const std::vector<SequenceFrame> frames = choose_frames(find_frames(flags.pattern), flags.frames);
  return flags.teach.empty() ? run_track(flags, camera, model, frames)
                             : run_teach(flags, camera, model, frames);
}

void add_tuning(CLI::App& command, TrackerOptions& o) {
  command.add_option("--particles", o.particles, "Number of particles [100]")
      ->check(CLI::Range(1, kMostCount));
  command.add_flag("--adaptive", o.adaptive, "Fewer particles (down to a quarter) where the pose is sure");
  command.add_option("--ar", o.autoregression, "Autoregression of the velocity, 0 is the random walk [0.5]")
      ->check(CLI::Range(0.0, 1.0));
  command.add_option("--noise-px", o.noise_px, "Noise of the motion, as movement of the outline [4]")
      ->check(CLI::Range(0.0, 200.0));
  command.add_option("--search-px", o.search_px, "How far to look for edges [20]")
      ->check(CLI::Range(2.0, 96.0));
  command.add_option("--spacing-px", o.spacing_px, "Distance of sample points along edges [10]")
      ->check(CLI::Range(1.0, 200.0));
  command.add_option("--seed", o.seed, "Of the random numbers [1]");
}

}  // namespace

void add_track_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand(
      "track",
      "Finds the pose of a known object in every frame of a moving camera: a particle filter on SE(3).\n\n"
      "  stuv track 'f_{frame}.png' --model box.obj --camera cam.cameramodel --teach known.txt -o keys\n"
      "  stuv track 'f_{frame}.png' --model box.obj --camera cam.cameramodel --keyframes keys -o "
      "poses.txt\n\n"
      "Poses are TUM lines `t tx ty tz qx qy qz qw`, object in camera, t the number in the file's name. "
      "Frames in "
      "which\nthe object is lost have no line. Wherever poses are read, a path with {frame} to files of one "
      "4x4 "
      "matrix does too.\n");
  command->add_option("frames", flags->pattern, "Pictures, with {frame} in the file's name, or a video")
      ->required()
      ->type_name("PATTERN|VIDEO");
  command->add_option("--model", flags->model, "The object: Wavefront OBJ in metres (f, l)")
      ->required()
      ->type_name("M.obj");
  command->add_option("--camera", flags->camera, "A .cameramodel or WxH,fx,fy,cx,cy")
      ->required()
      ->type_name("C");
  command->add_option("-o,--output", flags->output, "The poses; with --teach, the keyframes' folder")
      ->required()
      ->type_name("FILE");
  command->add_option("--keyframes", flags->keyframes, "What the object looks like, made by --teach")
      ->type_name("K");
  command->add_option("--teach", flags->teach, "Make keyframes from the frames that have a pose in this file")
      ->type_name("POSES");
  command
      ->add_option("--start", flags->start, "Start at the first pose of this file instead of from keypoints")
      ->type_name("POSES");
  command->add_option("--truth", flags->truth, "True poses: errors go into --json and --plots")
      ->type_name("POSES");
  command->add_option("--frames", flags->frames, "Only these: a list 1,14,27 or FIRST:LAST[:STEP]")
      ->type_name("LIST");
  command
      ->add_option("--overlay", flags->overlay,
                   "Folder for pictures with the wireframe drawn, or a video of them")
      ->type_name("DIR|FILE.mp4");
  command->add_option("--plots", flags->plots, "Page with pose, residuals and N_eff over the frames")
      ->type_name("FILE.html");
  command
      ->add_option("--crease", flags->crease_deg,
                   "Angle between faces above which their edge is tracked [20]")
      ->check(CLI::Range(0.0, 180.0))
      ->type_name("DEGREES");
  add_tuning(*command, flags->tracker);
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
