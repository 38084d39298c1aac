#pragma once

#include <filesystem>

#include "calib/photometry/photometry.h"
#include "calib/rectify/alignment.h"
#include "calib/rectify/common_view.h"
#include "core/light_field.h"
#include "core/progress.h"
#include "core/recording.h"
#include "core/rig.h"

namespace stuv {

struct RectifyOptions {
  /// Depths between which the scene lies [m]; far may be infinite. 0: from a little nearer than the nearest
  /// board that the calibration saw to infinity.
  double near_m = 0, far_m = 0;
  CommonViewOptions view;
  /// Brightness and colour: made equal by the rig's photometry, or, if it has none, by what neighbouring
  /// views of the set itself have in common.
  bool equalise = true;
  std::optional<Photometry> rig_photometry;
  bool measure_alignment = true;
};

struct RectifiedView {
  std::string name;
  double missing_fraction = 0;  ///< of the rectified view's pixels
  double full_fraction = 0;     ///< of the camera's pixels: at the upper end of its range, and left there
};

struct Rectified {
  LightField light_field;
  std::vector<RectifiedView> views;
  std::optional<Photometry> photometry;  ///< that was applied to the cameras it determines
  Alignment alignment;
};

/// Makes a light field database in the (existing, empty) folder out of one frame set: every determined camera
/// that has a picture is warped once onto the common view; (s, t, w) are the measured centres. Cameras
/// without a picture, or that see nothing of the view, are holes. report.json says what is known of the
/// views, photometry.json how they were made equal if that was found from the set itself. Throws Error naming
/// the camera or picture that does not fit the rig.
Rectified rectify(const Recording& recording, const FrameSet& set, const Rig& rig,
                  const std::filesystem::path& folder, const RectifyOptions& options,
                  const Reporter& reporter);

/// What report.json holds.
Json report_of(const Rectified& rectified);

}  // namespace stuv
