#pragma once

#include <optional>

#include "calib/solve/joint_solve.h"

namespace stuv {

/// What the lenses of one rig have in common, from a solution in which each camera's was free: cameras of an
/// array are of one make, and where boards left a part of some pictures empty, the other cameras' lenses say
/// what distortion is likely there.
///
/// With d_c the radial distortions k1, k2, k3 of camera c as displacements f rho^(2i+1) k_i [px] at the
/// picture's corner, at rho of the axis, and P_c their covariance in the solution:
///
///   d_c ~ N(m, S),   estimate of d_c ~ N(d_c, P_c)
///
/// m and S by expectation and maximisation, S at least kLeastSpreadPx^2 I. If lenses differ, S is large and
/// nothing is said. Nothing too, if fewer than kFewestAlike cameras of one picture size were solved, or the
/// model is not opencv5. The prior is in units of the solution's sigma_px.
std::optional<LensPrior> lens_likeness(const JointSolution& solution);

inline constexpr double kLeastSpreadPx = 0.3;
inline constexpr int kFewestAlike = 6;

}  // namespace stuv
