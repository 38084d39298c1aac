#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <memory>

#include "core/camera.h"

namespace stuv::tracking {

/// One camera's lens, point by point with derivatives: what a filter that projects millions of points needs.
class Lens {
 public:
  /// Throws Error unless the camera is valid (core/camera.h).
  explicit Lens(const Camera& camera);

  /// A point in the camera's frame to its pixel and d pixel / d point. False, and nothing written, unless the
  /// point is in front of the camera and within a third beyond the field of view, where distortion
  /// polynomials still mean something.
  bool project(const Eigen::Vector3d& x, Eigen::Vector2d& q,
               Eigen::Matrix<double, 2, 3>* derivative = nullptr) const {
    if (!pinhole_) return project_bent(x, q, derivative);
    if (!(x.z() > 0)) return false;
    const double per_z = 1 / x.z(), fx = focal_.x() * per_z, fy = focal_.y() * per_z;
    q = {fx * x.x() + centre_.x(), fy * x.y() + centre_.y()};
    if (derivative != nullptr) *derivative << fx, 0, -fx * x.x() * per_z, 0, fy, -fy * x.y() * per_z;
    return std::isfinite(q.x() + q.y());
  }

  bool inside(const Eigen::Vector2d& q, double margin_px = 0) const {
    return q.x() >= margin_px && q.y() >= margin_px && q.x() <= width_ - 1 - margin_px &&
           q.y() <= height_ - 1 - margin_px;
  }
  int width() const { return width_; }
  int height() const { return height_; }
  double focal_px() const { return focal_px_; }
  const Camera& camera() const { return camera_; }

 private:
  bool project_bent(const Eigen::Vector3d& x, Eigen::Vector2d& q,
                    Eigen::Matrix<double, 2, 3>* derivative) const;

  Camera camera_;
  Eigen::Vector2d focal_, centre_;
  int width_, height_;
  double focal_px_, most_tan2_;
  bool pinhole_;
  std::shared_ptr<const void> mrcal_;  ///< mrcal's own form of the lens model, read once
};

}  // namespace stuv::tracking
