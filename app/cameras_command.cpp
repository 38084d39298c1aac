#include <fmt/format.h>

#include "app/commands.h"
#include "app/console.h"
#include "capture/cameras/camera_list.h"
#include "core/files.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path output;
};

Json to_json(const CameraInfo& camera) {
  Json modes = Json::array();
  for (const CameraMode& mode : camera.modes)
    modes.push_back(
        {{"format", mode.fourcc}, {"width", mode.width}, {"height", mode.height}, {"fps", mode.fps}});
  return {{"id", camera.id},   {"device", camera.device}, {"model", camera.model}, {"driver", camera.driver},
          {"bus", camera.bus}, {"serial", camera.serial}, {"path", camera.path},   {"modes", modes}};
}

std::string rates_text(const std::vector<double>& rates) {
  std::string text;
  for (const double fps : rates) text += fmt::format("{}{:.5g}", text.empty() ? "" : ", ", fps);
  return text.empty() ? "" : " at " + text + " fps";
}

void print(const CameraInfo& camera) {
  fmt::print("{}\n  {}, {} ({}), {}\n", camera.id, camera.device, camera.model, camera.driver, camera.bus);
  for (const CameraMode& mode : camera.modes)
    if (mode.fourcc == "MJPG" || is_raw_fourcc(mode.fourcc))
      fmt::print("  {} {}x{}{}\n", mode.fourcc, mode.width, mode.height, rates_text(mode.fps));
}

int run(const Flags& flags) {
  if (!flags.output.empty()) check_output(flags.output, flags.force);
  std::vector<std::string> problems;
  const std::vector<CameraInfo> cameras = list_cameras(problems);
  for (const CameraInfo& camera : cameras) print(camera);
  const Reporter reporter = console_reporter();
  for (const std::string& problem : problems) reporter.warn(problem);
  Json list = Json::array();
  for (const CameraInfo& camera : cameras) list.push_back(to_json(camera));
  write_result(flags, {{"cameras", list}, {"problems", problems}});
  fmt::print("{} cameras\n", cameras.size());
  if (!flags.output.empty()) write_text(flags.output, starting_config(cameras));
  return kDone;
}

}  // namespace

void add_cameras_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      app.add_subcommand("cameras",
                         "Lists cameras with what tells them apart, formats, sizes and rates.\n\n"
                         "  stuv cameras -o rig.toml     and a config to fill in the grid in\n");
  command->add_option("-o,--output", flags->output, "Write a starting config")->type_name("CONFIG.toml");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
