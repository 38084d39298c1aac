#pragma once

#include <utility>
#include <vector>

#include "core/light_field.h"

namespace stuv {

/// A rectified view in grey, 0..255, for finding things again. Float pictures are scaled by their brightest
/// percent. Where the mask is 0 nothing is there.
struct GreyView {
  Raster<std::uint8_t> grey;
  Mask mask;
};
GreyView grey_view(const Image& rectified);

/// The same point in two views of a light field [px].
struct ViewMatch {
  int a = 0, b = 0;
  int feature = 0;  ///< of view a: matches with the same one are of one point
  Eigen::Vector2d in_a, in_b;
};

/// Every view with the next `reach` ones to its right and below it, holes skipped.
std::vector<std::pair<int, int>> neighbours(const LightField& lf, int reach = 1);

/// Points of view a found again in view b.
///
/// Shi and Tomasi's corners of a are sought along the line on which depths from infinity to the nearest of
/// the scene lie, and up to 2 px beside it, by normalised cross-correlation (11 x 11); refused where a second
/// place is nearly as alike. Then least-squares matching over 21 x 21 pixels (Gruen 1985: affine map, gain
/// and offset) of pictures smoothed by a Gaussian of 1 px, refused if it does not converge near by, or if its
/// own sigma across the line exceeds 0.1 px.
std::vector<ViewMatch> match_views(const LightField& lf, int a, int b, const GreyView& grey_a,
                                   const GreyView& grey_b, int most_features = 500);

/// Where the epipolar line of a's pixel runs in b: its points at infinity and at the nearest depth.
std::pair<Eigen::Vector2d, Eigen::Vector2d> epipolar_segment(const LightField& lf, const View& a,
                                                             const View& b, const Eigen::Vector2d& in_a);

}  // namespace stuv
