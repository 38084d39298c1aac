#pragma once

#include <filesystem>

#include "core/light_field.h"
#include "core/progress.h"
#include "core/recording.h"
#include "core/rig.h"

namespace stuv {

struct RectifyOptions {
  /// Depths between which the scene lies [m]; far may be infinite. 0: from a little nearer than the nearest
  /// board that the calibration saw to infinity.
  double near_m = 0, far_m = 0;
};

/// Makes a light field database in the (existing, empty) folder out of one frame set: every determined camera
/// that has a picture is warped once onto the common view; (s, t, w) are the measured centres. Cameras
/// without a picture are holes. Throws Error naming the camera or picture that does not fit the rig.
LightField rectify(const Recording& recording, const FrameSet& set, const Rig& rig,
                   const std::filesystem::path& folder, const RectifyOptions& options,
                   const Reporter& reporter);

}  // namespace stuv
