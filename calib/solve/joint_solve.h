#pragma once

#include <Eigen/Dense>
#include <string>
#include <vector>

#include "calib/solve/observations.h"
#include "calib/solve/seed.h"
#include "core/camera.h"

namespace stuv {

enum class Lens { opencv4, opencv8, splined };

struct SolveOptions {
  Lens lens = Lens::opencv4;
  bool regularise = true;       ///< mrcal's light pull of distortions to 0 and centres to the middle
  bool board_warp = true;       ///< solve for the board's bend, two parabolas
  bool reject_outliers = true;  ///< corners beyond 4.5 sigma, until none is left beyond 5
  bool covariance = true;
};

struct JointSolution {
  bool converged = false;  ///< finite, and the gradient vanishes at the solution
  /// Camera 0's frame is the reference: Camera::cam_from_rig is cam_from_ref here.
  std::vector<Camera> cameras;
  std::vector<Pose> ref_from_board;  ///< of each set; the identity where no board is
  Eigen::Vector2d warp_m = Eigen::Vector2d::Zero();
  /// Observed minus predicted, [observation][corner]; outliers and absent corners NaN.
  std::vector<std::vector<Eigen::Vector2d>> residuals_px;
  std::vector<std::vector<bool>> outlier;  ///< [observation][corner], absent corners are none
  int inliers = 0, outliers = 0;           ///< corners
  double rms_px = 0;                       ///< over x and y of the inliers
  double worst_px = 0;                     ///< longest residual vector of an inlier
  double noise_px = 0;                     ///< sqrt(sum x^2 / (measurements - states))
  /// Covariance of all centres in the reference frame [m^2], (3 n) x (3 n), camera 0's rows 0; and of fx, fy
  /// of each camera, sigma [px]. Of unit corner noise: multiply by noise_px^2 and noise_px. Empty if off.
  Eigen::MatrixXd centre_covariance;
  std::vector<Eigen::Vector2d> focal_sigma;
  /// Covariance of all that a picture depends on, of unit corner noise: of each camera its lens parameters,
  /// then rotation vector and translation [m] of cam_from_ref; camera_states a camera, camera 0's pose 0, as
  /// is what was held. Empty if off, or if that is more than kMostCameraStates.
  Eigen::MatrixXd camera_covariance;
  int camera_states = 0;
};

inline constexpr int kMostCameraStates = 2500;

/// The one joint solve: all lenses, camera poses, board poses and the board's bend, by mrcal's sparse dog
/// leg.
///
///   minimise sum_i w_i^2 |project(cam_from_ref ref_from_board p_i(warp)) - q_i|^2 + regularisation
///
/// In stages from the seed: geometry; then focal lengths and centres too; then all. Outliers are corners
/// whose x or y residual exceeds 4.5 deviations of all; the solve repeats until none is left beyond 5.
/// Covariances: (J^T J)^-1 of the last stage, J from mrcal_optimizer_callback, factorised by CHOLMOD, so all
/// correlations between lenses, cameras and boards are in. Directions that the observations leave free get a
/// very large, finite variance.
/// Never throws for numerical reasons: see `converged`.
JointSolution joint_solve(const Observations& observations, const Seed& seed,
                          const SolveOptions& options = {});

/// Solves again without the boards of `left_out_set`, starting from `solution` with its outliers, then fits
/// only that board's pose to the result. Returns the sum of squares and the number of x and y residuals of
/// the set's inliers; count 0 if the remaining boards do not connect the cameras that see it.
struct HeldOutError {
  double sum_sq_px2 = 0;
  int count = 0;
};
HeldOutError held_out_error(const Observations& observations, const JointSolution& solution, int left_out_set,
                            const SolveOptions& options = {});

}  // namespace stuv
