#pragma once

#include <Eigen/Dense>
#include <vector>

#include "core/pose.h"

namespace stuv::tracking {

/// Coordinates of se(3): (v, w), translation before rotation [rad].
using Twist = Eigen::Matrix<double, 6, 1>;
using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// exp: se(3) -> SE(3), closed form with series near angle 0.
///
///   R = I + a W + b W^2,  t = (I + b W + c W^2) v,  a = sin p / p, b = (1 - cos p) / p^2, c = (p - sin p) /
///   p^3
///
/// W = cross_matrix(w), p = |w|. Defined for any finite twist.
Pose exp(const Twist& twist);

/// The inverse of exp with |w| <= pi. Accurate to rounding near 0 and near pi, where the axis comes from the
/// quaternion's vector part; at pi itself either of the two axes.
Twist log(const Pose& pose);

/// The weighted mean of poses: arithmetic for t, and for R the projection onto SO(3) of the arithmetic mean
/// of the matrices, by SVD (Moakher, SIAM J. Matrix Anal. Appl. 24(1), 2002). Weights are >= 0 and need not
/// sum to 1. With rotations so spread that the mean matrix is singular the projection is not unique; one is
/// returned. Empty input or a sum of weights that is not positive: the identity.
Pose mean(const std::vector<Pose>& poses, const std::vector<double>& weights);

}  // namespace stuv::tracking
