#pragma once

#include <string>
#include <vector>

#include "capture/cameras/camera_device.h"
#include "capture/cameras/camera_source.h"

namespace stuv {

/// All cameras that V4L2 and libcamera have; `problems` gets a line for each that cannot be asked.
std::vector<CameraInfo> list_cameras(std::vector<std::string>& problems);

/// A CONFIG.toml with these cameras on a grid that is to be filled in: as square as can be, cameras row by
/// row.
std::string starting_config(const std::vector<CameraInfo>& cameras);

}  // namespace stuv
