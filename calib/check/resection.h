#pragma once

#include <Eigen/Dense>
#include <optional>
#include <span>

#include "calib/check/scene_point.h"
#include "core/pose.h"

namespace stuv {

/// A point that other cameras know, and where this camera sees it.
struct PointSighting {
  ScenePoint point;
  Eigen::Vector3d ray;    ///< unit vector in the camera's frame
  Eigen::Vector2d at_px;  ///< in its picture: errors of neighbours are alike
};

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

struct ResectionOptions {
  double focal_px = 0;               ///< angle across a ray to pixels
  Eigen::Vector2d size_px = {0, 0};  ///< of the picture
  bool hold_centre = false;          ///< the camera turned only
  int least_inliers = 20;
};

/// How a camera stands against where it was thought to stand.
struct Resection {
  Pose cam_from_rig;
  /// (turn [rad] in the camera's frame, shift of the centre in the rig's frame):
  /// R = exp([turn]) R_before, c = c_before + shift.
  Vector6d change = Vector6d::Zero();
  Matrix6d covariance = Matrix6d::Zero();
  double noise_px = 0;         ///< per coordinate, of sight line and point together
  double likeness = 1;         ///< by what neighbours' alike errors raise the variance
  double effect_px = 0;        ///< rms over the inliers of what the change does to the picture
  double effect_sigma_px = 0;  ///< and of its standard deviation
  double rms_px = 0;           ///< of the inliers after the change, not whitened, both coordinates together
  int inliers = 0, sightings = 0;
};

/// The camera's pose from points that others know, starting at `before`:
///
///   minimise sum_i rho(|L_i^-1 r_i|^2),   r_i = f across(d_i) u(R (x_i - w_i c)),   L_i L_i^T = I + J_i P_i
///   J_i^T
///
/// d_i: the ray, P_i: the point's covariance, so points known badly along a direction weigh little there.
/// Iteratively reweighted (Huber at the residuals' robust deviation), then least squares of the inliers
/// (four deviations). Covariance: k s^2 (J^T J)^-1, s^2 the residuals' variance, k the `likeness`: over the
/// 6 x 6 parts of the picture, |sum of a part's residuals|^2 over the sum of their squares; 1 if they are
/// independent. Nothing if fewer than least_inliers agree, or the points leave the pose free.
std::optional<Resection> resect(std::span<const PointSighting> sightings, const Pose& before,
                                const ResectionOptions& options);

/// A pose for large turns: of `tries` rotations through two random sightings each (camera's centre held), the
/// one with the most sightings within `tolerance_rad`; then refined by resect() from there. Seeded.
std::optional<Resection> resect_from_nothing(std::span<const PointSighting> sightings, const Pose& before,
                                             const ResectionOptions& options, double tolerance_rad = 0.05,
                                             int tries = 500);

}  // namespace stuv
