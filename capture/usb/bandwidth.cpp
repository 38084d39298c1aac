#include "capture/usb/bandwidth.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <map>
#include <optional>

#include "core/files.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

/// One USB device on the way from a camera to its controller.
struct Device {
  std::string name;
  double speed_mbit;
  fs::path folder;
};

/// The camera's own USB device first, the root hub last.
std::vector<Device> way_to_controller(fs::path folder) {
  std::vector<Device> devices;
  std::error_code ec;
  for (; folder.has_relative_path(); folder = folder.parent_path())
    if (fs::exists(folder / "speed", ec) && fs::exists(folder / "idVendor", ec))
      devices.push_back({folder.filename().string(), std::atof(read_text(folder / "speed").c_str()), folder});
  return devices;
}

/// Bytes a microframe of the isochronous endpoints that a device's alternate settings offer, rising.
/// Descriptors: length, type, ...; type 5 is an endpoint: address, attributes, wMaxPacketSize (bits 11, 12:
/// more packets).
std::vector<int> isochronous_sizes(const std::string& descriptors) {
  std::vector<int> sizes;
  const auto byte = [&](std::size_t i) {
    return static_cast<int>(static_cast<unsigned char>(descriptors[i]));
  };
  for (std::size_t at = 0; at + 2 <= descriptors.size() && byte(at) >= 2;
       at += static_cast<std::size_t>(byte(at))) {
    if (byte(at + 1) != 5 || byte(at) < 7 || at + 7 > descriptors.size()) continue;
    const bool in = (byte(at + 2) & 0x80) != 0, isochronous = (byte(at + 3) & 3) == 1;
    const int packet = byte(at + 4) | byte(at + 5) << 8;
    if (in && isochronous) sizes.push_back((packet & 0x7FF) * (1 + (packet >> 11 & 3)));
  }
  std::sort(sizes.begin(), sizes.end());
  return sizes;
}

double reserved(const CameraMode& mode, const std::vector<Device>& way) {
  const double needed = 1.02 * picture_rate(mode);  // packet headers
  std::error_code ec;
  if (way.empty() || way[0].speed_mbit > 480 || !fs::exists(way[0].folder / "descriptors", ec)) return needed;
  const double frames_per_second = way[0].speed_mbit < 480 ? 1000 : 8000;
  const std::vector<int> sizes = isochronous_sizes(read_text(way[0].folder / "descriptors"));
  for (const int size : sizes)
    if (size * frames_per_second >= needed) return size * frames_per_second;
  return sizes.empty() ? needed : std::max(needed, sizes.back() * frames_per_second);
}

/// The mode with one rate, if the camera has it.
std::optional<CameraMode> with(const CameraLoad& camera, const std::string& fourcc, int width, int height,
                               double fps) {
  for (const CameraMode& mode : camera.modes)
    if (mode.fourcc == fourcc && mode.width == width && mode.height == height)
      for (const double rate : mode.fps)
        if (std::abs(rate - fps) < 0.01) return CameraMode{fourcc, width, height, {rate}};
  return std::nullopt;
}

/// The link's load if all of its cameras ran like `mode`; none if one cannot.
std::optional<double> load_with(const std::vector<const CameraLoad*>& cameras, const CameraMode& mode) {
  double sum = 0;
  for (const CameraLoad* camera : cameras) {
    const auto own = with(*camera, mode.fourcc, mode.width, mode.height, mode.fps.front());
    if (!own) return std::nullopt;
    sum += reserved(*own, way_to_controller(camera->sysfs));
  }
  return sum;
}

}  // namespace

double usb_capacity(double speed_mbit) {
  const double bytes = speed_mbit * 1e6 / 8;
  if (speed_mbit < 480) return 0.9 * bytes;
  if (speed_mbit < 5000) return 0.8 * bytes;
  return 0.9 * bytes * (speed_mbit < 10'000 ? 8.0 / 10 : 128.0 / 132);
}

double picture_rate(const CameraMode& mode) {
  const double fps = mode.fps.empty() ? 0 : mode.fps.front();
  if (mode.fourcc == "MJPG") return 0.5 * mode.width * mode.height * fps;
  RawFormat format{mode.fourcc, mode.width, mode.height, least_stride(mode.fourcc, mode.width)};
  return static_cast<double>(raw_size(format)) * fps;
}

double reserved_rate(const CameraLoad& camera) {
  return reserved(camera.mode, way_to_controller(camera.sysfs));
}

std::vector<LinkLoad> link_loads(const std::vector<CameraLoad>& cameras) {
  std::map<fs::path, LinkLoad> links;  // a folder sorts before what lies in it
  for (const CameraLoad& camera : cameras) {
    const std::vector<Device> way = way_to_controller(camera.sysfs);
    for (const Device& device : way) {
      LinkLoad& link = links[device.folder];
      link.name = device.name;
      link.speed_mbit = device.speed_mbit;
      link.capacity = usb_capacity(device.speed_mbit);
      link.load += reserved(camera.mode, way);
      link.cameras.push_back(camera.name);
    }
  }
  std::vector<LinkLoad> list;
  for (auto& [folder, link] : links) list.push_back(std::move(link));
  return list;
}

std::vector<Proposal> proposals(const std::vector<CameraLoad>& cameras) {
  std::vector<Proposal> found;
  for (const LinkLoad& link : link_loads(cameras)) {
    if (link.fits()) continue;
    std::vector<const CameraLoad*> on_link;
    for (const CameraLoad& camera : cameras)
      if (std::find(link.cameras.begin(), link.cameras.end(), camera.name) != link.cameras.end())
        on_link.push_back(&camera);
    const CameraMode& now = on_link[0]->mode;
    const double fps_now = now.fps.empty() ? 0 : now.fps.front();
    // One proposal a kind: the one that keeps the most pixels a second.
    std::map<int, Proposal> best;
    for (const CameraMode& mode : on_link[0]->modes)
      for (const double fps : mode.fps) {
        const bool same_size = mode.width == now.width && mode.height == now.height,
                   same_rate = std::abs(fps - fps_now) < 0.01;
        int kind = -1;
        if (mode.fourcc == now.fourcc && same_size && fps < fps_now) kind = 0;
        if (mode.fourcc == now.fourcc && same_rate && mode.width < now.width) kind = 1;
        if (mode.fourcc == "MJPG" && now.fourcc != "MJPG" && same_size && same_rate) kind = 2;
        if (kind < 0) continue;
        const auto load = load_with(on_link, {mode.fourcc, mode.width, mode.height, {fps}});
        if (!load || *load > link.capacity) continue;
        const auto it = best.find(kind);
        const auto worth = [](double width, double height, double rate) { return width * height * rate; };
        if (it == best.end() ||
            worth(it->second.width, it->second.height, it->second.fps) < worth(mode.width, mode.height, fps))
          best[kind] = {link.name, mode.fourcc, mode.width, mode.height, fps, *load};
      }
    for (auto& [kind, proposal] : best) found.push_back(std::move(proposal));
  }
  return found;
}

}  // namespace stuv
