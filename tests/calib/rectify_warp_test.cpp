// The warp against its formula in double precision, and its edge cases.

#include <tbb/global_control.h>

#include <cmath>
#include <numbers>

#include "calib/rectify/warp.h"
#include "tests/support/support.h"

using namespace stuv;

namespace {

Camera camera_with(const Eigen::Vector3d& rotation) {
  Camera camera{"cam", "LENSMODEL_OPENCV4", {300, 302, 158.2, 121.3, -0.2, 0.05, 0.001, -0.002}, 320, 240,
                {}};
  camera.cam_from_rig.R = rotation_from_vector(rotation);
  return camera;
}

double lanczos(double d) {
  if (d == 0) return 1;
  if (std::abs(d) >= 3) return 0;
  const double a = std::numbers::pi * d;
  return 3 * std::sin(a) * std::sin(a / 3) / (a * a);
}

/// The formula of warp.h; the inputs are all there.
double literal(const ImageF& in, const Eigen::Vector2d& q, int c) {
  double sum = 0, weights = 0;
  const int x0 = static_cast<int>(std::floor(q.x())), y0 = static_cast<int>(std::floor(q.y()));
  for (int y = y0 - 2; y <= y0 + 3; ++y)
    for (int x = x0 - 2; x <= x0 + 3; ++x) {
      const double w = lanczos(q.x() - x) * lanczos(q.y() - y);
      sum += w * in.at(std::clamp(x, 0, in.width - 1), std::clamp(y, 0, in.height - 1), c);
      weights += w;
    }
  return sum / weights;
}

/// Smooth, and with noise from pixel to pixel.
ImageF pattern(int channels) {
  ImageF image(320, 240, channels);
  std::uint32_t state = 7;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x)
      for (int c = 0; c < channels; ++c) {
        state = state * 1664525U + 1013904223U;
        image.at(x, y, c) = static_cast<float>(0.5 + 0.25 * std::sin(0.21 * x + c) * std::cos(0.17 * y) +
                                               0.1 * (state / 4294967296.0 - 0.5));
      }
  return image;
}

std::vector<Eigen::Vector2d> exact_positions(const Camera& camera, const CommonView& view) {
  std::vector<Eigen::Vector3d> rays;
  for (int y = 0; y < view.height; ++y)
    for (int x = 0; x < view.width; ++x)
      rays.push_back(camera.cam_from_rig.R *
                     Eigen::Vector3d((x - view.cx_px) / view.focal_px, (y - view.cy_px) / view.focal_px, 1)
                         .normalized());
  return project(camera, rays);
}

}  // namespace

TEST_CASE("rectify: the fast warp is its formula for every pixel type, colours and rotations") {
  const CommonView view{310, 150, 120, 333, 247};
  const double quarter = 0.5 * std::numbers::pi;
  for (const Eigen::Vector3d& rotation : {Eigen::Vector3d(0.02, -0.03, 0.04), Eigen::Vector3d(0, 0, quarter),
                                          Eigen::Vector3d(0.01, 0, 2 * quarter)})
    for (const int channels : {1, 3})
      for (const PixelType type : {PixelType::u8, PixelType::u16, PixelType::f16, PixelType::f32}) {
        const Camera camera = camera_with(rotation);
        const Image image = from_float(pattern(channels), type);
        const Image warped = warp_to_common_view(image, camera, view);
        CHECK(warped.type == type);
        const ImageF in = to_float(image), out = to_float(warped);
        const auto q = exact_positions(camera, view);
        // Rounding of the stored value and of positions (0.003 px over a slope of at most 0.2 a pixel).
        const double step = type == PixelType::u8 ? 0.5 / 255 : type == PixelType::f16 ? 5e-4 : 1e-5;
        double worst = 0;
        int seen = 0;
        for (int y = 0; y < view.height; ++y)
          for (int x = 0; x < view.width; ++x) {
            if (!warped.mask.empty() && warped.mask.at(x, y) == 0) continue;
            ++seen;
            for (int c = 0; c < channels; ++c)
              worst = std::max(worst, std::abs(out.at(x, y, c) - literal(in, q[y * view.width + x], c)));
          }
        INFO(name_of(type) << ", " << channels << " channels");
        CHECK(worst < step + 6e-4);
        CHECK(seen > 40'000);
      }
}

TEST_CASE("rectify: a camera turned upside down or on its side keeps its pixels to the bit") {
  Camera camera{"cam", "LENSMODEL_PINHOLE", {300, 300, 159.5, 119.5}, 320, 240, {}};
  const Image image = from_float(pattern(3), PixelType::u16);
  const auto* in = reinterpret_cast<const std::uint16_t*>(image.bytes.data());
  for (const int quarters : {1, 2, 3}) {
    camera.cam_from_rig.R = rotation_from_vector({0, 0, quarters * 0.5 * std::numbers::pi});
    Rig rig;
    rig.cameras = {RigCamera{camera}};
    const CommonView view = common_view(rig);
    CHECK(view.width == (quarters == 2 ? 320 : 240));
    CHECK(view.height == (quarters == 2 ? 240 : 320));
    const Image warped = warp_to_common_view(image, camera, view);
    REQUIRE(warped.mask.empty());
    const auto* out = reinterpret_cast<const std::uint16_t*>(warped.bytes.data());
    int wrong = 0;
    for (int y = 0; y < view.height; ++y)
      for (int x = 0; x < view.width; ++x) {
        const Eigen::Vector3d q = camera.cam_from_rig.R * Eigen::Vector3d(x - view.cx_px, y - view.cy_px, 0);
        const int from_x = static_cast<int>(std::lround(q.x() + 159.5)),
                  from_y = static_cast<int>(std::lround(q.y() + 119.5));
        for (int c = 0; c < 3; ++c)
          wrong += in[(from_y * 320 + from_x) * 3 + c] != out[(y * view.width + x) * 3 + c] ? 1 : 0;
      }
    CHECK(wrong == 0);
  }
}

TEST_CASE("rectify: whole range of 16 bits, and floats beyond 0..1, are kept") {
  const Camera camera{"cam", "LENSMODEL_PINHOLE", {300, 300, 159.5, 119.5}, 320, 240, {}};
  const CommonView view{300, 159.5, 119.5, 320, 240};
  ImageF wide(320, 240, 1);
  for (std::size_t i = 0; i < wide.data.size(); ++i) wide.data[i] = static_cast<float>(i % 65536) / 65535.0F;
  const Image deep = from_float(wide, PixelType::u16);
  CHECK((warp_to_common_view(deep, camera, view).bytes == deep.bytes));
  for (float& v : wide.data) v = 300 * v - 20;
  const Image light = from_float(wide, PixelType::f32);
  CHECK((warp_to_common_view(light, camera, view).bytes == light.bytes));
}

TEST_CASE("rectify: the warp does not depend on the number of threads") {
  const CommonView view{310, 150, 120, 333, 247};
  const Camera camera = camera_with({0.02, -0.03, 0.04});
  const Image image = from_float(pattern(3), PixelType::u8);
  const Image many = warp_to_common_view(image, camera, view);
  const tbb::global_control one(tbb::global_control::max_allowed_parallelism, 1);
  const Image single = warp_to_common_view(image, camera, view);
  CHECK((many.bytes == single.bytes));
  CHECK((many.mask.data == single.mask.data));
}

TEST_CASE("rectify: photometry is corrected before the interpolation, and full pixels stay full") {
  const Camera camera{"cam", "LENSMODEL_PINHOLE", {300, 300, 159.5, 119.5}, 320, 240, {}};
  const CommonView view{300, 159.5, 119.5, 320, 240};
  CameraPhotometry p;
  p.camera = "cam";
  p.determined = true;
  p.gain = {1.1, 0.9, 1.0};
  p.offset = {0.02, 0, -0.01};
  p.falloff = {-0.2, 0.03, -0.02};
  p.centre_px = {159.5, 119.5};
  p.corner_px = std::hypot(159.5, 119.5);
  const ImageF truth = pattern(3);
  ImageF stored = truth;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x)
      for (int c = 0; c < 3; ++c)
        stored.at(x, y, c) = static_cast<float>(
            p.offset[c] + p.gain[c] * falloff_at(p, Eigen::Vector2d(x, y)) * truth.at(x, y, c));
  Image image = from_float(stored, PixelType::u16);
  auto* values = reinterpret_cast<std::uint16_t*>(image.bytes.data());
  values[(100 * 320 + 50) * 3] = 65535;
  values[(100 * 320 + 60) * 3] = 0;
  const LensMap map(camera, view);
  const Image warped = warp_to_common_view(image, map, view, &p);
  const ImageF out = to_float(warped);
  CHECK(out.at(50, 100) == 1);
  CHECK(out.at(60, 100) == 0);
  double worst = 0;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x)
      for (int c = 0; c < 3; ++c)
        if (y != 100 || (x != 50 && x != 60))
          worst = std::max(worst, std::abs(double(out.at(x, y, c)) - truth.at(x, y, c)));
  CHECK(worst < 3e-5);
  CHECK(corrected(p, 1, {10, 20}, stored.at(10, 20, 1)) == Approx(truth.at(10, 20, 1)).margin(1e-6));
}
