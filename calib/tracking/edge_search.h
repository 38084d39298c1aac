#pragma once

#include <Eigen/Dense>
#include <array>
#include <cstdint>

#include "core/raster.h"

namespace stuv::tracking {

using Grey = Raster<std::uint8_t>;

/// Gradient of a picture smoothed by a Gaussian, two channels (x, y) [grey levels per px].
struct GradientPicture {
  ImageF gradient;
  Raster<std::uint8_t> strong;      ///< 1 where one of the four pixels from (x, y) on reaches the threshold
  double threshold = 0;             ///< weakest gradient that counts as an edge
  ImageF smooth, along_x, along_y;  ///< on the way
};

/// threshold: 4 times the noise of the gradient, estimated as 1.48 times its median magnitude, but between
/// `least` and 3 `least`: the median of a picture full of texture is no noise.
GradientPicture gradient_of(const Grey& picture, double sigma_px, double least);
/// The same into what is there: pictures of the same size cost no new memory.
void gradient_of(const Grey& picture, double sigma_px, double least, GradientPicture& out);

/// Places of picture edges along a normal, nearest first: signed distance from the point along the normal
/// [px] and gradient across the edge (its sign is the edge's direction from dark to bright).
struct EdgeHypotheses {
  static constexpr int most = 4;
  std::array<float, most> distance = {}, strength = {};
  int count = 0;
};

/// Searches p + s n, |s| <= range_px, for local maxima of |G . n| above the threshold whose gradient
/// direction is within acos(least_cosine) of the normal; sub-pixel by a parabola. n has unit length. Outside
/// the picture the gradient is 0.
EdgeHypotheses search_edges(const GradientPicture& picture, const Eigen::Vector2d& p,
                            const Eigen::Vector2d& n, double range_px, double least_cosine);

}  // namespace stuv::tracking
