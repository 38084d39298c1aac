#pragma once

#include <memory>
#include <vector>

#include "capture/cameras/camera_device.h"

namespace stuv {

/// The cameras that libcamera sees today.
std::vector<CameraInfo> list_libcamera_cameras();

/// Opens and configures the camera whose id is "libcamera:" and libcamera's own name of it; see open_camera.
/// A control has libcamera's name (ExposureTime [us], AnalogueGain, ...) or is `exposure` or `gain`; what
/// libcamera makes of controls is known only with the frames, so settings() has no actual values. The camera
/// is released with the device.
std::unique_ptr<CameraDevice> open_libcamera_camera(const CameraSettings& settings);

}  // namespace stuv
