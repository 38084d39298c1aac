#pragma once

#include <Eigen/Dense>
#include <vector>

namespace stuv {

/// One observation of a point in a bundle adjustment, linearised where it ended: residual r [px] and its
/// derivatives by the camera's parameters, which stand in columns `column` .. of the whole, and by the point.
struct LinearObservation {
  int point = 0;
  int part = 0;  ///< observations whose errors are alike for being near each other: a part of one picture
  int column = 0;
  Eigen::Matrix<double, 2, Eigen::Dynamic> by_camera;
  Eigen::Matrix<double, 2, 3> by_point;
  Eigen::Vector2d residual = Eigen::Vector2d::Zero();
};

/// Covariance of the cameras' parameters, points eliminated:
///
///   C = n / (n - p) S^-1 M S^-1,   S = J_c^T J_c - W V^-1 W^T,   M = sum_points g g^T + sum_parts g g^T -
///   sum_observations g g^T
///
/// V, W: the points' blocks of J^T J and their coupling with the cameras; g: what an observation, or all of a
/// point or of a part together, adds to the reduced gradient. Errors of one feature in neighbouring pictures
/// are alike, and so are those of neighbouring features, which (J^T J)^-1 does not know (the sandwich with
/// two clusterings: Cameron, Gelbach, Miller, J. Business & Economic Statistics 29(2), 2011).
///
/// n residuals, p parameters. `free` (columns x k): directions that the observations leave free (the gauge);
/// C is 0 along them. Empty if S is singular beyond that: some camera is not determined. `columns`: of all
/// cameras' parameters together; observations of one camera have equal `column`.
Eigen::MatrixXd bundle_covariance(const std::vector<LinearObservation>& observations, int columns,
                                  const Eigen::MatrixXd& free);

}  // namespace stuv
