#pragma once

#include "calib/photometry/estimate_photometry.h"

namespace stuv {

/// Mean of what a picture stores around a place, weighed by a Gaussian of 3 px out to 7. Nothing if pixels
/// there are missing, outside or at either end of the range.
std::optional<std::array<double, 3>> stored_around(const Image& image, double white,
                                                   const Eigen::Vector2d& pixel);

}  // namespace stuv
