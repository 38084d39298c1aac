#pragma once

#include <vector>

#include "calib/solve/joint_solve.h"

namespace stuv {

/// Two solves of one rig against each other, and against what their covariances say of the difference if
/// corners' errors are independent.
struct SolveDifference {
  struct Camera {
    int camera = 0;
    /// rms over the picture of the two lenses' difference, but for what another pose of the camera could make
    /// up for at the boards' mean distance; and what it should be.
    double lens_px = 0, lens_predicted_px = 0;
    double centre_m = 0, centre_predicted_m = 0;  ///< after rigid alignment of the centres, the same
  };
  /// Of the cameras that both solves know: the mean over cameras of difference over prediction, both squared.
  struct Ratio {
    double square = 0;
    /// 2 / variance of `square` if the errors are Gaussian: cameras differ together, so it may be little more
    /// than one for many cameras. 0: there was nothing to compare.
    double freedom = 0;
  };
  std::vector<Camera> cameras;  ///< that both solved
  Ratio lens, centre;
};

enum class SolvePair { separate, nested };  ///< no common data; all of the first one's are in the second's

/// `whole` says at which lenses to linearise.
///
///   R = 1/n sum_c |y_c|^2 / tr S_cc,   var R = 2/n^2 sum_cd tr(S_cd S_dc) / (tr S_cc tr S_dd)
///
/// y_c: what camera c differs by, S its covariance: that of `a` plus that of `b`, or less that of `b` where
/// `a` is nested in it (two least squares solves differ by that: the larger one is the better estimate).
/// Cameras whose lens either solve knows to worse than a pixel are not in R: too far for covariances to
/// mean much; nor are those to which the nested solve's missing data say next to nothing.
SolveDifference solve_difference(const JointSolution& whole, const JointSolution& a, const JointSolution& b,
                                 SolvePair pair, double distance_m);

/// What stated uncertainties have to be multiplied by to be those of the differences (Birge's ratio): real
/// corners' errors are not independent of their neighbours'.
struct SigmaScale {
  double ratio = 0;    ///< measured; NaN if there was nothing to compare
  double freedom = 0;  ///< of ratio^2: its variance is 2 / freedom
  double scale = 1;    ///< ratio where it is large and significantly above 1
};

/// Pools differences, each weighed by its freedom. The sum of freedoms counts half: they share data.
/// Significant: ratio^2 - 1 of more than three of its deviations. Large: above 2; smaller ones say less than
/// the sigmas do.
SigmaScale sigma_scale(const std::vector<SolveDifference>& differences);

}  // namespace stuv
