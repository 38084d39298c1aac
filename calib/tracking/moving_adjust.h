#pragma once

#include <Eigen/Dense>
#include <vector>

#include "core/pose.h"

namespace stuv::tracking {

/// Where one frame sees a point: direction (x/z, y/z) in the camera's frame.
struct Sight {
  int frame = 0;
  Eigen::Vector2d ray = Eigen::Vector2d::Zero();
};
/// A point of the scene as the frames see it.
using TrackedPoint = std::vector<Sight>;

struct Adjusted {
  bool converged = false;
  std::vector<Pose> poses;  ///< camera from scene, of each frame
  std::vector<Eigen::Vector3d> points;
  std::vector<double> sum_sq;        ///< of each frame, of inliers [px^2]
  std::vector<int> count, outliers;  ///< residuals (two a sight) of inliers; sights taken out
  double worst_px = 0;               ///< longest residual of an inlier
  /// Of all centres [m^2], (3 n) x (3 n), up to a similarity: bundle_covariance. Empty if some frame is not
  /// determined by the points.
  Eigen::MatrixXd centre_covariance;
  double scale_sigma = 0;  ///< of the scale, relative; NaN: not known
};

/// Adjusts the poses of a moving camera and the points that it sees together,
///
///   minimise sum rho(f |pi(R_i X_j + t_i) - pi(ray_ij)|^2) + sum rho'(|pose_i - tracked pose_i|^2 /
///   sigma^2),
///
/// rho Huber's at 1 px, rho' Cauchy's (a slip of the tracker pulls little); sights beyond four deviations
/// out, then again with rho the square. The priors (`sigma_m`, 0.05 rad) hold the seven freedoms of such a
/// problem. Points that lie behind a camera are left out. Not converged without any point.
Adjusted adjust_moving(const std::vector<Pose>& tracked, const std::vector<TrackedPoint>& points,
                       double focal_px, double sigma_m);

/// Residuals say nothing of scale and place, and robust priors hold them loosely: both again from the tracked
/// centres c', as medians, which a part of slipped frames does not move,
///
///   scale = median over pairs of (c'_i - c'_j) . (c_i - c_j) / |c_i - c_j|^2,
///
/// its sigma by leaving out one block of neighbouring frames after the other (jackknife): errors of a tracker
/// are alike from frame to frame. False, and nothing changed, if the frames do not tell.
bool restore_scale(const std::vector<Pose>& tracked, Adjusted& adjusted);

}  // namespace stuv::tracking
