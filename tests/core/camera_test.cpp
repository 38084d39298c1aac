#include "core/camera.h"

#include <cmath>
#include <fstream>

#include "core/error.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;

namespace {

Camera example() {
  Camera camera;
  camera.name = "cam";
  camera.lens_model = "LENSMODEL_OPENCV4";
  camera.intrinsics = {1060.25, 1059.75, 951.1, 602.3, -0.11, 0.07, 1e-4, -2e-4};
  camera.width = 1920;
  camera.height = 1200;
  camera.cam_from_rig = {rotation_from_vector({0.01, -0.02, 0.3}), {0.1, -0.2, 1.0 / 3.0}};
  return camera;
}

}  // namespace

TEST_CASE("project follows the Brown-Conrady equations") {
  const Camera camera = example();
  const Eigen::Vector3d point(0.3, -0.2, 1.1);
  const double x = point.x() / point.z(), y = point.y() / point.z(), r2 = x * x + y * y;
  const auto* k = &camera.intrinsics[4];
  const double radial = 1 + k[0] * r2 + k[1] * r2 * r2;
  const double xd = x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x);
  const double yd = y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y;
  const Eigen::Vector2d pixel = project(camera, {point})[0];
  CHECK(pixel.x() == Approx(camera.intrinsics[0] * xd + camera.intrinsics[2]).epsilon(1e-13));
  CHECK(pixel.y() == Approx(camera.intrinsics[1] * yd + camera.intrinsics[3]).epsilon(1e-13));
}

TEST_CASE("unproject inverts project") {
  const Camera camera = example();
  std::vector<Eigen::Vector2d> pixels;
  for (int y = 0; y <= 1199; y += 109)
    for (int x = 0; x <= 1919; x += 101) pixels.emplace_back(x, y);
  const std::vector<Eigen::Vector3d> rays = unproject(camera, pixels);
  const std::vector<Eigen::Vector2d> back = project(camera, rays);
  for (std::size_t i = 0; i < pixels.size(); ++i) {
    CHECK(rays[i].norm() == Approx(1));
    CHECK((back[i] - pixels[i]).norm() < 1e-6);
  }
}

TEST_CASE("a camera model survives a round trip to the last bit of its parameters") {
  const test::TempFolder folder;
  const Camera camera = example();
  write_cameramodel(folder / "cam.cameramodel", camera);
  const Camera back = read_cameramodel(folder / "cam.cameramodel");
  CHECK(back.name == "cam");
  CHECK(back.lens_model == camera.lens_model);
  CHECK(back.intrinsics == camera.intrinsics);
  CHECK(back.width == 1920);
  CHECK((back.cam_from_rig.R - camera.cam_from_rig.R).norm() < 1e-15);
  CHECK(back.cam_from_rig.t == camera.cam_from_rig.t);
}

TEST_CASE("mrcal reads our camera models as we do") {
  const test::TempFolder folder;
  const Camera camera = example();
  write_cameramodel(folder / "cam.cameramodel", camera);
  const Eigen::Vector3d point_rig(0.3, 0.4, 2.0);
  const Eigen::Vector2d pixel = project(camera, {camera.cam_from_rig * point_rig})[0];
  const std::string script =
      "import mrcal, numpy as np, sys; m = mrcal.cameramodel(sys.argv[1]); "
      "p = mrcal.transform_point_rt(m.extrinsics_rt_fromref(), np.array((0.3, 0.4, 2.0))); "
      "q = mrcal.project(p, *m.intrinsics()); print('%.9f %.9f' % (q[0], q[1]))";
  const std::string line = "/usr/bin/python3 -c \"" + script + "\" " + (folder / "cam.cameramodel").string() +
                           " >" + (folder / "out").string();
  REQUIRE(std::system(line.c_str()) == 0);
  double x = 0, y = 0;
  std::istringstream(read_text(folder / "out")) >> x >> y;
  CHECK(std::abs(x - pixel.x()) < 1e-7);
  CHECK(std::abs(y - pixel.y()) < 1e-7);
}

TEST_CASE("damaged camera models are refused by name") {
  const test::TempFolder folder;
  const auto file = folder / "cam.cameramodel";
  write_cameramodel(file, example());
  const std::string good = read_text(file);
  const auto replaced = [&](const std::string& from, const std::string& to) {
    std::string text = good;
    text.replace(text.find(from), from.size(), to);
    return text;
  };
  for (const std::string& text :
       {std::string(), std::string("{}"), good.substr(0, good.size() / 2), replaced("OPENCV4", "OPENCV9"),
        replaced("OPENCV4", "OPENCV8"), replaced("1920", "-1"), replaced("1060.25", "nan"),
        replaced("1060.25", "x")}) {
    INFO(text);
    write_text(file, text);
    CHECK_THROWS_WITH(read_cameramodel(file), Contains("cam.cameramodel"));
  }
}

TEST_CASE("mrcal's own models open") {
  STUV_NEED_SHARED_DATA(data);
  const auto folder = data / "mrcal-models/figueroa-overpass-looking-S";
  const Camera opencv8 = read_cameramodel(folder / "opencv8-0.cameramodel");
  CHECK(opencv8.intrinsics.size() == 12);
  const Camera splined = read_cameramodel(folder / "splined-0.cameramodel");
  const Eigen::Vector2d middle(0.5 * splined.width, 0.5 * splined.height);
  CHECK((project(splined, unproject(splined, {middle}))[0] - middle).norm() < 1e-3);
}
