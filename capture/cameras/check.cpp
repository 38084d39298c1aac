#include "capture/cameras/check.h"

#include <poll.h>

#include <algorithm>
#include <chrono>

#include "capture/v4l2/v4l2_camera.h"
#include "core/error.h"

namespace stuv {
namespace {

using Devices = std::vector<std::unique_ptr<CameraDevice>>;

template <class F>
void attempt(CheckedCamera& camera, std::unique_ptr<CameraDevice>& device, const F& f) {
  try {
    f();
  } catch (const Error& error) {
    camera.trouble = error.what();
    device.reset();
  }
}

void wait_for_frames(Devices& devices, std::vector<CheckedCamera>& cameras, double patience_s) {
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(patience_s);
  const auto is_waiting = [&](std::size_t i) { return devices[i] && !cameras[i].delivers; };
  while (std::chrono::steady_clock::now() < end) {
    std::vector<pollfd> polled;
    for (std::size_t i = 0; i < devices.size(); ++i)
      if (is_waiting(i)) polled.push_back({devices[i]->poll_fd(), POLLIN, 0});
    if (polled.empty()) return;
    ::poll(polled.data(), polled.size(), 100);
    for (std::size_t i = 0; i < devices.size(); ++i)
      if (is_waiting(i))
        attempt(cameras[i], devices[i], [&] { cameras[i].delivers = devices[i]->take().has_value(); });
  }
}

/// The camera as the USB tree knows it; libcamera's are not on USB.
CameraLoad load_of(const CameraSettings& settings, const CheckedCamera& checked,
                   const std::vector<CameraInfo>& known) {
  CameraLoad load{settings.name, {}, {settings.format, settings.width, settings.height, {settings.fps}}, {}};
  if (!checked.settings.is_null() && checked.settings.contains("fps") && checked.settings["fps"].is_number())
    load.mode = {checked.settings["format"],
                 checked.settings["width"],
                 checked.settings["height"],
                 {checked.settings["fps"]}};
  for (const CameraInfo& info : known)
    if (settings.id == info.id || settings.id == info.device || settings.id == "serial:" + info.serial ||
        settings.id == "path:" + info.path || settings.id == "bus:" + info.bus) {
      load.sysfs = info.sysfs;
      load.modes = info.modes;
    }
  return load;
}

}  // namespace

bool RigCheck::good() const {
  return std::all_of(cameras.begin(), cameras.end(),
                     [](const CheckedCamera& camera) { return camera.delivers; }) &&
         std::all_of(links.begin(), links.end(), [](const LinkLoad& link) { return link.fits(); });
}

RigCheck check_rig(const CameraSourceOptions& options, const std::filesystem::path& sysfs, double patience_s,
                   const OpenFunction& open) {
  // Before anything streams: a device that does may not list its modes.
  std::vector<std::string>
      problems;  // what cannot be listed cannot be opened below either, and is told there
  const std::vector<CameraInfo> known = list_v4l2_cameras(problems, true, sysfs);
  RigCheck check;
  Devices devices;
  for (const CameraSettings& settings : options.cameras) {
    CheckedCamera& camera = check.cameras.emplace_back();
    auto& device = devices.emplace_back();
    camera.name = settings.name;
    attempt(camera, device, [&] {
      device = open(settings);
      camera.settings = device->settings();
    });
  }
  for (std::size_t i = 0; i < devices.size(); ++i)
    if (devices[i]) attempt(check.cameras[i], devices[i], [&] { devices[i]->start(); });
  wait_for_frames(devices, check.cameras, patience_s);
  std::vector<CameraLoad> loads;
  for (std::size_t i = 0; i < options.cameras.size(); ++i) {
    CheckedCamera& camera = check.cameras[i];
    if (!camera.delivers && camera.trouble.empty())
      camera.trouble = Error("camera " + camera.name, "starts but delivers no frame",
                             options.mode == CameraSourceOptions::Mode::trigger
                                 ? "check that the trigger fires"
                                 : "check its trigger controls and its cable")
                           .what();
    loads.push_back(load_of(options.cameras[i], camera, known));
  }
  check.links = link_loads(loads);
  check.proposals = proposals(loads);
  return check;
}

}  // namespace stuv
