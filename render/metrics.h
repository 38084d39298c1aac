#pragma once

#include "core/raster.h"

namespace stuv {

/// PSNR [dB] of two pictures of one size, both rounded to 8 bit first, over all channels, `border` pixels
/// left out at every side: 10 log10(255^2 / mse). Infinity if they are equal, NaN if nothing is left within
/// the border.
double psnr_db(const ImageF& a, const ImageF& b, int border);

/// Mean structural similarity of the 8-bit luma (Rec. 601): Gaussian window of 11x11, sigma 1.5; windows that
/// lie wholly within the border. C1 = (0.01 * 255)^2, C2 = (0.03 * 255)^2. Wang et al., 2004. NaN if no
/// window fits.
double ssim(const ImageF& a, const ImageF& b, int border);

}  // namespace stuv
