#include <fmt/format.h>

#include "app/commands.h"
#include "app/console.h"
#include "calib/rectify/rectify.h"
#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path recording, rig, output;
  std::string set, depth_m;
  bool complete = false;
};

RectifyOptions options_of(const Flags& flags) {
  RectifyOptions options;
  if (flags.depth_m.empty()) return options;
  std::tie(options.near_m, options.far_m) = parse_pair("--depth-m", flags.depth_m);
  if (!(options.near_m > 0 && options.near_m < options.far_m))
    throw UsageError("--depth-m wants NEAR,FAR with 0 < NEAR < FAR");
  return options;
}

/// The named set, or the last complete one: scenes are usually recorded after the boards.
const FrameSet& choose_set(const Recording& recording, const std::string& name) {
  if (!name.empty()) {
    const int index = recording.set_index(name);
    if (index < 0)
      throw Error(recording.folder.string(), fmt::format("has no set {}", name), "see its folder sets/");
    return recording.sets[index];
  }
  if (recording.sets.empty()) throw Error(recording.folder.string(), "has no set", "record one");
  for (auto set = recording.sets.rbegin(); set != recording.sets.rend(); ++set)
    if (set->complete()) return *set;
  return recording.sets.back();
}

int run(const Flags& flags) {
  const RectifyOptions options = options_of(flags);
  const Recording recording = open_recording(flags.recording);
  const Rig rig = read_rig(flags.rig);
  const FrameSet& set = choose_set(recording, flags.set);
  if (flags.complete) require_complete(recording, set);
  AtomicOutput output(flags.output, AtomicOutput::Kind::folder, flags.force);
  const LightField lf = rectify(recording, set, rig, output.path(), options, console_reporter());
  output.commit();
  write_result(flags, {{"scene", flags.output.string()},
                       {"set", set.name},
                       {"rows", lf.rows},
                       {"cols", lf.cols},
                       {"views", lf.views.size()},
                       {"focal_px", lf.focal_px},
                       {"disparity_px", {lf.d_min, lf.d_max}}});
  fmt::print("{}: set {}, {} views on a {}x{} lattice, {}x{} px, f = {:.1f} px\n", flags.output.string(),
             set.name, lf.views.size(), lf.rows, lf.cols, lf.width, lf.height, lf.focal_px);
  return kDone;
}

}  // namespace

void add_rectify_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      app.add_subcommand("rectify",
                         "Warps the cameras' pictures onto the camera plane's common view: a light field.\n\n"
                         "  stuv rectify rec --rig rig -o scene --set scene00\n");
  command->add_option("recording", flags->recording, "The recording's folder")->required()->type_name("REC");
  command->add_option("--rig", flags->rig, "The rig's folder, from `stuv calibrate`")
      ->required()
      ->type_name("RIG");
  command->add_option("-o,--output", flags->output, "The scene's folder")->required()->type_name("SCENE");
  command->add_option("--set", flags->set, "Frame set to rectify [the last complete one]");
  command
      ->add_option("--depth-m", flags->depth_m,
                   "Depths between which the scene lies [from the nearest board to inf]")
      ->type_name("NEAR,FAR");
  command->add_flag("--complete", flags->complete, "Refuse a set that lacks cameras");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
