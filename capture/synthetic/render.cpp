#include "capture/synthetic/render.h"

#include <array>
#include <cmath>

#include "capture/synthetic/lens_grid.h"
#include "core/parallel.h"

namespace stuv::synthetic {
namespace {

/// Differences of light between quarters of a pixel above which it is sampled more finely.
constexpr float kContrast = 0.03F;

class PixelRenderer {
 public:
  PixelRenderer(const Scene& scene, const Camera& camera, std::int64_t time_ns)
      : scene_(scene),
        lens_(camera),
        time_ns_(time_ns),
        rig_from_cam_(camera.cam_from_rig.inverse()),
        angle_rad_(1 / camera.intrinsics[0]) {}

  void render_row(int y, TruePicture& picture) const {
    // Rows of samples: the centre's, two of quarters, four of sixteenths.
    const LensGrid::Row centre(lens_, y);
    const std::array<LensGrid::Row, 2> coarse = {LensGrid::Row(lens_, y - 0.25),
                                                 LensGrid::Row(lens_, y + 0.25)};
    const std::array<LensGrid::Row, 4> fine = {
        LensGrid::Row(lens_, y - 0.375), LensGrid::Row(lens_, y - 0.125), LensGrid::Row(lens_, y + 0.125),
        LensGrid::Row(lens_, y + 0.375)};
    for (int x = 0; x < picture.colour.width; ++x) {
      const Eigen::Vector2d ray = centre(x);
      const Shade middle = sample(ray, 0.5);
      picture.depth.at(x, y) = static_cast<float>(middle.distance_m / ray.homogeneous().norm());
      const Eigen::Vector3f colour = pixel(coarse, fine, x, middle);
      for (int c = 0; c < 3; ++c) picture.colour.at(x, y, c) = colour[c];
    }
  }

 private:
  Shade sample(const Eigen::Vector2d& ray, double pixels_apart) const {
    const Eigen::Vector3d direction = (rig_from_cam_.R * ray.homogeneous()).normalized();
    return scene_.trace({rig_from_cam_.t, direction, pixels_apart * angle_rad_}, time_ns_);
  }

  Eigen::Vector3f pixel(const std::array<LensGrid::Row, 2>& coarse, const std::array<LensGrid::Row, 4>& fine,
                        int x, const Shade& middle) const {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero(), low = middle.colour, high = middle.colour;
    bool edge = false;
    for (const LensGrid::Row& row : coarse)
      for (const double offset : {-0.25, 0.25}) {
        const Shade shade = sample(row(x + offset), 0.5);
        sum += shade.colour;
        low = low.cwiseMin(shade.colour);
        high = high.cwiseMax(shade.colour);
        edge |= shade.object != middle.object;
      }
    if (!edge && (high - low).maxCoeff() < kContrast) return sum / 4;
    sum.setZero();
    for (const LensGrid::Row& row : fine)
      for (const double offset : {-0.375, -0.125, 0.125, 0.375}) sum += sample(row(x + offset), 0.25).colour;
    return sum / 16;
  }

  const Scene& scene_;
  LensGrid lens_;
  std::int64_t time_ns_;
  Pose rig_from_cam_;
  double angle_rad_;
};

}  // namespace

TruePicture render_picture(const Scene& scene, const Camera& camera, std::int64_t time_ns) {
  const PixelRenderer renderer(scene, camera, time_ns);
  TruePicture picture{ImageF(camera.width, camera.height, 3), ImageF(camera.width, camera.height, 1)};
  parallel_for(camera.height, [&](int y) { renderer.render_row(y, picture); });
  return picture;
}

}  // namespace stuv::synthetic
