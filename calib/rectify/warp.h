#pragma once

#include "calib/rectify/common_view.h"
#include "core/image.h"

namespace stuv {

/// Resamples a camera's picture into the common view by one Lanczos interpolation.
///
///   out(x, y) = sum_ij L(q.x - i) L(q.y - j) in(i, j) / sum_ij L L,   q = project(R [(x - cx)/f, (y - cy)/f,
///   1])
///
/// L(d) = sinc(d) sinc(d / 3), |d| < 3 [px]; R: cam_from_rig's rotation (a camera's centre stays, so depth
/// does not matter). Taps beyond the border repeat it. A pixel is missing (mask 0, value 0) where q lies
/// outside the picture or beyond the angle of view of its corners, where lens models fold back, or where one
/// of the four pixels around q is masked, NaN or Inf; further away such pixels are left out of both sums.
/// Returns an image of the common view's size and the input's type.
Image warp_to_common_view(const Image& image, const Camera& camera, const CommonView& view);

}  // namespace stuv
