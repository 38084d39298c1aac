#pragma once

#include <Eigen/Dense>

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

}  // namespace stuv
