#pragma once

#include <limits>

#include "calib/photometry/photometry.h"
#include "core/camera.h"

namespace stuv {

/// What a camera stored of a flat piece of surface.
struct PhotometricSample {
  int camera = 0;
  int point = 0;  ///< the same number for the same surface under the same light
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  std::array<double, 3> stored = {0, 0, 0};  ///< 0..1, not clipped
};

struct PhotometryOptions {
  int least_samples = 24;         ///< of a camera, of points that others see as well
  double most_gain_sigma = 0.01;  ///< relative; beyond it a camera is not determined
  double most_offset_sigma = 0.005;
  double most_corner_sigma = 0.02;
  /// Beyond it, after the best fit, no camera is determined: what they look at is not what this model says.
  double most_spread = std::numeric_limits<double>::infinity();
  double most_pairs = 4e6;  ///< of cameras at one point: beyond it points are thinned out evenly
};

/// Least squares over all samples for gains, offsets, V and one unknown value L per point and channel:
///
///   stored = offset_c + gain_c V_c(rho) L_point
///
/// V is a cubic in rho whose Bernstein coefficients fall, 1, 1 - d1, 1 - d1 - d2, 1 - d1 - d2 - d3 with d >=
/// 0, so V falls; channels share it. Gauss-Newton, points eliminated (Schur complement), Tukey's weights with
/// the scale from the median of |residuals| (glossy boards and shadows), d >= 0 by an active set. Weak priors
/// (offset 0 +- 0.05, gain 1 +- 0.5, d its mean over the rig +- 0.03 and that 0 +- 0.3) hold what samples do
/// not determine. Gauge: mean gain 1, mean offset 0.
///
/// A camera in no common view with most of the others, with too few samples, or with a gain whose sigma is
/// too large is not determined: identity, with the reason. Offsets that are not determined are 0. What all
/// lenses have in common of V is determined only if points move through the pictures; where it is not, a note
/// says so and it stays near 0: cameras agree, corners stay as dark as they have in common. Cameras: of the
/// samples' indices; `source` goes into the result.
Photometry estimate_photometry(const std::vector<PhotometricSample>& samples,
                               const std::vector<Camera>& cameras, int channels, const std::string& source,
                               const PhotometryOptions& options = {});

}  // namespace stuv
