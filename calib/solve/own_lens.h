#pragma once

#include "calib/solve/joint_solve.h"

namespace stuv {

/// A camera's lens by its own boards alone. Boards that moved between the frames of a set bend all lenses of
/// a joint solve, for no pose of the board is right for two cameras; by itself a camera has a pose a view.
struct OwnLens {
  bool solved = false;
  Eigen::Vector2d focal_px = {0, 0};
  Eigen::Vector2d focal_sigma_px = {0, 0};  ///< by its residuals, taken as independent
};

/// From where the camera is in `solution`, with all its corners. Not solved: fewer than two boards, or no
/// convergence. `options`: lenses are free, of one camera each, and have focal lengths among their
/// parameters.
OwnLens own_lens(const Observations& observations, const JointSolution& solution, int camera,
                 const SolveOptions& options);

}  // namespace stuv
