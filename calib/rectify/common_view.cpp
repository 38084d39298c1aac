#include "calib/rectify/common_view.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

namespace stuv {
namespace {

double median(std::vector<double> values) {
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Middle of the field of view of one camera on the plane Z = 1 of the rig's axes.
Eigen::Vector2d field_centre(const Camera& camera) {
  const double right = camera.width - 1, bottom = camera.height - 1;
  const std::vector<Eigen::Vector3d> rays =
      unproject(camera, {{0, 0.5 * bottom}, {right, 0.5 * bottom}, {0.5 * right, 0}, {0.5 * right, bottom}});
  Eigen::Vector2d slopes[4];
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector3d ray = camera.cam_from_rig.R.transpose() * rays[i];
    if (ray.z() < 1e-3)
      throw std::invalid_argument(fmt::format("camera {} looks away from the plane's normal", camera.name));
    slopes[i] = ray.head<2>() / ray.z();
  }
  return {0.5 * (slopes[0].x() + slopes[1].x()), 0.5 * (slopes[2].y() + slopes[3].y())};
}

}  // namespace

CommonView common_view(const Rig& rig) {
  constexpr double kCos60 = 0.5;
  std::vector<double> focals;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  CommonView view;
  for (const RigCamera& rc : rig.cameras) {
    if (!rc.determined) continue;
    const Eigen::Vector3d axis = rc.camera.cam_from_rig.R.row(2);
    if (axis.z() <= kCos60)
      throw std::invalid_argument(
          fmt::format("camera {} looks away from the plane's normal", rc.camera.name));
    if (focals.empty()) {
      view.width = rc.camera.width;
      view.height = rc.camera.height;
    }
    focals.push_back(0.5 * (rc.camera.intrinsics[0] + rc.camera.intrinsics[1]));
    centre += field_centre(rc.camera);
  }
  if (focals.empty()) throw std::invalid_argument("no camera of the rig is determined");
  centre /= static_cast<double>(focals.size());
  view.focal_px = median(focals);
  view.cx_px = 0.5 * (view.width - 1) - view.focal_px * centre.x();
  view.cy_px = 0.5 * (view.height - 1) - view.focal_px * centre.y();
  return view;
}

}  // namespace stuv
