#pragma once

#include <Eigen/Dense>

#include "calib/two_view/estimate.h"
#include "calib/two_view/match.h"
#include "core/image.h"

namespace stuv {

/// Both pictures side by side with lines between matches: inliers green, the others red and faint.
Image draw_matches(const Image& a, const Image& b, const Matches& matches, const std::vector<bool>& inlier);

/// Both pictures with the epipolar lines of some twenty inliers, spread over the picture, one colour a match;
/// in picture B also the two-sigma envelope of each line (line_envelope).
Image draw_epipolar_lines(const Image& a, const Image& b, const Matches& matches,
                          const TwoViewEstimate& estimate);

/// One picture right of the other, as 8-bit colour; thin lines every 40 rows if `rulers`.
Image side_by_side(const Image& a, const Image& b, bool rulers = false);

/// Grey to colour (turbo), from `low` to `high`; NaN black.
Image draw_disparity(const ImageF& disparity);

}  // namespace stuv
