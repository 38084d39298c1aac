#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "capture/cameras/camera_device.h"

namespace stuv {

/// All V4L2 capture devices, in the order of their numbers. Devices that cannot be opened are listed with
/// what sysfs has of them, and `problems` gets a line for each. Formats, sizes and rates are asked for if
/// `modes`.
std::vector<CameraInfo> list_v4l2_cameras(std::vector<std::string>& problems, bool modes,
                                          const std::filesystem::path& sysfs = "/sys");

/// Opens and configures the device; see open_camera. Frames stay where the driver put them (mmap) until
/// nobody holds them.
std::unique_ptr<CameraDevice> open_v4l2_camera(const CameraSettings& settings, const std::string& device);

}  // namespace stuv
