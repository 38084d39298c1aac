#pragma once

#include <Eigen/Dense>
#include <cmath>

#include "calib/two_view/fundamental.h"

namespace stuv {

/// Right Jacobian of SO(3): R(r + d) = R(r) R(J_r(r) d) to first order in d.
///
///   J_r = I - (1 - cos a) / a^2 [r]x + (a - sin a) / a^3 [r]x^2,  a = |r|
inline Eigen::Matrix3d right_jacobian(const Eigen::Vector3d& r) {
  const double a = r.norm();
  const Eigen::Matrix3d X = cross_matrix(r), I = Eigen::Matrix3d::Identity();
  if (a < 1e-6) return I - 0.5 * X;
  return I - (1 - std::cos(a)) / (a * a) * X + (a - std::sin(a)) / (a * a * a) * X * X;
}

}  // namespace stuv
