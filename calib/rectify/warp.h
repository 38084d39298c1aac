#pragma once

#include "calib/photometry/photometry.h"
#include "calib/rectify/lens_map.h"
#include "core/image.h"

namespace stuv {

/// Resamples a camera's picture into the common view by one Lanczos interpolation.
///
///   out(x, y) = sum_ij L(q.x - i) L(q.y - j) in(i, j) / sum_ij L L,   q = map(x, y)
///
/// L(d) = sinc(d) sinc(d / 3), |d| < 3 [px]. Taps beyond the border repeat it. A pixel is missing (mask 0,
/// value 0) where the map leads nowhere, or where one of the four pixels around q is masked, NaN or Inf;
/// further away such pixels are left out of both sums. With `photometry`, `in` are values corrected to the
/// rig's mean camera (corrected, in photometry.h). Returns an image of the common view's size and the input's
/// type.
///
/// Works on tiles whose part of the picture, as float, fits the caches: memory sees each byte about once.
Image warp_to_common_view(const Image& image, const LensMap& map, const CommonView& view,
                          const CameraPhotometry* photometry = nullptr);
Image warp_to_common_view(const Image& image, const Camera& camera, const CommonView& view);

}  // namespace stuv
