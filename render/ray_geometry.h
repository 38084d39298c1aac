#pragma once

#include "core/view.h"
#include "render/view_set.h"

namespace stuv {

/// The ray of an output pixel: direction (gx, gy, 1); `towards_scene` is r.z > 0, without which gx, gy are 0.
struct Ray {
  double gx = 0, gy = 0;
  bool towards_scene = false;
};

inline Ray ray_of(const Viewpoint& view, double x, double y) {
  const Eigen::Vector3d r =
      view.view_from_scene.transpose() *
      Eigen::Vector3d((x - view.cx_px) / view.focal_px, (y - view.cy_px) / view.focal_px, 1);
  if (!(r.z() > 0)) return {};
  return {r.x() / r.z(), r.y() / r.z(), true};
}

/// Where a camera sees the rays' points on one focal plane: u = u0 + scale gx, v = v0 + scale gy.
struct CameraMap {
  double u0 = 0, v0 = 0, scale = 0;
  bool visible = false;  ///< the plane lies before the viewpoint and before the camera
};

inline CameraMap camera_map(const LightField& lf, const View& camera, const Viewpoint& view, double d_px) {
  const double rho = lf.inverse_depth(d_px);
  const double before_view = 1 - view.z * rho, before_camera = 1 - camera.w * rho;
  if (!(before_view > 0) || !(before_camera > 0)) return {};
  const double k = lf.focal_px / before_camera;
  return {camera.cx_px + k * (view.s - camera.s) * rho, camera.cy_px + k * (view.t - camera.t) * rho,
          k * before_view, true};
}

}  // namespace stuv
