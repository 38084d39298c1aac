#pragma once

#include <optional>

#include "core/camera.h"

namespace stuv {

/// The camera that takes the same pictures turned by half a turn: pixel (x, y) becomes (width - 1 - x,
/// height - 1 - y). Principal point and tangential (and thin prism) terms change sign, the pose is turned
/// about the optical axis. Pinhole and OpenCV's models; nothing for the others.
std::optional<Camera> half_turned(const Camera& camera);

}  // namespace stuv
