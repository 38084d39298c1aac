#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cstdio>

#include "app/commands.h"
#include "app/console.h"
#include "calib/rectify/rectify.h"
#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path recording, rig, output;
  std::string set, depth_m, crop, size;
  CommonViewOptions::Field field = CommonViewOptions::Field::mean;
  double focal_px = 0;
  bool complete = false, no_photometry = false;
};

/// "X,Y,WxH"
CommonViewOptions::Crop parse_crop(const std::string& text) {
  CommonViewOptions::Crop crop;
  int end = 0;
  if (std::sscanf(text.c_str(), "%d,%d,%dx%d%n", &crop.x, &crop.y, &crop.width, &crop.height, &end) != 4 ||
      end != static_cast<int>(text.size()) || crop.x < 0 || crop.y < 0 || crop.width < 1 || crop.height < 1)
    throw UsageError(fmt::format("--crop wants X,Y,WxH in pixels of the common view, not '{}'", text));
  return crop;
}

CommonViewOptions view_options_of(const Flags& flags) {
  CommonViewOptions view;
  view.field = flags.field;
  view.focal_px = flags.focal_px;
  if (!flags.size.empty()) std::tie(view.width, view.height) = parse_size("--size", flags.size);
  if (std::max(view.width, view.height) > kMostViewSize)
    throw UsageError(fmt::format("--size is {}, but at most {} px a side", flags.size, kMostViewSize));
  if (!flags.crop.empty()) view.crop = parse_crop(flags.crop);
  return view;
}

RectifyOptions options_of(const Flags& flags) {
  RectifyOptions options;
  options.view = view_options_of(flags);
  options.equalise = !flags.no_photometry;
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

void print_alignment(const Alignment& a) {
  if (a.points == 0) {
    fmt::print("vertical disparity: not determined, neighbouring views have too few points in common\n");
    return;
  }
  fmt::print(
      "vertical disparity of neighbours ({}, {} pairs, {} points): {:.3f} px rms, 95 % below {:.3f}; beyond "
      "the parallax of the cameras' places {:.3f} px rms, 95 % below {:.3f}\n",
      a.measured_from, a.pairs.size(), a.points, a.rms_px, a.p95_px, a.beyond_rms_px, a.beyond_p95_px);
}

void print_photometry(const Rectified& r) {
  if (!r.photometry) return;
  const Photometry& p = *r.photometry;
  fmt::print("brightness made equal (from {}): cameras differ by {:.2f} % before, {:.2f} % after\n", p.source,
             100 * p.spread_before, 100 * p.spread_after);
  for (const RectifiedView& v : r.views)
    for (const CameraPhotometry& c : p.cameras)
      if (c.camera == v.name && !c.determined)
        fmt::print("  camera {} left as it is: {}\n", c.camera, fmt::join(c.reasons, "; "));
}

int run(const Flags& flags) {
  RectifyOptions options = options_of(flags);
  const Recording recording = open_recording(flags.recording);
  const Rig rig = read_rig(flags.rig);
  if (options.equalise) options.rig_photometry = read_photometry(flags.rig);
  const FrameSet& set = choose_set(recording, flags.set);
  if (flags.complete) require_complete(recording, set);
  AtomicOutput output(flags.output, AtomicOutput::Kind::folder, flags.force);
  const Rectified r = rectify(recording, set, rig, output.path(), options, console_reporter());
  output.commit();
  const LightField& lf = r.light_field;
  Json result = {{"scene", flags.output.string()},
                 {"set", set.name},
                 {"rows", lf.rows},
                 {"cols", lf.cols},
                 {"width", lf.width},
                 {"height", lf.height},
                 {"focal_px", lf.focal_px},
                 {"disparity_px", {lf.d_min, lf.d_max}}};
  Json report = report_of(r);
  result["views"] = lf.views.size();
  result["photometry"] = report["photometry"];
  result["vertical_disparity"] = report["vertical_disparity"];
  result["cameras"] = report["views"];
  write_result(flags, result);
  fmt::print("{}: set {}, {} views on a {}x{} lattice, {}x{} px, f = {:.1f} px\n", flags.output.string(),
             set.name, lf.views.size(), lf.rows, lf.cols, lf.width, lf.height, lf.focal_px);
  print_photometry(r);
  print_alignment(r.alignment);
  return kDone;
}

}  // namespace

void add_rectify_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      app.add_subcommand("rectify",
                         "Warps the cameras' pictures onto the camera plane's common view: a light field.\n\n"
                         "  stuv rectify rec --rig rig -o scene --set scene00\n"
                         "  stuv rectify rec --rig rig -o scene --field common --crop 100,50,400x300\n");
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
  const std::map<std::string, CommonViewOptions::Field> fields = {
      {"mean", CommonViewOptions::Field::mean},
      {"common", CommonViewOptions::Field::common},
      {"all", CommonViewOptions::Field::all}};
  command
      ->add_option(
          "--field", flags->field,
          "Field of view: mean, one camera's size in the middle of all; common, the largest that every "
          "camera sees; all, whatever one sees [mean]")
      ->transform(CLI::CheckedTransformer(fields))
      ->type_name("FIELD");
  command->add_option("--focal-px", flags->focal_px, "Focal length of the views [the cameras' median]")
      ->check(CLI::PositiveNumber)
      ->type_name("F");
  command->add_option("--size", flags->size, "Size of the views, about the middle of the field [all of it]")
      ->type_name("WxH");
  command->add_option("--crop", flags->crop, "Only this part of the views [px]")->type_name("X,Y,WxH");
  command->add_flag("--no-photometry", flags->no_photometry,
                    "Keep brightness and colour as the cameras stored them");
  command->add_flag("--complete", flags->complete, "Refuse a set that lacks cameras");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
