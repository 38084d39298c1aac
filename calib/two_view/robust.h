#pragma once

#include <Eigen/Dense>
#include <optional>
#include <span>

#include "calib/two_view/match.h"
#include "calib/two_view/ransac.h"

namespace stuv {

/// F by RANSAC over samples of seven matches, Sampson distances, local optimisation by refine_sampson with
/// the weights of the cost. Samples whose points lie on both sides of their epipole (not all before both
/// cameras) are left out (Chum, Werner, Matas, ICPR 2004). Threshold in the matches' own unit.
RansacResult<Eigen::Matrix3d> ransac_fundamental(std::span<const Match> matches,
                                                 const RansacOptions& options);

/// H, x' = H x, over samples of four; residual sqrt((d(x', H x)^2 + d(x, H^-1 x')^2) / 4), which is the
/// distance of the match from the nearest pair that H maps exactly, to first order and where H keeps lengths.
RansacResult<Eigen::Matrix3d> ransac_homography(std::span<const Match> matches, const RansacOptions& options);

/// H by least squares over n >= 4 weighed matches (DLT in normalised coordinates).
std::optional<Eigen::Matrix3d> homography_of(std::span<const Match> matches,
                                             std::span<const double> weights = {});
/// Squared residual of ransac_homography.
double transfer_distance2(const Eigen::Matrix3d& H, const Eigen::Matrix3d& H_inverse, const Match& m);

/// Plane and parallax: with H of a plane known, two matches off it give the epipole, e' = (H x1 x x1') x (H
/// x2 x x2'), F = [e']_x H. RANSAC over pairs of the matches in `off_plane`, judged by all.
RansacResult<Eigen::Matrix3d> plane_and_parallax(std::span<const Match> matches, const Eigen::Matrix3d& H,
                                                 std::span<const int> off_plane,
                                                 const RansacOptions& options);

}  // namespace stuv
