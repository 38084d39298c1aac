#pragma once

#include <Eigen/Dense>
#include <span>

#include "calib/two_view/match.h"

namespace stuv {

/// Whether the points of A, or of B, lie on a conic through their epipole, to `noise_px`: their rays and the
/// baseline then lie on a cone through both centres, and every F with its epipole elsewhere on the conic fits
/// as well (Hartley and Zisserman, 22.1; Steiner's generation of the conic). A line is the case of a pair of
/// lines.
///
///   minimise sum (q(x) . c)^2 with q(e) . c = 0, |c| = 1,  q = (x^2, xy, y^2, xz, yz, z^2)
///
/// in normalised coordinates; then the median first-order distance of the points from c is compared. Noise
/// gives such points an apparent certainty that the covariance of F repeats, so that it cannot tell.
bool on_conic_through_epipole(std::span<const Match> matches, const Eigen::Matrix3d& F, double noise_px);

}  // namespace stuv
