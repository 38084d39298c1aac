#pragma once

#include "core/rig.h"

namespace stuv {

/// The pinhole that all rectified views share: axes of the rig's frame, so it looks straight off the camera
/// plane.
///   x_px = cx_px + focal_px X / Z
struct CommonView {
  double focal_px = 0, cx_px = 0, cy_px = 0;
  int width = 0, height = 0;
};

/// Focal length: the median of the cameras'; size: the first determined camera's; principal point: such that
/// the mean of the cameras' fields of view lies in the middle (cameras that all look a little aside lose
/// nothing by it). Throws std::invalid_argument if no camera is determined or one looks away from the plane's
/// normal by 60 degrees or more.
CommonView common_view(const Rig& rig);

}  // namespace stuv
