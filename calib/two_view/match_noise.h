#pragma once

#include <Eigen/Dense>
#include <limits>
#include <span>
#include <vector>

#include "calib/two_view/match.h"

namespace stuv {

/// How Sampson distances r of matches are distributed: a share `right` of them as Student's t, the others
/// evenly,
///
///   p(r) = right t_nu(r / s) / s + (1 - right) u
///
/// s = scale_px; nu = freedom, infinite for a Gaussian; u = anywhere_per_px, what chance makes of a wrong
/// match.
struct MatchNoise {
  double freedom = std::numeric_limits<double>::infinity();
  double scale_px = 1, right = 0.7, anywhere_per_px = 0;
};

/// F of greatest likelihood under such noise, the noise with it. One entry a match:
struct NoiseFit {
  Eigen::Matrix3d F = Eigen::Matrix3d::Zero();  ///< unit_scale
  MatchNoise noise;
  double log_likelihood = -std::numeric_limits<double>::infinity();
  std::vector<double> right;   ///< probability that it is right
  std::vector<double> weight;  ///< of r^2 in the least squares that F solves, at most about 1
  /// Deviation of Gaussian noise that would leave F as uncertain as it is: Huber's sum of psi^2 over (sum of
  /// psi')^2, psi = weight r, over the n that are likely right, n - 7 for what F adapts to (Huber, Robust
  /// Statistics, 7.6).
  double sigma_px = 0;
};

/// Expectation and maximisation: probabilities and weights from F and the noise, F by a weighted
/// refine_sampson, the noise from its residuals; at most `rounds` of them. `counts`: how often each match was
/// given. Matches beyond `most_px` are wrong. scale_px stays above `least_px`.
NoiseFit fit_noise(std::span<const Match> matches, std::span<const double> counts, const Eigen::Matrix3d& F,
                   const MatchNoise& start, double least_px, double most_px, int rounds = 60);

/// The Gaussian fit, or that with nu = 2, its log likelihood lessened by 2, where it is greater still: real
/// matches come at many scales, and a few that are off by a pixel or two should not outvote many that are off
/// by a tenth. On Gaussian noise the second alone would cost a quarter of the precision, the choice costs two
/// hundredths.
NoiseFit fit_noise_and_shape(std::span<const Match> matches, std::span<const double> counts,
                             const Eigen::Matrix3d& F, const MatchNoise& start, double least_px,
                             double most_px, int rounds = 60);

}  // namespace stuv
