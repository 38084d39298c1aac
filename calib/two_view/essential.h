#pragma once

#include <Eigen/Dense>
#include <array>
#include <optional>
#include <span>
#include <vector>

#include "calib/two_view/match.h"
#include "core/pose.h"

namespace stuv {

// Calibrated cameras. Here a match holds directions with z = 1: (x, y) = K^-1 of the pixel, or of the lens
// model. y^T E x = 0, E = [t]_x R, with x_b = R x_a + t.

/// All E through five matches, up to ten: the null space of the 5 x 9 system and the ten cubic equations det
/// E = 0, 2 E E^T E - tr(E E^T) E = 0, whose solutions are eigenvectors of a 10 x 10 action matrix
/// (Stewenius, Engels, Nister, ISPRS 2006).
std::vector<Eigen::Matrix3d> five_point(std::span<const Match, 5> matches);

/// The pose b_from_a, |t| = 1, of the four that E allows, which has most of the matches before both cameras,
/// and how many they are.
struct RelativePose {
  Pose b_from_a;
  int in_front = 0;
};
RelativePose pose_of(const Eigen::Matrix3d& E, std::span<const Match> matches);

/// The nearest essential matrix: singular values 1, 1, 0.
Eigen::Matrix3d closest_essential(const Eigen::Matrix3d& E);

}  // namespace stuv
