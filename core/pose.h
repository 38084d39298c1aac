#pragma once

#include <Eigen/Dense>
#include <cmath>

namespace stuv {

/// Rigid motion: a Pose named b_from_a maps coordinates in a to coordinates in b, x_b = R x_a + t.
struct Pose {
  Eigen::Matrix3d R = Eigen::Matrix3d::Identity();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();

  Eigen::Vector3d operator*(const Eigen::Vector3d& x) const { return R * x + t; }
  /// c_from_a = c_from_b * b_from_a
  Pose operator*(const Pose& other) const { return {R * other.R, R * other.t + t}; }
  Pose inverse() const { return {R.transpose(), -(R.transpose() * t)}; }
  /// Where the origin of b lies in a: the centre of a camera, if this is cam_from_rig.
  Eigen::Vector3d centre() const { return -(R.transpose() * t); }
};

/// Rotation vector (axis times angle [rad]) to matrix and back; the angle lies in [0, pi].
inline Eigen::Matrix3d rotation_from_vector(const Eigen::Vector3d& r) {
  const double angle = r.norm();
  if (angle < 1e-12) {
    Eigen::Matrix3d R;
    R << 1, -r.z(), r.y(), r.z(), 1, -r.x(), -r.y(), r.x(), 1;
    return R;
  }
  return Eigen::AngleAxisd(angle, r / angle).toRotationMatrix();
}
inline Eigen::Vector3d vector_from_rotation(const Eigen::Matrix3d& R) {
  const Eigen::AngleAxisd a(R);
  return a.angle() * a.axis();
}

/// [v]x: cross_matrix(v) x = v x x.
inline Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

/// Right Jacobian of SO(3): R(r + d) = R(r) R(J_r(r) d) to first order in d.
///
///   J_r = I - (1 - cos a) / a^2 [r]x + (a - sin a) / a^3 [r]x^2,  a = |r|
inline Eigen::Matrix3d right_jacobian(const Eigen::Vector3d& r) {
  const double a = r.norm();
  const Eigen::Matrix3d X = cross_matrix(r), I = Eigen::Matrix3d::Identity();
  if (a < 1e-4) return I - 0.5 * X + X * X / 6;
  const double half = std::sin(a / 2);  // 1 - cos a without cancellation
  return I - 2 * half * half / (a * a) * X + (a - std::sin(a)) / (a * a * a) * X * X;
}

}  // namespace stuv
