#include "calib/tracking/lens.h"

#include <algorithm>
#include <cmath>
#include <limits>

extern "C" {
#include <mrcal/mrcal.h>
}

namespace stuv::tracking {
namespace {

/// The largest tan^2 of the angle to the axis that the picture's border sees; cameras that see beyond 80
/// degrees are cut there.
double widest_tan2(const Camera& camera) {
  std::vector<Eigen::Vector2d> border;
  for (int i = 0; i <= 8; ++i) {
    const double x = (camera.width - 1) * i / 8.0, y = (camera.height - 1) * i / 8.0;
    border.insert(border.end(), {{x, 0}, {x, camera.height - 1.0}, {0, y}, {camera.width - 1.0, y}});
  }
  constexpr double most = 32;  // tan(80 degrees)^2
  double widest = 0;
  for (const Eigen::Vector3d& ray : unproject(camera, border))
    widest = std::max(widest, ray.z() > 0 ? ray.head<2>().squaredNorm() / (ray.z() * ray.z()) : most);
  return std::min(most, widest);
}

}  // namespace

Lens::Lens(const Camera& camera) : camera_(camera), width_(camera.width), height_(camera.height) {
  validate(camera, camera.name);
  focal_ = {camera.intrinsics[0], camera.intrinsics[1]};
  centre_ = {camera.intrinsics[2], camera.intrinsics[3]};
  focal_px_ = std::sqrt(std::abs(camera.intrinsics[0] * camera.intrinsics[1]));
  pinhole_ = camera.lens_model == "LENSMODEL_PINHOLE";
  const auto mrcal = std::make_shared<mrcal_lensmodel_t>();
  mrcal_lensmodel_from_name(mrcal.get(), camera_.lens_model.c_str());
  mrcal_ = mrcal;
  most_tan2_ = pinhole_ ? std::numeric_limits<double>::infinity() : widest_tan2(camera) * 16 / 9;
}

bool Lens::project_bent(const Eigen::Vector3d& x, Eigen::Vector2d& q,
                        Eigen::Matrix<double, 2, 3>* derivative) const {
  if (!(x.z() > 0) || !(x.head<2>().squaredNorm() <= most_tan2_ * x.z() * x.z())) return false;
  mrcal_point2_t pixel;
  mrcal_point3_t gradient[2];
  const mrcal_point3_t point = {{x.x(), x.y(), x.z()}};
  if (!mrcal_project(&pixel, derivative != nullptr ? gradient : nullptr, nullptr, &point, 1,
                     static_cast<const mrcal_lensmodel_t*>(mrcal_.get()), camera_.intrinsics.data()))
    return false;
  q = {pixel.x, pixel.y};
  if (derivative != nullptr)
    *derivative << gradient[0].x, gradient[0].y, gradient[0].z, gradient[1].x, gradient[1].y, gradient[1].z;
  return q.allFinite();
}

}  // namespace stuv::tracking
