#include "calib/solve/camera_sight.h"

namespace stuv {

std::optional<CameraSight> camera_sight(const Camera& camera, const mrcal_lensmodel_t& lens,
                                        const FarPoint& point) {
  const Pose& pose = camera.cam_from_rig;
  const Eigen::Vector3d p = pose.R * point.direction + point.inverse_m * pose.t;
  // Only stereographic lenses see behind their plane.
  const bool wide =
      lens.type == MRCAL_LENSMODEL_SPLINED_STEREOGRAPHIC || lens.type == MRCAL_LENSMODEL_STEREOGRAPHIC;
  if (!(p.z() > (wide ? -0.9 * p.norm() : 0))) return std::nullopt;
  const auto lens_states = static_cast<Eigen::Index>(camera.intrinsics.size());
  mrcal_point3_t at = {};
  at.x = p.x(), at.y = p.y(), at.z = p.z();
  mrcal_point2_t q;
  Eigen::Matrix<double, 2, 3, Eigen::RowMajor> dq_dp;
  Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor> dq_dlens(2, lens_states);
  if (!mrcal_project(&q, reinterpret_cast<mrcal_point3_t*>(dq_dp.data()), dq_dlens.data(), &at, 1, &lens,
                     camera.intrinsics.data()))
    return std::nullopt;
  CameraSight sight;
  sight.q_px = {q.x, q.y};
  sight.in_picture = q.x >= 0 && q.y >= 0 && q.x <= camera.width - 1 && q.y <= camera.height - 1;
  sight.by_states.resize(2, lens_states + 6);
  sight.by_states << dq_dlens,
      -dq_dp * pose.R * cross_matrix(point.direction) * right_jacobian(vector_from_rotation(pose.R)),
      point.inverse_m * dq_dp;
  sight.by_direction = dq_dp * pose.R;
  return sight;
}

mrcal_lensmodel_t lens_model_of(const Camera& camera) {
  mrcal_lensmodel_t lens = {};
  mrcal_lensmodel_from_name(&lens, camera.lens_model.c_str());
  return lens;
}

std::vector<Eigen::Vector2d> picture_grid(const Camera& camera, int nx, int ny) {
  std::vector<Eigen::Vector2d> grid;
  for (int j = 0; j < ny; ++j)
    for (int i = 0; i < nx; ++i)
      grid.emplace_back((i + 0.5) * camera.width / nx - 0.5, (j + 0.5) * camera.height / ny - 0.5);
  return grid;
}

}  // namespace stuv
