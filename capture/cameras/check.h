#pragma once

#include <string>
#include <vector>

#include "capture/cameras/camera_source.h"
#include "capture/usb/bandwidth.h"

namespace stuv {

struct CheckedCamera {
  std::string name;
  Json settings;          ///< as read back; null if it could not be opened
  bool delivers = false;  ///< at least one frame while all were streaming
  std::string trouble;    ///< in words, with the next step; "" if there is none
};

struct RigCheck {
  std::vector<CheckedCamera> cameras;
  std::vector<LinkLoad> links;
  std::vector<Proposal> proposals;
  bool good() const;  ///< every camera delivers and every link fits
};

/// Opens every camera of the config, starts them all, waits up to `patience_s` for a frame of each, and adds
/// up the bandwidth along the USB tree below `sysfs`. Cameras that fail do not keep the others from being
/// checked.
RigCheck check_rig(const CameraSourceOptions& options, const std::filesystem::path& sysfs = "/sys",
                   double patience_s = 3, const OpenFunction& open = open_camera);

}  // namespace stuv
