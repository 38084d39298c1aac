#include "calib/rectify/rectify.h"

#include <cmath>

#include "calib/rectify/common_view.h"
#include "calib/rectify/warp.h"
#include "core/error.h"
#include "core/image_io.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;

namespace {

Camera camera_with(const Eigen::Vector3d& rotation, std::vector<double> distortion = {0, 0, 0, 0}) {
  Camera camera;
  camera.name = "cam";
  camera.lens_model = "LENSMODEL_OPENCV4";
  camera.intrinsics = {300, 300, 159.5, 119.5};
  camera.intrinsics.insert(camera.intrinsics.end(), distortion.begin(), distortion.end());
  camera.width = 320;
  camera.height = 240;
  camera.cam_from_rig.R = rotation_from_vector(rotation);
  return camera;
}

Rig rig_of(std::vector<Camera> cameras) {
  Rig rig;
  rig.rows = 1;
  rig.cols = static_cast<int>(cameras.size());
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    RigCamera rc;
    rc.camera = cameras[i];
    rc.camera.name = "cam" + std::to_string(i);
    rc.camera.cam_from_rig.t =
        rc.camera.cam_from_rig.R * Eigen::Vector3d(-0.1 * static_cast<double>(i), 0, 0);
    rc.col = static_cast<int>(i);
    rig.cameras.push_back(rc);
  }
  rig.nearest_seen_m = 2;
  return rig;
}

/// A smooth function of the direction in the rig's frame, far away: what every camera of the rig sees.
double sky(const Eigen::Vector3d& ray) {
  const double x = ray.x() / ray.z(), y = ray.y() / ray.z();
  return 0.5 + 0.2 * std::sin(40 * x) + 0.2 * std::cos(50 * y + 10 * x);
}

ImageF picture_of_sky(const Camera& camera) {
  ImageF image(camera.width, camera.height, 1);
  for (int y = 0; y < camera.height; ++y) {
    std::vector<Eigen::Vector2d> pixels;
    for (int x = 0; x < camera.width; ++x) pixels.emplace_back(x, y);
    const auto rays = unproject(camera, pixels);
    for (int x = 0; x < camera.width; ++x)
      image.at(x, y) = static_cast<float>(sky(camera.cam_from_rig.R.transpose() * rays[x]));
  }
  return image;
}

}  // namespace

TEST_CASE("a warped picture shows what the common view would see") {
  const Camera camera = camera_with({0.02, -0.03, 0.04}, {-0.2, 0.05, 0.001, -0.002});
  const CommonView view = common_view(rig_of({camera}));
  const Image warped = warp_to_common_view(from_float(picture_of_sky(camera), PixelType::f32), camera, view);
  const ImageF pixels = to_float(warped);
  double worst = 0;
  std::size_t seen = 0;
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      if (!warped.mask.empty() && warped.mask.at(x, y) == 0) {
        continue;
      }
      ++seen;
      if (x < 8 || y < 8 || x >= view.width - 8 || y >= view.height - 8)
        continue;  // taps beyond the border repeat it
      const double expected = sky({(x - view.cx_px) / view.focal_px, (y - view.cy_px) / view.focal_px, 1});
      worst = std::max(worst, std::abs(pixels.at(x, y) - expected));
    }
  }
  CHECK(worst < 2e-3);
  CHECK(static_cast<double>(seen) > 0.85 * view.width * view.height);
}

TEST_CASE("a camera that is the common view keeps its pixels to the bit") {
  const Camera camera = camera_with({0, 0, 0});
  const CommonView view = common_view(rig_of({camera}));
  CHECK(view.cx_px == Approx(159.5).epsilon(1e-12));
  const Image image = from_float(picture_of_sky(camera), PixelType::u8);
  const Image warped = warp_to_common_view(image, camera, view);
  CHECK(warped.mask.empty());
  CHECK((warped.bytes == image.bytes));
}

TEST_CASE("lens models that fold back bring no ghost of the picture") {
  // Strong barrel distortion: r (1 - 0.6 r^2) comes back to the picture beyond r = 0.75.
  Camera camera = camera_with({0, 0, 0}, {-0.6, 0, 0, 0});
  CommonView wide{100, 159.5, 119.5, 320, 240};
  const Image warped =
      warp_to_common_view(from_float(ImageF(320, 240, 1, 1.0F), PixelType::u8), camera, wide);
  REQUIRE_FALSE(warped.mask.empty());
  CHECK(warped.mask.at(160, 120) == 255);
  CHECK(warped.mask.at(0, 0) == 0);
  CHECK(warped.mask.at(319, 120) == 0);
  // What is there is star-shaped: from every pixel that is there, all of the way to the middle is.
  int torn = 0;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x)
      for (const double part : {0.9, 0.7, 0.5, 0.25})
        torn += warped.mask.at(x, y) != 0 &&
                warped.mask.at(static_cast<int>(std::lround(159.5 + part * (x - 159.5))),
                               static_cast<int>(std::lround(119.5 + part * (y - 119.5)))) == 0;
  CHECK(torn == 0);
}

TEST_CASE("missing pixels bleed into nothing") {
  const Camera camera = camera_with({0.01, 0.02, 0});
  for (const float bad : {1e6F, std::nanf(""), INFINITY}) {
    ImageF pixels(320, 240, 3, 0.25F);
    Image image;
    for (int y = 100; y < 108; ++y)
      for (int x = 100; x < 108; ++x)
        for (int c = 0; c < 3; ++c) pixels.at(x, y, c) = bad;
    image = from_float(pixels, PixelType::f32);
    if (std::isfinite(bad)) {
      image.mask = Mask(320, 240, 1, 255);
      for (int y = 100; y < 108; ++y)
        for (int x = 100; x < 108; ++x) image.mask.at(x, y) = 0;
    } else {
      for (int y = 100; y < 108; ++y)  // from_float may have made NaN a number
        for (int x = 100; x < 108; ++x) {
          const std::size_t at = (static_cast<std::size_t>(y) * 320 + x) * 3;
          std::copy_n(reinterpret_cast<const std::byte*>(&bad), sizeof bad,
                      image.bytes.data() + at * sizeof bad);
        }
    }
    CommonView view{300, 159.5, 119.5, 320, 240};
    const Image warped = warp_to_common_view(image, camera, view);
    const ImageF out = to_float(warped);
    int missing = 0;
    for (int y = 0; y < 240; ++y)
      for (int x = 0; x < 320; ++x) {
        const bool there = warped.mask.at(x, y) != 0;
        missing += x > 60 && x < 260 && y > 60 && y < 200 && !there ? 1 : 0;
        for (int c = 0; c < 3; ++c) {
          if (there) REQUIRE(out.at(x, y, c) == Approx(0.25).margin(1e-5));
          if (!there) REQUIRE(out.at(x, y, c) == 0);
        }
      }
    CHECK(missing >= 81);
    CHECK(missing <= 130);
  }
}

TEST_CASE("masked pixels stay missing") {
  const Camera camera = camera_with({0, 0, 0});
  Image image = from_float(ImageF(320, 240, 3, 0.5F), PixelType::u16);
  image.mask = Mask(320, 240, 1, 255);
  image.mask.at(100, 100) = 0;
  const Image warped = warp_to_common_view(image, camera, common_view(rig_of({camera})));
  REQUIRE_FALSE(warped.mask.empty());
  CHECK(warped.mask.at(100, 100) == 0);
  CHECK(warped.mask.at(103, 100) == 255);
  CHECK(warped.type == PixelType::u16);
}

TEST_CASE("cameras that look aside shift the principal point, cameras that look away are refused") {
  const CommonView view = common_view(rig_of({camera_with({0, 0.1, 0}), camera_with({0, 0.1, 0})}));
  // The left and right ends of the cameras' field of view lie symmetrically in the common picture.
  const double half = std::atan(159.5 / 300);
  const double left = view.cx_px + view.focal_px * std::tan(-half - 0.1),
               right = view.cx_px + view.focal_px * std::tan(half - 0.1);
  CHECK(0.5 * (left + right) == Approx(159.5).margin(1e-6));
  CHECK_THROWS_WITH(common_view(rig_of({camera_with({0, 2.5, 0})})), Contains("cam0"));
  CHECK_THROWS_AS(common_view(Rig{}), Error);
}

TEST_CASE("rectify makes a light field and leaves holes where pictures are missing") {
  const test::TempFolder folder;
  const Rig rig = rig_of({camera_with({0, 0, 0}), camera_with({0.01, 0, 0}), camera_with({0, 0.01, 0})});
  write_image(folder / "a.png", from_float(picture_of_sky(rig.cameras[0].camera), PixelType::u8));
  write_image(folder / "c.png", from_float(picture_of_sky(rig.cameras[2].camera), PixelType::u8));
  Recording recording;
  recording.folder = folder.path();
  recording.cameras = {{"cam0", 0, 0}, {"cam1", 0, 1}, {"cam2", 0, 2}};
  FrameSet set{
      "s",
      {{FrameStatus::ok, folder / "a.png", -1, -1, {}}, {}, {FrameStatus::ok, folder / "c.png", -1, -1, {}}}};
  std::filesystem::create_directory(folder / "scene");
  rectify(recording, set, rig, folder / "scene", {}, {});
  const LightField lf = open_light_field(folder / "scene");
  REQUIRE(lf.views.size() == 2);
  CHECK(lf.views[1].col == 2);
  CHECK(lf.views[1].s == Approx(0.2));
  CHECK(lf.metric);
  CHECK(lf.d_min == 0);
  CHECK(lf.d_max == Approx(lf.focal_px / (0.95 * 2)));

  write_image(folder / "c.png", from_float(ImageF(100, 100, 1), PixelType::u8));
  CHECK_THROWS_WITH(rectify(recording, set, rig, folder / "scene", {}, {}),
                    Contains("c.png") && Contains("100x100"));
  set.frames = {{}, {}, {}};
  CHECK_THROWS_WITH(rectify(recording, set, rig, folder / "scene", {}, {}), Contains("no picture"));
}

TEST_CASE("rectify: the common field is whole in every view, and no larger one is") {
  const Rig rig =
      rig_of({camera_with({0.02, 0.05, 0.03}, {-0.15, 0.03, 0, 0}),
              camera_with({-0.03, -0.04, 0.01}, {-0.12, 0.02, 0, 0}), camera_with({0.01, 0, 1.6})});
  CommonViewOptions options;
  options.field = CommonViewOptions::Field::common;
  const CommonView common = common_view(rig, options);
  options.field = CommonViewOptions::Field::all;
  const CommonView all = common_view(rig, options);
  CHECK(common.width > 150);
  CHECK(all.width > common.width);
  CHECK(all.height > common.height);
  CommonView larger = common;  // by two pixels to every side
  larger.cx_px += 2, larger.cy_px += 2, larger.width += 4, larger.height += 4;
  int lacking = 0;
  bool outside_all = false;
  for (const RigCamera& rc : rig.cameras) {
    const Image white = from_float(ImageF(320, 240, 1, 1.0F), PixelType::u8);
    CHECK(warp_to_common_view(white, rc.camera, common).mask.empty());
    lacking += warp_to_common_view(white, rc.camera, larger).mask.empty() ? 0 : 1;
    // Every camera's own corners lie in the field of all.
    for (const auto& ray : unproject(rc.camera, {{0, 0}, {319, 0}, {0, 239}, {319, 239}})) {
      const Eigen::Vector3d r = rc.camera.cam_from_rig.R.transpose() * ray;
      const double x = all.cx_px + all.focal_px * r.x() / r.z(), y = all.cy_px + all.focal_px * r.y() / r.z();
      outside_all |= x < -1.01 || y < -1.01 || x > all.width + 0.01 || y > all.height + 0.01;
    }
  }
  CHECK(lacking > 0);
  CHECK_FALSE(outside_all);
}

TEST_CASE("rectify: focal length, size and crop are taken at their word") {
  const Rig rig = rig_of({camera_with({0.02, 0.05, 0.03}), camera_with({-0.03, -0.04, 0.01})});
  const CommonView whole = common_view(rig);
  CommonViewOptions options;
  options.crop = CommonViewOptions::Crop{40, 30, 100, 80};
  const CommonView crop = common_view(rig, options);
  CHECK(crop.width == 100);
  CHECK(crop.cx_px == Approx(whole.cx_px - 40));
  CHECK(crop.cy_px == Approx(whole.cy_px - 30));
  // A crop is a part of the whole, to one level.
  const Image image = from_float(picture_of_sky(rig.cameras[0].camera), PixelType::u8);
  const Image a = warp_to_common_view(image, rig.cameras[0].camera, whole),
              b = warp_to_common_view(image, rig.cameras[0].camera, crop);
  int different = 0;
  for (int y = 0; y < 80; ++y)
    for (int x = 0; x < 100; ++x)
      different += std::abs(int(a.bytes[(y + 30) * whole.width + x + 40]) - int(b.bytes[y * 100 + x])) > 1;
  CHECK(different == 0);
  options = {};
  options.focal_px = 600;
  CHECK(common_view(rig, options).width == 640);
  options.width = 200, options.height = 100;
  const CommonView sized = common_view(rig, options);
  CHECK(sized.width == 200);
  CHECK((sized.cx_px - 99.5) / 600 == Approx((whole.cx_px - 159.5) / 300));
  options = {};
  options.crop = CommonViewOptions::Crop{300, 0, 100, 80};
  CHECK_THROWS_WITH(common_view(rig, options), Contains("320x240"));
}

TEST_CASE("rectify: cameras without a common field are named") {
  const Rig rig = rig_of({camera_with({0, 0.6, 0}), camera_with({0, 0, 0}), camera_with({0, -0.6, 0})});
  CommonViewOptions options;
  options.field = CommonViewOptions::Field::common;
  CHECK_THROWS_WITH(common_view(rig, options), Contains("cam0 and cam2"));
  CHECK_NOTHROW(common_view(rig));
}
