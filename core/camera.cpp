#include "core/camera.h"

#include <fmt/format.h>

#include <cmath>

#include "core/error.h"
extern "C" {
#include <mrcal/mrcal.h>
}

namespace stuv {
namespace {

static_assert(sizeof(mrcal_point2_t) == sizeof(Eigen::Vector2d) &&
              sizeof(mrcal_point3_t) == sizeof(Eigen::Vector3d));

mrcal_lensmodel_t lens_of(const Camera& camera, const std::string& subject) {
  mrcal_lensmodel_t lens;
  if (!mrcal_lensmodel_from_name(&lens, camera.lens_model.c_str()))
    throw Error(subject, fmt::format("lens model '{}' is not one of mrcal's", camera.lens_model),
                "use e.g. LENSMODEL_OPENCV8");
  return lens;
}

}  // namespace

void validate(const Camera& camera, const std::string& subject) {
  const mrcal_lensmodel_t lens = lens_of(camera, subject);
  const int wanted = mrcal_lensmodel_num_params(&lens);
  if (static_cast<int>(camera.intrinsics.size()) != wanted)
    throw Error(
        subject,
        fmt::format("{} has {} parameters, not {}", camera.lens_model, wanted, camera.intrinsics.size()),
        "calibrate this camera again");
  for (const double value : camera.intrinsics)
    if (!std::isfinite(value))
      throw Error(subject, "has lens parameters that are not finite", "calibrate again");
  if (!camera.cam_from_rig.R.allFinite() || !camera.cam_from_rig.t.allFinite())
    throw Error(subject, "has a pose that is not finite", "calibrate again");
  if (camera.width <= 0 || camera.height <= 0)
    throw Error(subject, fmt::format("has a picture size of {}x{}", camera.width, camera.height),
                "calibrate again");
}

std::vector<Eigen::Vector2d> project(const Camera& camera, const std::vector<Eigen::Vector3d>& points_cam) {
  const mrcal_lensmodel_t lens = lens_of(camera, camera.name);
  std::vector<Eigen::Vector2d> pixels(points_cam.size());
  if (!mrcal_project(reinterpret_cast<mrcal_point2_t*>(pixels.data()), nullptr, nullptr,
                     reinterpret_cast<const mrcal_point3_t*>(points_cam.data()),
                     static_cast<int>(points_cam.size()), &lens, camera.intrinsics.data()))
    throw Error(camera.name, "lens model cannot project", "check its parameters");
  return pixels;
}

std::vector<Eigen::Vector3d> unproject(const Camera& camera, const std::vector<Eigen::Vector2d>& pixels) {
  const mrcal_lensmodel_t lens = lens_of(camera, camera.name);
  std::vector<Eigen::Vector3d> rays(pixels.size());
  if (!mrcal_unproject(reinterpret_cast<mrcal_point3_t*>(rays.data()),
                       reinterpret_cast<const mrcal_point2_t*>(pixels.data()),
                       static_cast<int>(pixels.size()), &lens, camera.intrinsics.data()))
    throw Error(camera.name, "lens model cannot be inverted", "check its parameters");
  for (Eigen::Vector3d& ray : rays) ray.normalize();
  return rays;
}

}  // namespace stuv
