#pragma once

#include <Eigen/Dense>
#include <string>
#include <vector>

#include "calib/solve/lens_prior.h"
#include "calib/solve/observations.h"
#include "calib/solve/seed.h"
#include "core/camera.h"

namespace stuv {

enum class Lens { opencv4, opencv5, opencv8, splined };

struct SolveOptions {
  Lens lens = Lens::opencv4;
  bool choose_lens = false;     ///< calibrate: opencv5 with alike lenses where opencv4 does not fit
  LensPrior prior;              ///< of opencv5's distortions
  bool shared_lens = false;     ///< one lens for all cameras; their pictures must be of one size
  std::vector<Camera> known;    ///< lenses that are held, one a camera in order, of one model; empty: solved
  bool regularise = true;       ///< mrcal's light pull of distortions to 0 and centres to the middle
  bool board_warp = true;       ///< solve for the board's bend, two parabolas
  bool reject_outliers = true;  ///< corners beyond 4 sigma, until none is left beyond 5, as mrcal does
  bool reweight = true;         ///< cameras whose corners are noisier than others' weigh less
  bool covariance = true;
};

struct JointSolution {
  bool converged = false;  ///< finite, and the gradient vanishes at the solution
  /// Whether the camera was in the solve. Of those that were not, all else here is empty, 0 or the identity.
  std::vector<bool> solved;
  /// The first solved camera's frame is the reference: Camera::cam_from_rig is cam_from_ref here.
  std::vector<Camera> cameras;
  std::vector<Pose> ref_from_board;  ///< of each set; the identity where no board is
  Eigen::Vector2d warp_m = Eigen::Vector2d::Zero();
  /// Observed minus predicted, [observation][corner]; outliers and absent corners NaN.
  std::vector<std::vector<Eigen::Vector2d>> residuals_px;
  std::vector<std::vector<bool>> outlier;  ///< [observation][corner], absent corners are none
  int inliers = 0, outliers = 0;           ///< corners
  /// Over x and y of the inliers' residuals times their weights, as mrcal states it; and without the weights.
  double rms_px = 0, rms_unweighted_px = 0;
  double worst_px = 0;  ///< longest residual vector of an inlier
  double noise_px = 0;  ///< sqrt(sum w^2 x^2 / (measurements - states)): at weight 1
  /// What stated sigmas take that noise for: noise_px, times SigmaScale::scale where that was measured.
  double sigma_px = 0;
  std::vector<double> camera_weight;  ///< of each camera's corners, on top of their own
  /// Covariance of each camera's turn dtheta [rad] (its axes in the reference frame turn by it) and centre
  /// [m], of unit corner noise: multiply by sigma_px^2. (6 n) x (6 n), the reference's rows 0. Empty if off.
  Eigen::MatrixXd pose_covariance;
  std::vector<Eigen::Vector2d> focal_sigma;  ///< of fx, fy, of unit corner noise; 0 where held
  /// Covariance of all that a picture depends on, of unit corner noise: of each camera its lens parameters,
  /// then rotation vector and translation [m] of cam_from_ref, camera_states a camera; then the boards' mean
  /// motion in the reference frame, omega [rad] and tau [m]: a point x that is fixed to the boards moves by
  /// omega x x + tau in the mean. 0 for what was held. Empty if off, or more than kMostCameraStates.
  Eigen::MatrixXd camera_covariance;
  int camera_states = 0;
};

inline constexpr int kMostCameraStates = 3500;

/// The one joint solve: all lenses, camera poses, board poses and the board's bend, by mrcal's sparse dog
/// leg. The cameras have to hang together (camera_groups).
///
///   minimise sum_i w_i^2 |project(cam_from_ref ref_from_board p_i(warp)) - q_i|^2 + regularisation
///
/// In stages from the seed: geometry; then focal lengths and centres too; then all. Where the deviations of
/// the cameras' residuals differ by more than a quarter, each camera's weights are divided by its own.
/// Outliers are corners whose x or y residual exceeds 4 deviations of all, or 8 of the median where that is
/// less (many outliers make the deviation large); the solve repeats until none is left beyond 5, and then
/// once more with those that fit after all.
/// Covariances: (J^T J)^-1 of the last stage, J from mrcal_optimizer_callback, factorised by CHOLMOD, so all
/// correlations between lenses, cameras and boards are in. Directions that the observations leave free get a
/// very large, finite variance.
/// Never throws for numerical reasons: see `converged`.
JointSolution joint_solve(const Observations& observations, const Seed& seed,
                          const SolveOptions& options = {});

/// An opencv4 solution as one of opencv5, k3 = 0.
JointSolution as_opencv5(JointSolution solution);

/// By how much the best k3, one a camera, would lower the cost of as_opencv5's solution [px^2 at weight 1],
/// to first order: g^T (J^T J)^-1 g (a score test). The noise^2 a camera in the mean if opencv4 is right.
double gain_of_k3(const Observations& observations, const JointSolution& solution,
                  const SolveOptions& options);

/// Solves again from `start`, with the boards of some sets only and the corners that were inliers there.
/// Cameras that these sets do not connect to the largest group are not solved.
JointSolution solve_again(const Observations& observations, const JointSolution& start,
                          const std::vector<bool>& with_set, const SolveOptions& options);

/// The same solution with the cameras and boards counted as in `all`, which `part_of` made it from.
struct ObservedPart;
JointSolution as_of_all(const JointSolution& part, const ObservedPart& map, const Observations& all);

/// Fits one set's board to a solution that it was not part of. Outliers of `inliers_of` take no part.
struct HeldOutError {
  double sum_sq_px2 = 0;
  int count = 0;  ///< x and y residuals; 0 if no solved camera sees the set
  Pose ref_from_board;
};
HeldOutError held_out_error(const Observations& observations, const JointSolution& solution, int set,
                            const JointSolution& inliers_of);

}  // namespace stuv
