// The lens map against the lens model at every pixel.

#include <cmath>

#include "calib/rectify/lens_map.h"
#include "tests/support/support.h"

using namespace stuv;

namespace {

Camera camera_of(const std::string& model, const std::vector<double>& distortion, double focal_px,
                 const Eigen::Vector3d& rotation) {
  Camera camera{"cam", model, {focal_px, focal_px, 322.1, 235.7}, 640, 480, {}};
  camera.intrinsics.insert(camera.intrinsics.end(), distortion.begin(), distortion.end());
  camera.cam_from_rig.R = rotation_from_vector(rotation);
  return camera;
}

/// A splined lens that is a stereographic one but for a smooth bump.
Camera splined_camera() {
  Camera camera{"cam",
                "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=11_Ny=8_fov_x_deg=90",
                {400, 400, 319.5, 239.5},
                640,
                480,
                {}};
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 11; ++x) {
      camera.intrinsics.push_back(0.01 * std::sin(0.8 * x + 0.3 * y));
      camera.intrinsics.push_back(0.01 * std::cos(0.5 * x - 0.6 * y));
    }
  return camera;
}

struct Errors {
  double worst_px = 0;
  int seen = 0, differently_seen = 0;
};

/// Both ways at every pixel. What lies within 0.01 px of the picture's border may be told differently.
Errors compare(const Camera& camera, const CommonView& view) {
  const LensMap map(camera, view);
  Errors errors;
  constexpr int kWidth = 128, kHeight = 64;
  for (int y = 0; y < view.height; y += kHeight)
    for (int x = 0; x < view.width; x += kWidth) {
      const int w = std::min(kWidth, view.width - x), h = std::min(kHeight, view.height - y);
      std::vector<std::int32_t> qx(w * h), qy(w * h);
      map.block(x, y, w, h, qx.data(), qy.data());
      std::vector<Eigen::Vector3d> rays;
      for (int j = 0; j < h; ++j)
        for (int i = 0; i < w; ++i)
          rays.push_back((camera.cam_from_rig.R * Eigen::Vector3d((x + i - view.cx_px) / view.focal_px,
                                                                  (y + j - view.cy_px) / view.focal_px, 1))
                             .normalized());
      const auto exact = project(camera, rays);
      for (int k = 0; k < w * h; ++k) {
        const Eigen::Vector2d& q = exact[k];
        const double inside = std::min({q.x(), q.y(), camera.width - 1 - q.x(), camera.height - 1 - q.y()});
        const bool seen = qx[k] != LensMap::kNowhere;
        errors.seen += seen ? 1 : 0;
        if (seen)
          errors.worst_px = std::max(errors.worst_px,
                                     (Eigen::Vector2d(qx[k], qy[k]) / double(LensMap::kPhases) - q).norm());
        if (std::abs(inside) > 0.01 && seen != (inside > 0)) ++errors.differently_seen;
      }
    }
  return errors;
}

}  // namespace

TEST_CASE("rectify: the lens map is the lens model to 0.01 px") {
  const double quarter = 0.5 * std::numbers::pi;
  const std::vector<Camera> cameras = {
      camera_of("LENSMODEL_PINHOLE", {}, 600, {0.02, -0.03, 0.01}),
      camera_of("LENSMODEL_OPENCV4", {-0.25, 0.1, 0.002, -0.001}, 500, {0.05, 0.02, -0.03}),
      camera_of("LENSMODEL_OPENCV4", {-0.1, 0.02, 0.001, 0.001}, 600, {0, 0, quarter}),
      camera_of("LENSMODEL_OPENCV4", {-0.1, 0.02, 0.001, 0.001}, 600, {0, 0, 2 * quarter}),
      camera_of("LENSMODEL_OPENCV8", {0.3, -0.2, 0.001, -0.002, 0.05, 0.6, -0.1, 0.02}, 420, {0.1, 0, 0}),
      splined_camera()};
  for (const Camera& camera : cameras) {
    const CommonView view{590, 310, 250, 700, 500};
    const Errors errors = compare(camera, view);
    INFO(camera.lens_model << ", step " << LensMap(camera, view).step());
    CHECK(errors.worst_px < 0.01);
    CHECK(errors.seen > 100'000);
    CHECK(errors.differently_seen == 0);
    CHECK(LensMap(camera, view).exact_fraction() < 0.02);
  }
}

TEST_CASE("rectify: blocks of the lens map do not depend on how they are cut") {
  const Camera camera = camera_of("LENSMODEL_OPENCV4", {-0.25, 0.1, 0.002, -0.001}, 500, {0.05, 0.02, -0.03});
  const CommonView view{590, 310, 250, 101, 77};
  const LensMap map(camera, view);
  std::vector<std::int32_t> ax(101 * 77), ay(101 * 77), bx(37 * 45), by(37 * 45);
  map.block(0, 0, 101, 77, ax.data(), ay.data());
  map.block(64, 32, 37, 45, bx.data(), by.data());
  for (int y = 0; y < 45; ++y)
    for (int x = 0; x < 37; ++x) {
      REQUIRE(bx[y * 37 + x] == ax[(y + 32) * 101 + x + 64]);
      REQUIRE(by[y * 37 + x] == ay[(y + 32) * 101 + x + 64]);
    }
}
