#include "calib/check/lens_turn.h"

namespace stuv {

std::optional<Camera> half_turned(const Camera& camera) {
  Camera turned = camera;
  if (camera.lens_model != "LENSMODEL_PINHOLE" && camera.lens_model.rfind("LENSMODEL_OPENCV", 0) != 0)
    return std::nullopt;
  turned.intrinsics[2] = camera.width - 1 - camera.intrinsics[2];
  turned.intrinsics[3] = camera.height - 1 - camera.intrinsics[3];
  // Terms even in (x, y) of the image plane, which must become odd: p1, p2, and s1 .. s4 of twelve.
  for (const std::size_t k : {6, 7, 12, 13, 14, 15})
    if (k < turned.intrinsics.size()) turned.intrinsics[k] = -camera.intrinsics[k];
  const Eigen::Matrix3d half = Eigen::Vector3d(-1, -1, 1).asDiagonal();
  turned.cam_from_rig = {half * camera.cam_from_rig.R, half * camera.cam_from_rig.t};
  return turned;
}

}  // namespace stuv
