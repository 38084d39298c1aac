#include "capture/cameras/camera_list.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "capture/libcamera/libcamera_camera.h"
#include "capture/v4l2/v4l2_camera.h"
#include "core/error.h"

namespace stuv {
namespace {

/// The mode to begin with: one that can be decoded, closest to 640x360, uncompressed rather than not.
const CameraMode* first_choice(const CameraInfo& camera) {
  const CameraMode* best = nullptr;
  double best_cost = 0;
  for (const CameraMode& mode : camera.modes) {
    const bool jpeg = mode.fourcc == "MJPG";
    if (!jpeg && !is_raw_fourcc(mode.fourcc)) continue;
    const double cost = std::abs(std::log(static_cast<double>(mode.width) * mode.height / (640.0 * 360.0))) +
                        (jpeg ? 0.1 : 0);
    if (best != nullptr && cost >= best_cost) continue;
    best = &mode;
    best_cost = cost;
  }
  return best;
}

std::string quoted(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') quoted += '\\';
    quoted += c;
  }
  return quoted + '"';
}

}  // namespace

std::vector<CameraInfo> list_cameras(std::vector<std::string>& problems) {
  std::vector<CameraInfo> cameras = list_v4l2_cameras(problems, true);
  for (CameraInfo& camera : list_libcamera_cameras()) cameras.push_back(std::move(camera));
  return cameras;
}

std::unique_ptr<CameraDevice> open_camera(const CameraSettings& settings) {
  if (settings.id.starts_with("/dev/")) return open_v4l2_camera(settings, settings.id);
  if (settings.id.starts_with("libcamera:")) return open_libcamera_camera(settings);
  std::vector<std::string> problems;
  const std::vector<CameraInfo> cameras = list_v4l2_cameras(problems, false);
  for (const CameraInfo& camera : cameras)
    if (settings.id == camera.id || settings.id == "serial:" + camera.serial ||
        settings.id == "path:" + camera.path || settings.id == "bus:" + camera.bus)
      return open_v4l2_camera(settings, camera.device);
  throw Error(fmt::format("camera {} ({})", settings.name, settings.id), "is not there",
              "check its plug and its hub's power; `stuv cameras` lists what is there");
}

std::string starting_config(const std::vector<CameraInfo>& cameras) {
  const int count = std::max(1, static_cast<int>(cameras.size()));
  const int cols = static_cast<int>(std::ceil(std::sqrt(count))), rows = (count + cols - 1) / cols;
  std::string text = fmt::format(
      "# Cameras found by `stuv cameras`. Fill in where each stands: row and col count from 0, seen from "
      "behind the cameras.\n\n"
      "[source]\nkind = \"cameras\"\nrows = {}\ncols = {}\n"
      "mode = \"free\"      # or \"common-start\", or \"trigger\" with the cameras' controls set to wait for "
      "it\n"
      "record = \"raw\"     # as the cameras deliver; or \"png\", \"tif\"\n",
      rows, cols);
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const int row = static_cast<int>(i) / cols, col = static_cast<int>(i) % cols;
    text += fmt::format("\n[[camera]]  # {}, today {}\nid = {}\nname = \"r{}c{}\"\nrow = {}\ncol = {}\n",
                        cameras[i].model, cameras[i].device, quoted(cameras[i].id), row, col, row, col);
    if (const CameraMode* mode = first_choice(cameras[i])) {
      text += fmt::format("format = {}\nwidth = {}\nheight = {}\n", quoted(mode->fourcc), mode->width,
                          mode->height);
      if (!mode->fps.empty()) text += fmt::format("fps = {}\n", std::round(mode->fps.front() * 1000) / 1000);
    }
    text +=
        "# controls = { exposure = 100, gain = 16, white_balance = 4500, focus = 0, power_line_frequency = 1 "
        "}\n";
  }
  return text;
}

}  // namespace stuv
