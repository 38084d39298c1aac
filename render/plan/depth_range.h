#pragma once

#include <memory>

#include "render/view_set.h"

namespace stuv {

struct DepthRange {
  bool found = false;
  double d_min = 0, d_max = 0;  ///< disparity [px per unit of s], valid if found
  double sure_fraction = 0;     ///< pixels, of those looked at, whose plane stood out
};

/// In which disparities the scene lies, from the pictures alone: a plane sweep over all that two neighbours
/// can show (a quarter of the picture's width to both sides; not beyond infinity if the scene has metres) on
/// small pictures from the middle of the lattice, then one on full size over what was found. The range holds
/// all but half a percent at each end of the pixels whose plane stands out, and a px of disparity between
/// neighbours more. Not found where too few do: no texture, one camera.
DepthRange estimate_depth_range(const std::shared_ptr<const ViewSet>& views);

}  // namespace stuv
