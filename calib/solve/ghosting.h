#pragma once

#include <vector>

#include "calib/solve/joint_solve.h"
#include "calib/solve/lattice.h"

namespace stuv {

/// How far apart the cameras' pictures of one point fall, one standard deviation, because the calibration is
/// uncertain: what the eye sees as ghosting in a picture focused on that point.
struct Ghosting {
  double depth_m = 0;  ///< infinity counts
  /// Over points across the reference picture, of the root mean square over cameras [px]: their rms and the
  /// largest; NaN if no point is seen by two cameras, or the covariance is not finite.
  double rms_px = 0, worst_px = 0;
  int worst_camera = -1;  ///< the one that is farthest off at the worst point; -1: none
};

/// For points X at distance z in front of the rig's plane, where two or more of the cameras `which` see them:
///
///   e_c = R_c^T (dq/dlens dlens_c + dq/dp dp_c(X)),   S = cov(e_1 .. e_n)
///   ghosting = sqrt(trace(P S P) / n),   S scaled by the corner noise
///
/// R_c: the camera's turn about its axis in the rig's frame. P takes out what does not ghost: a shift that
/// all pictures share (u, v) and a change of disparity, e_c ~ (s_c, t_c), that focusing finds. Reference
/// picture: size, focal length and middle of the first of `which`, looking along z from the origin; 5 x 3
/// points. Empty without `solution.camera_covariance`.
std::vector<Ghosting> ghosting(const JointSolution& solution, const Layout& layout,
                               const std::vector<int>& which, const std::vector<double>& depths_m);

}  // namespace stuv
