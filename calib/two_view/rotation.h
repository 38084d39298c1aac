#pragma once

#include <Eigen/Dense>
#include <span>

#include "calib/two_view/match.h"

namespace stuv {

/// Whether H is that of a camera which only turned: x' ~ K R K^-1 x with one K = [f 0 cx; 0 f cy; 0 0 1] for
/// both pictures (6 unknowns) describes the matches as well as a free H (8) to Torr's criterion, sum r^2 /
/// noise^2 + k log 4n. Both are fitted to the transfer into picture B by Ceres.
bool is_rotation(const Eigen::Matrix3d& H, std::span<const Match> matches, double noise_px);

}  // namespace stuv
