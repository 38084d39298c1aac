#include <fmt/format.h>

#include "app/commands.h"
#include "app/console.h"
#include "app/search_range.h"
#include "app/viewer/viewer_window.h"
#include "core/files.h"
#include "render/plan/sampling.h"

namespace stuv {
namespace {

/// Focal planes and M that the window's controls go up to.
constexpr int kMostChosen = 1000;

struct Flags {
  std::filesystem::path scene, screenshot;
  std::string disparity, depth_m, method = "fast", backend = "cpu", overlay = "none";
  int planes = 0, window = 3, frames = 0;
  bool force = false;
};

int run(const Flags& flags) {
  if (!exists(method_from_name(flags.method), backend_from_name(flags.backend)))
    throw UsageError("--method fast runs on the CPU; use --method exact with --backend gl");
  check_name("--screenshot", flags.screenshot, {".png", ".tif", ".tiff", ".jpg", ".jpeg"});
  const LightFieldReader reader(open_light_field(flags.scene));
  const LightField& lf = reader.light_field();
  if (!flags.screenshot.empty()) check_output(flags.screenshot, flags.force);
  const SearchRange range = search_range(reader, {flags.disparity, flags.depth_m, {}});
  const Viewpoint middle = middle_viewpoint(lf);
  ViewerState state;
  state.s = middle.s;
  state.t = middle.t;
  state.method = method_from_name(flags.method);
  state.backend = backend_from_name(flags.backend);
  state.options.d_min = range.d_min;
  state.options.d_max = range.d_max;
  state.options.window = flags.window;
  state.options.planes = flags.planes > 0 ? flags.planes : planes_needed(lf, range.d_min, range.d_max);
  state.overlay = flags.overlay == "depth"        ? Overlay::depth
                  : flags.overlay == "confidence" ? Overlay::confidence
                                                  : Overlay::none;
  state.focus_px = (range.d_min + range.d_max) / 2;
  run_viewer(reader, state,
             {flags.screenshot.empty() ? flags.frames : std::max(flags.frames, 1), flags.screenshot});
  return kDone;
}

}  // namespace

void add_view_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand("view",
                                         "Opens a window in which the mouse moves the viewpoint.\n\n"
                                         "  stuv view knights_scene\n");
  command->add_option("scene", flags->scene, "The scene's folder")->required()->type_name("SCENE");
  command->add_option("--method", flags->method, "To start with: literal, exact, fast [fast]")
      ->check(CLI::IsMember({"literal", "exact", "fast"}));
  command->add_option("--backend", flags->backend, "To start with: cpu, gl [cpu]")
      ->check(CLI::IsMember({"cpu", "gl"}));
  command->add_option("--overlay", flags->overlay, "To start with: none, depth, confidence [none]")
      ->check(CLI::IsMember({"none", "depth", "confidence"}));
  command->add_option("--planes", flags->planes, "Focal planes to start with [as many as the range needs]")
      ->check(CLI::Range(1, kMostChosen));
  command->add_option("--window", flags->window, "M to start with [3]")->check(CLI::Range(0, kMostChosen));
  command->add_option("--disparity", flags->disparity, "Range of the planes, px per unit of s")
      ->type_name("MIN,MAX");
  command->add_option("--depth-m", flags->depth_m, "The same in metres")->type_name("NEAR,FAR");
  command->add_option("--frames", flags->frames, "Close after that many frames, once the picture is complete")
      ->check(CLI::Range(1, kMostCount));
  command
      ->add_option("--screenshot", flags->screenshot,
                   "Save the window once the picture is complete, and close")
      ->type_name("FILE");
  command->add_flag("--force", flags->force, "Overwrite the screenshot");
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
