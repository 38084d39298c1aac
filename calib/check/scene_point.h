#pragma once

#include <Eigen/Dense>
#include <optional>
#include <span>

namespace stuv {

/// A line of sight: from a camera's centre along a unit direction, both in the rig's frame. Angles across it
/// times `focal_px` are pixels in the middle of the picture.
struct SightLine {
  Eigen::Vector3d centre, direction;
  double focal_px = 0;
};

/// A point of the scene in homogeneous coordinates, so that far and infinitely far are nothing special:
/// X = (x, w), |X| = 1, stands for the place x / w, or for the direction x where w is 0.
struct ScenePoint {
  Eigen::Vector4d X;
  /// Columns: the three directions in which X can move on the unit sphere, X + tangent d.
  Eigen::Matrix<double, 4, 3> tangent;
  Eigen::Matrix3d covariance;  ///< of d, for sight lines with errors of 1 px across
};

/// The part of y that lies across the unit vector `direction`, in a basis (2 x 3) of its plane.
Eigen::Matrix<double, 2, 3> across(const Eigen::Vector3d& direction);

/// Point of least squares of the errors across the sight lines,
///
///   minimise sum_i |f_i A_i u(x - w c_i)|^2,  u(y) = y / |y|,  A_i = across(d_i),
///
/// by Gauss and Newton from the linear solution sum_i |(I - d_i d_i^T) (x - w c_i)|^2. Nothing with fewer
/// than two lines, where an error stays above `most_px`, behind a camera, or where all centres coincide.
std::optional<ScenePoint> triangulate(std::span<const SightLine> lines, double most_px);

}  // namespace stuv
