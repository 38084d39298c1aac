#pragma once

#include "core/image.h"

namespace stuv {

struct DisparityOptions {
  int min_px = -64, max_px = 64;        ///< of D: the pixel (x, y) of A is at (x + D, y) of B
  int small_step = 8, large_step = 50;  ///< penalties of a step by 1 and by more, in census bits
};

struct Disparity {
  ImageF d_px;  ///< of A's pixels; dense, NaN only where A is masked
  ImageF
      confidence;  ///< 0 where the two directions disagree or B has nothing (d_px is then filled in), up to 1
};

/// Semi-global matching (Hirschmueller, PAMI 2008) over a Gaussian pyramid: the coarsest level looks at the
/// whole range, the others around what their parent and its neighbours found, so both sides of an edge stay
/// in reach (Rothermel and others 2012). Cost: Hamming distance of 9 x 7 census; eight paths; both directions
/// compared to one pixel; parabola for the sub-pixel; pixels that fail take the farther of their row's
/// neighbours. Pictures of one height.
Disparity find_disparity(const Image& a, const Image& b, const DisparityOptions& options);

/// Picture A made from B's pixels by the disparity, as a check of it; masked where the confidence is 0.
Image rebuild(const Image& b, const Disparity& disparity);

}  // namespace stuv
