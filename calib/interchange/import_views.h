#pragma once

#include <filesystem>
#include <limits>

#include "calib/interchange/view_list.h"
#include "core/progress.h"

namespace stuv {

struct ImportOptions {
  ViewLayout layout = ViewLayout::csv;
  /// Focal length [px]; 0: not known, the scene then has no metres.
  double focal_px = 0;
  /// Depth Z0 [m] at which the views converge; infinity: they were not shifted.
  double converge_m = std::numeric_limits<double>::infinity();
  /// Range of d = f/Z - f/Z0 [px per unit of s]; NaN: not known.
  double d_min = std::numeric_limits<double>::quiet_NaN(), d_max = std::numeric_limits<double>::quiet_NaN();
};

/// Makes a light field database in the (existing, empty) folder out of somebody else's rectified views, (s,
/// t) as they are. All views need one size and number of channels. Throws Error naming the view that does not
/// fit.
LightField import_views(const std::filesystem::path& source, const std::filesystem::path& folder,
                        const ImportOptions& options, const Reporter& reporter);

}  // namespace stuv
