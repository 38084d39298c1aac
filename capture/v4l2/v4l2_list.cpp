#include <fmt/format.h>
#include <linux/videodev2.h>

#include <algorithm>
#include <cerrno>
#include <map>

#include "capture/cameras/explain.h"
#include "capture/v4l2/v4l2_camera.h"
#include "capture/v4l2/v4l2_file.h"
#include "core/files.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

/// The first line of a file in sysfs; "" where there is none.
std::string attribute(const fs::path& file) {
  std::error_code ec;
  if (!fs::exists(file, ec)) return {};
  const std::string text = read_text(file);
  return text.substr(0, text.find('\n'));
}

/// The USB device that an interface's folder lies in, found by its serial number's neighbours; empty: not
/// USB.
fs::path usb_device_of(fs::path folder) {
  std::error_code ec;
  for (; folder.has_relative_path(); folder = folder.parent_path())
    if (fs::exists(folder / "idVendor", ec)) return folder;
  return {};
}

std::string text_of(const unsigned char* bytes) { return reinterpret_cast<const char*>(bytes); }

std::vector<double> list_rates(const V4l2File& file, std::uint32_t fourcc, std::uint32_t width,
                               std::uint32_t height) {
  std::vector<double> rates;
  v4l2_frmivalenum interval{};
  interval.pixel_format = fourcc;
  interval.width = width;
  interval.height = height;
  const auto add = [&](const v4l2_fract& f) {
    if (f.numerator > 0) rates.push_back(static_cast<double>(f.denominator) / f.numerator);
  };
  for (; file.control(VIDIOC_ENUM_FRAMEINTERVALS, &interval) == 0; ++interval.index) {
    if (interval.type != V4L2_FRMIVAL_TYPE_DISCRETE) {
      add(interval.stepwise.min);
      add(interval.stepwise.max);
      break;
    }
    add(interval.discrete);
  }
  std::sort(rates.rbegin(), rates.rend());
  rates.erase(std::unique(rates.begin(), rates.end()), rates.end());
  return rates;
}

std::vector<CameraMode> list_modes(const V4l2File& file) {
  std::vector<CameraMode> modes;
  const auto add = [&](std::uint32_t fourcc, std::uint32_t width, std::uint32_t height) {
    modes.push_back({fourcc_text(fourcc), static_cast<int>(width), static_cast<int>(height),
                     list_rates(file, fourcc, width, height)});
  };
  v4l2_fmtdesc format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  for (; file.control(VIDIOC_ENUM_FMT, &format) == 0; ++format.index) {
    v4l2_frmsizeenum size{};
    size.pixel_format = format.pixelformat;
    for (; file.control(VIDIOC_ENUM_FRAMESIZES, &size) == 0; ++size.index) {
      if (size.type == V4L2_FRMSIZE_TYPE_DISCRETE) {
        add(format.pixelformat, size.discrete.width, size.discrete.height);
        continue;
      }
      add(format.pixelformat, size.stepwise.min_width, size.stepwise.min_height);
      add(format.pixelformat, size.stepwise.max_width, size.stepwise.max_height);
      break;
    }
  }
  return modes;
}

/// Links in /dev/v4l/by-path by the device that they lead to.
std::multimap<std::string, std::string> links_by_path() {
  std::multimap<std::string, std::string> links;
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator("/dev/v4l/by-path", ec))
    links.emplace(fs::canonical(entry.path(), ec).string(), entry.path().filename().string());
  return links;
}

/// Whether it is a camera: fills in what the driver says.
bool query(const std::string& device, bool modes, CameraInfo& info, std::vector<std::string>& problems) {
  const V4l2File file(device);
  if (file.fd() < 0) {
    problems.emplace_back(camera_error(info.model, device, "open it", errno).what());
    return true;
  }
  v4l2_capability capability{};
  if (const int error = file.control(VIDIOC_QUERYCAP, &capability); error != 0) {
    problems.emplace_back(camera_error(info.model, device, "ask what it is", error).what());
    return error == ENODEV;
  }
  const unsigned can = (capability.capabilities & V4L2_CAP_DEVICE_CAPS) != 0 ? capability.device_caps
                                                                             : capability.capabilities;
  if ((can & V4L2_CAP_VIDEO_CAPTURE) == 0 || (can & V4L2_CAP_STREAMING) == 0) return false;
  info.model = text_of(capability.card);
  info.driver = text_of(capability.driver);
  info.bus = text_of(capability.bus_info);
  if (modes) info.modes = list_modes(file);
  return true;
}

/// What tells a camera from all others and stays the same: its serial number, else where it is plugged in.
/// (The links of by-path come last: drivers whose devices share a parent share one link, and the last device
/// gets it.)
void choose_ids(std::vector<CameraInfo>& cameras) {
  const auto unique = [&](std::string CameraInfo::*member, const CameraInfo& camera) {
    return !(camera.*member).empty() &&
           std::count_if(cameras.begin(), cameras.end(),
                         [&](const CameraInfo& other) { return other.*member == camera.*member; }) == 1;
  };
  for (CameraInfo& camera : cameras) {
    if (unique(&CameraInfo::serial, camera))
      camera.id = "serial:" + camera.serial;
    else if (unique(&CameraInfo::bus, camera))
      camera.id = "bus:" + camera.bus;
    else if (unique(&CameraInfo::path, camera))
      camera.id = "path:" + camera.path;
    else
      camera.id = camera.device;
  }
}

}  // namespace

std::vector<CameraInfo> list_v4l2_cameras(std::vector<std::string>& problems, bool modes,
                                          const fs::path& sysfs) {
  std::vector<std::string> names;
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(sysfs / "class" / "video4linux", ec))
    if (const std::string name = entry.path().filename().string(); name.starts_with("video"))
      names.push_back(name);
  std::sort(names.begin(), names.end(), natural_less);
  const auto links = links_by_path();
  std::vector<CameraInfo> cameras;
  for (const std::string& name : names) {
    const fs::path folder = fs::canonical(sysfs / "class" / "video4linux" / name, ec);
    CameraInfo info;
    info.device = "/dev/" + name;
    info.model = attribute(folder / "name");
    info.sysfs = folder.string();
    // udev makes several links for one device; any will do, but always the same.
    const auto [first, last] = links.equal_range(info.device);
    for (auto it = first; it != last; ++it)
      if (info.path.empty() || it->second < info.path) info.path = it->second;
    if (const fs::path usb = usb_device_of(folder); !usb.empty()) {
      info.serial = attribute(usb / "serial");
      if (!info.serial.empty())
        info.serial =
            fmt::format("{}:{}:{}", attribute(usb / "idVendor"), attribute(usb / "idProduct"), info.serial);
    }
    if (query(info.device, modes, info, problems)) cameras.push_back(std::move(info));
  }
  choose_ids(cameras);
  return cameras;
}

}  // namespace stuv
