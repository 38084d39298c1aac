#pragma once

#include <Eigen/Dense>
#include <vector>

#include "calib/solve/joint_solve.h"
#include "calib/solve/lattice.h"

namespace stuv {

/// Covariance of turns and centres (dtheta_i, dc_i) of cameras, (6 n) x (6 n), after rigid alignment on
/// their true poses: the six motions (omega, tau) that all could make together,
///
///   dtheta_i += omega,  dc_i += omega x (c_i - mean c) + tau,
///
/// are those that make sum |dc_i|^2 least; what centres on one line or one point leave free of omega, those
/// that make sum |dtheta_i|^2 least. `covariance` may be in any frame: it is as JointSolution has it, of the
/// cameras `centres` belong to.
Eigen::MatrixXd rigidly_aligned_poses(const Eigen::MatrixXd& covariance,
                                      const std::vector<Eigen::Vector3d>& centres);

/// The rows and columns of some cameras, `block` of them each.
Eigen::MatrixXd block_of(const Eigen::MatrixXd& covariance, const std::vector<int>& which, int block);

/// One standard deviation of the lattice, through the whole solve: fit_layout differentiated numerically.
struct LatticeSigma {
  Eigen::Vector2d s_step_m = {0, 0}, t_step_m = {0, 0}, origin_m = {0, 0};
  double s_spacing_m = 0, t_spacing_m = 0;  ///< of the steps' lengths
};
/// `which`: the determined cameras; rows, cols: as fit_layout was given them.
LatticeSigma lattice_sigma(const JointSolution& solution, const std::vector<PlacedCamera>& placed, int rows,
                           int cols);

/// Where a camera's picture of a point moves, one standard deviation in the worst direction [px], over an
/// nx x ny grid of its picture (picture_grid, rows first). The point is fixed to the boards, which move:
///
///   dq = dq/dlens dlens + dq/dp (dp/dpose dpose + R (omega x p + tau)),  (omega, tau): the boards' mean
///   motion
///
/// (mrcal's mean-frames method.) The corners' noise is solution.sigma_px.
struct ProjectionMap {
  double distance_m = 0;  ///< from the camera; may be infinity
  int nx = 0, ny = 0;
  std::vector<double> sigma_px;  ///< NaN where it is not known
  double rms_px = 0, worst_px = 0, centre_px = 0;
};
ProjectionMap projection_map(const JointSolution& solution, int camera, double distance_m, int nx = 16,
                             int ny = 10);

}  // namespace stuv
