#pragma once

#include "calib/tracking/object_model.h"
#include "calib/tracking/se3.h"

namespace stuv::tracking {

/// Between the object's own frame and one with its middle at the origin and its radius as the unit, in which
/// the filter works: a twist's rotation then turns the object about itself, and no size is special.
struct Normalisation {
  Eigen::Vector3d centre;
  double radius;

  Eigen::Vector3d point(const Eigen::Vector3d& x) const { return (x - centre) / radius; }
  Pose into(const Pose& p) const { return {p.R, (p.R * centre + p.t) / radius}; }
  Pose back(const Pose& p) const { return {p.R, radius * p.t - p.R * centre}; }
  Matrix6 covariance_back(const Matrix6& c) const {
    // x + w x (x - centre) + radius v': v = radius v' + centre x w
    Matrix6 M = Matrix6::Identity();
    M.topLeftCorner<3, 3>() *= radius;
    M.topRightCorner<3, 3>() = cross_matrix(centre);
    return M * c * M.transpose();
  }
};

ObjectModel normalised(ObjectModel model, const Normalisation& n);

/// Standard deviations of a twist in the camera's axes that move the object's outline by one pixel: across
/// the view by z / f, along it by z^2 / f, rotations by z / f (the object's radius is 1).
Twist one_pixel(double z, double focal_px);

/// A twist given in the camera's axes, in the object's.
Twist in_object(const Pose& cam_from_object, const Twist& cam);

/// The difference of two poses in pixels of the outline, largest component.
double distance_px(const Pose& a, const Pose& b, double focal_px);

}  // namespace stuv::tracking
