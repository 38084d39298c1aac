#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "capture/cameras/camera_device.h"

namespace stuv {

/// A camera with what it is asked for, and where sysfs has it.
struct CameraLoad {
  std::string name;
  std::filesystem::path sysfs;    ///< folder of its device, as CameraInfo::sysfs
  CameraMode mode;                ///< fps: the one rate it is to run at
  std::vector<CameraMode> modes;  ///< what else it could do
};

/// A cable of the USB tree: from a hub or camera up to its hub, or a controller's root hub, and what goes
/// over it.
struct LinkLoad {
  std::string name;  ///< of the device at its lower end: "1-2.3"; of a root hub: "usb1"
  double speed_mbit = 0;
  double capacity = 0, load = 0;  ///< bytes a second
  std::vector<std::string> cameras;
  bool fits() const { return load <= capacity; }
};

/// Settings, the same for all cameras of a link that is too full, with which it would not be.
struct Proposal {
  std::string link, fourcc;
  int width = 0, height = 0;
  double fps = 0, load = 0;  ///< load: of the whole link
};

/// What a link of that speed has for isochronous transfers: 90 % of 12 Mbit/s, 80 % of 480 Mbit/s
/// (USB 2.0, 5.6.4), 90 % of what 8b/10b leaves of 5 Gbit/s and 128b/132b of more (USB 3.2, 8.12.5). Bytes a
/// second.
double usb_capacity(double speed_mbit);

/// Bytes a second of the pictures alone. A JPEG is counted as two bits a pixel more than it usually has:
/// four.
double picture_rate(const CameraMode& mode);

/// What a camera reserves: of the alternate settings in its descriptors the smallest that carries the
/// pictures (uvcvideo does so), or the pictures and 2 % where there are no descriptors.
double reserved_rate(const CameraLoad& camera);

/// All links that cameras hang on, root hubs first. Cameras that are not on USB have none.
std::vector<LinkLoad> link_loads(const std::vector<CameraLoad>& cameras);

/// For every link that does not fit: the best lower rate at the same format and size, the best smaller size
/// at the same rate, and JPEG at the same size and rate, as far as all its cameras have them and they fit.
std::vector<Proposal> proposals(const std::vector<CameraLoad>& cameras);

}  // namespace stuv
