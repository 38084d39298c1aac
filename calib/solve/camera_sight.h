#pragma once

#include <Eigen/Dense>
#include <optional>
#include <vector>

#include "core/camera.h"

extern "C" {
#include <mrcal/mrcal.h>
}

namespace stuv {

/// A point of the reference frame over its depth, so that points at infinity are points like others:
/// x_ref = direction / inverse_m.
struct FarPoint {
  Eigen::Vector3d direction = {0, 0, 1};
  double inverse_m = 0;
};

/// How one camera sees a point, and what its picture of it does when lens and pose change.
struct CameraSight {
  Eigen::Vector2d q_px;
  bool in_picture = false;
  Eigen::Matrix<double, 2, Eigen::Dynamic> by_states;  ///< lens, rotation vector, translation of cam_from_ref
  Eigen::Matrix<double, 2, 3> by_direction;            ///< FarPoint::direction
};

/// `camera.cam_from_rig` is cam_from_ref. None if the point is behind the camera, or the lens model cannot
/// project it.
///
///   p = R direction + inverse_m t,  dp/dr = -R [direction]x J_r(r),  dp/dt = inverse_m I
std::optional<CameraSight> camera_sight(const Camera& camera, const mrcal_lensmodel_t& lens,
                                        const FarPoint& point);

mrcal_lensmodel_t lens_model_of(const Camera& camera);

/// Pixels of an nx x ny grid over a picture, rows first, half a cell in from its border.
std::vector<Eigen::Vector2d> picture_grid(const Camera& camera, int nx, int ny);

}  // namespace stuv
