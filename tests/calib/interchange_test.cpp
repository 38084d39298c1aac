#include <fmt/format.h>

#include <cmath>
#include <map>
#include <sstream>

#include "calib/interchange/camera_list.h"
#include "calib/interchange/corners_vnl.h"
#include "calib/interchange/foreign_lens.h"
#include "calib/interchange/npy.h"
#include "capture/synthetic/rig.h"
#include "core/error.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;
namespace fs = std::filesystem;

namespace {

constexpr CameraFormat kAll[] = {CameraFormat::mrcal,  CameraFormat::opencv,     CameraFormat::kalibr,
                                 CameraFormat::colmap, CameraFormat::nerfstudio, CameraFormat::llff};

/// Cameras of a rough 2x3 rig: turned by degrees, no two lenses alike.
CameraList some_cameras() {
  synthetic::RigOptions options;
  options.rows = 2;
  options.cols = 3;
  options.jitter.direction_rad = 0.1;
  CameraList cameras = cameras_of(synthetic::make_rig(options).rig);
  for (ListedCamera& c : cameras) {
    c.camera.intrinsics[1] *= 1.01;
    c.near_m = 0.8;
    c.far_m = 5;
  }
  return cameras;
}

/// What LLFF can hold.
CameraList pinholes() {
  CameraList cameras = some_cameras();
  for (ListedCamera& c : cameras) {
    Camera& k = c.camera;
    k.lens_model = "LENSMODEL_PINHOLE";
    k.intrinsics = {600, 600, 0.5 * (k.width - 1), 0.5 * (k.height - 1)};
  }
  return cameras;
}

/// Kalibr has no frame but its first camera's.
CameraList seen_from_the_first(CameraList cameras) {
  const Pose first_from_rig = cameras.front().camera.cam_from_rig;
  for (ListedCamera& c : cameras) c.camera.cam_from_rig = c.camera.cam_from_rig * first_from_rig.inverse();
  return cameras;
}

CameraList cameras_for(CameraFormat format) {
  if (format == CameraFormat::kalibr) return seen_from_the_first(some_cameras());
  return format == CameraFormat::llff ? pinholes() : some_cameras();
}

const std::vector<Eigen::Vector3d> kPoints = {
    {0.1, -0.2, 2}, {-0.4, 0.3, 1.5}, {0.7, 0.5, 4}, {0, 0.01, 100}};

Eigen::Vector2d pixel_of(const Camera& camera, const Eigen::Vector3d& point) {
  return project(camera, {camera.cam_from_rig * point})[0];
}

fs::path target_of(const test::TempFolder& folder, CameraFormat format) {
  const std::string file = file_name_of(format);
  if (!file.empty()) return folder / file;
  fs::create_directories(folder / "out");
  return folder / "out";
}

/// Pixels by camera as tests/calib/read_cameras.py finds them.
std::map<std::string, std::vector<Eigen::Vector2d>> read_elsewhere(CameraFormat format, const fs::path& path,
                                                                   const test::TempFolder& folder) {
  std::string line = fmt::format("/usr/bin/python3 {}/tests/calib/read_cameras.py {} {}", STUV_SOURCE_DIR,
                                 name_of(format), path.string());
  for (const Eigen::Vector3d& p : kPoints) line += fmt::format(" {},{},{}", p.x(), p.y(), p.z());
  INFO(line);
  REQUIRE(std::system((line + " > " + (folder / "pixels").string()).c_str()) == 0);
  std::istringstream in(read_text(folder / "pixels"));
  std::map<std::string, std::vector<Eigen::Vector2d>> pixels;
  std::string name;
  for (double x = 0, y = 0; in >> name >> x >> y;) pixels[name].emplace_back(x, y);
  return pixels;
}

}  // namespace

TEST_CASE("a point falls on the same pixel through every format, as an independent reader sees it") {
  for (const CameraFormat format : kAll) {
    const test::TempFolder folder;
    const CameraList cameras = cameras_for(format);
    LensFits fits;
    const fs::path target = target_of(folder, format);
    write_cameras(target, format, cameras, fits);
    CHECK(fits.made.empty());
    const auto pixels = read_elsewhere(format, target, folder);
    REQUIRE(pixels.size() == cameras.size());
    for (std::size_t i = 0; i < cameras.size(); ++i) {
      const std::string name =
          format == CameraFormat::llff ? fmt::format("view{:03}", i) : cameras[i].camera.name;
      REQUIRE(pixels.count(name) == 1);
      for (std::size_t k = 0; k < kPoints.size(); ++k) {
        INFO(name_of(format) << " " << name << " point " << k);
        CHECK((pixels.at(name)[k] - pixel_of(cameras[i].camera, kPoints[k])).norm() < 1e-7);
      }
    }
  }
}

TEST_CASE("what was written reads back the same") {
  for (const CameraFormat format : kAll) {
    const test::TempFolder folder;
    const CameraList cameras = cameras_for(format);
    LensFits fits;
    const fs::path target = target_of(folder, format);
    write_cameras(target, format, cameras, fits);
    REQUIRE(recognise_cameras(target) == format);
    const CameraList back = read_cameras(target, format, fits);
    REQUIRE(back.size() == cameras.size());
    for (std::size_t i = 0; i < back.size(); ++i) {
      const Camera &a = cameras[i].camera, &b = back[i].camera;
      INFO(name_of(format) << " " << a.name);
      if (format != CameraFormat::llff) CHECK(b.name == a.name);
      CHECK(b.lens_model == a.lens_model);
      CHECK(b.width == a.width);
      CHECK(b.height == a.height);
      REQUIRE(b.intrinsics.size() == a.intrinsics.size());
      for (std::size_t k = 0; k < a.intrinsics.size(); ++k)
        CHECK(std::abs(b.intrinsics[k] - a.intrinsics[k]) < 1e-9);
      CHECK((b.cam_from_rig.R - a.cam_from_rig.R).norm() < 1e-12);
      CHECK((b.cam_from_rig.t - a.cam_from_rig.t).norm() < 1e-12);
    }
    if (format == CameraFormat::llff) CHECK(back[2].far_m == 5);
  }
}

TEST_CASE("a rig made of somebody's cameras knows its lattice, and does not pretend to know sigmas") {
  CameraList cameras = some_cameras();
  // Elsewhere, turned, and in millimetres.
  const Pose file_from_rig{rotation_from_vector({0.3, -2, 0.5}), {10, 20, 30}};
  CameraList moved = cameras;
  for (ListedCamera& c : moved) {
    Pose pose = c.camera.cam_from_rig * file_from_rig.inverse();
    pose.t *= 1000;
    c.camera.cam_from_rig = pose;
    c.near_m *= 1000, c.far_m *= 1000;
  }
  const Rig rig = rig_of(moved, 0.001, "test");
  CHECK(rig.rows == 2);
  CHECK(rig.cols == 3);
  CHECK(rig.s_step_m.x() == Approx(0.03).epsilon(0.1));
  CHECK(rig.nearest_seen_m == Approx(0.8));
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    CHECK(rig.cameras[i].row == static_cast<int>(i) / 3);
    CHECK(rig.cameras[i].col == static_cast<int>(i) % 3);
    CHECK(rig.cameras[i].position_sigma_m.hasNaN());
    const Pose a = rig.cameras[i].camera.cam_from_rig * rig.cameras[0].camera.cam_from_rig.inverse(),
               b = cameras[i].camera.cam_from_rig * cameras[0].camera.cam_from_rig.inverse();
    CHECK((a.R - b.R).norm() < 1e-9);
    CHECK((a.t - b.t).norm() < 1e-9);
  }
  const test::TempFolder folder;
  fs::create_directory(folder / "rig");
  write_rig(folder / "rig", rig);
  CHECK(read_json(folder / "rig/rig.json")["cameras"][0]["position_sigma_m"].is_null());
  CHECK(read_json(folder / "rig/rig.json")["centre_covariance_m2"].is_null());
  CHECK(read_rig(folder / "rig").cameras[0].position_sigma_m.hasNaN());
  CHECK_THROWS_WITH(rig_of({}, 1, "nothing.yaml"), Contains("nothing.yaml") && Contains("no camera"));
}

TEST_CASE("fisheye lenses pass through mrcal's splined model and back within what is stated") {
  FisheyeLens fisheye;
  fisheye.parameters = {320, 322, 400, 300, 0.02, -0.01, 0.003, -0.0005};
  // Every pixel of 800x600 is seen at up to 90 degrees and more.
  const auto corner = unproject(fisheye, {0, 0});
  REQUIRE(corner);
  CHECK(std::acos(corner->z()) > 80 * M_PI / 180);
  double worst_px = 0;
  Camera camera = splined_from_fisheye(fisheye, 800, 600, worst_px);
  CHECK(worst_px < 0.005);
  for (const Eigen::Vector2d& q : {Eigen::Vector2d(123, 456), {700, 20}, {400, 300}})
    CHECK((project(camera, {*unproject(fisheye, q)})[0] - q).norm() <= 1.5 * worst_px);

  camera.name = "fish";
  for (const CameraFormat format : {CameraFormat::kalibr, CameraFormat::colmap, CameraFormat::nerfstudio}) {
    const test::TempFolder folder;
    LensFits fits;
    const fs::path target = target_of(folder, format);
    write_cameras(target, format, {{camera, "fish.png"}}, fits);
    REQUIRE(fits.made.size() == 1);
    CHECK(fits.made[0].worst_px < 0.01);
    LensFits back;
    const CameraList read = read_cameras(target, format, back);
    REQUIRE(back.made.size() == 1);
    for (const Eigen::Vector2d& q : {Eigen::Vector2d(30, 40), {700, 20}, {250, 590}}) {
      const Eigen::Vector3d ray = *unproject(fisheye, q);
      CHECK((project(read[0].camera, {ray})[0] - q).norm() < 0.01);
    }
  }
}

TEST_CASE(
    "a lens that a format lacks is refused in one line with its error, or fitted when that is allowed") {
  CameraList cameras = some_cameras();
  Camera& odd = cameras[1].camera;
  odd.lens_model = "LENSMODEL_OPENCV8";
  odd.intrinsics.insert(odd.intrinsics.end(), {0.02, 0.1, 0.05, -0.02});
  for (const CameraFormat format : {CameraFormat::kalibr, CameraFormat::llff}) {
    const test::TempFolder folder;
    LensFits fits;
    const fs::path target = target_of(folder, format);
    const CameraList one = {cameras[1]};
    CHECK_THROWS_WITH(write_cameras(target, format, one, fits),
                      Contains("camera r0c1") && Contains("px") && Contains("--fit-px"));
    CHECK_FALSE(fs::exists(target));
    fits.most_px = 50;
    write_cameras(target, format, one, fits);
    REQUIRE(fits.made.size() == 1);
    const CameraList back = read_cameras(target, format, fits);
    double worst = 0;
    for (double x = 0; x <= 639; x += 71)
      for (double y = 0; y <= 479; y += 479.0 / 6) {
        const Eigen::Vector3d ray = unproject(odd, {{x, y}})[0];
        worst = std::max(worst, (project(back[0].camera, {ray})[0] - Eigen::Vector2d(x, y)).norm());
      }
    INFO(name_of(format) << " stated " << fits.made[0].worst_px << ", found " << worst);
    CHECK(worst <= fits.made[0].worst_px * 1.01 + 1e-6);
    CHECK(worst > 0.3 * fits.made[0].worst_px);
  }
  // COLMAP has it.
  const test::TempFolder folder;
  LensFits fits;
  write_cameras(target_of(folder, CameraFormat::colmap), CameraFormat::colmap, cameras, fits);
  CHECK(fits.made.empty());
}

TEST_CASE("files of other tools' own making are understood") {
  const test::TempFolder folder;
  LensFits fits;
  // COLMAP without rigs, one lens for both pictures, points after the first only, blank lines at the end.
  fs::create_directories(folder / "model");
  write_text(folder / "model/cameras.txt", "# Camera list\n3 SIMPLE_RADIAL 640 480 500 320 240 -0.1\n");
  write_text(folder / "model/images.txt",
             "# Image list\n1 1 0 0 0 0 0 0 3 left/im.png\n10.5 20.5 -1 3 4 7\n2 1 0 0 0 -0.1 0 0 3 "
             "right/im.png\n\n\n");
  const CameraList colmap = read_cameras(folder / "model", CameraFormat::colmap, fits);
  REQUIRE(colmap.size() == 2);
  CHECK(colmap[0].camera.name == "left");
  CHECK(colmap[1].camera.name == "right");
  CHECK(colmap[1].camera.intrinsics == std::vector<double>{500, 500, 319.5, 239.5, -0.1, 0, 0, 0});
  CHECK(colmap[1].camera.cam_from_rig.centre().x() == Approx(0.1));

  // nerfstudio with one lens at the top.
  write_text(folder / "transforms.json",
             R"({"camera_model": "OPENCV", "w": 640, "h": 480, "fl_x": 500, "fl_y": 501,
    "cx": 320, "cy": 240, "k1": -0.1, "k2": 0.01, "p1": 0, "p2": 0, "frames": [{"file_path": "images/a.png",
    "transform_matrix": [[1,0,0,2],[0,1,0,3],[0,0,1,4],[0,0,0,1]]}]})");
  const CameraList nerf = read_cameras(folder.path(), CameraFormat::nerfstudio, fits);
  REQUIRE(nerf.size() == 1);
  CHECK((nerf[0].camera.cam_from_rig.centre() - Eigen::Vector3d(2, 3, 4)).norm() < 1e-12);
  // It looks along -z of the world, y of the world is up.
  CHECK(pixel_of(nerf[0].camera, {2, 3, 0}).x() == Approx(319.5));
  CHECK(pixel_of(nerf[0].camera, {2, 3.5, 0}).y() < 239.5);

  // numpy's own files: float32, by columns.
  REQUIRE(std::system(("/usr/bin/python3 -c \"import numpy; numpy.save('" + (folder / "a.npy").string() +
                       "', numpy.asfortranarray(numpy.arange(6, dtype='f4').reshape(2, 3)))\"")
                          .c_str()) == 0);
  const RowMatrix m = read_npy(folder / "a.npy");
  REQUIRE(m.rows() == 2);
  CHECK(m(1, 0) == 3);
  CHECK(m(0, 2) == 2);
}

TEST_CASE("damaged camera files are named, never read as something else") {
  const test::TempFolder folder;
  LensFits fits;
  const auto fails = [&](CameraFormat format, const std::string& name, const std::string& text,
                         const std::string& says) {
    write_text(folder / name, text);
    INFO(text);
    CHECK_THROWS_WITH(read_cameras(folder / name, format, fits), Contains(name) && Contains(says));
  };
  fails(CameraFormat::opencv, "a.yml", "%YAML:1.0\n---\nimage_width: 640\n", "image_width, image_height");
  fails(CameraFormat::opencv, "b.yml", "{ this is : [ no file", "OpenCV");
  fails(CameraFormat::kalibr, "c.yaml", "cam0:\n  camera_model: omni\n  distortion_model: radtan\n", "omni");
  fails(CameraFormat::kalibr, "d.yaml", "cam0: [1, 2\n", "camchain");
  fails(CameraFormat::kalibr, "e.yaml", "cam0:\n  camera_model: pinhole\n", "distortion_model");
  fails(CameraFormat::nerfstudio, "f.json", R"({"frames": [{"file_path": "a.png"}]})", "has no w");
  fails(CameraFormat::nerfstudio, "g.json", R"({"frames": 7})", "transforms.json");
  fails(CameraFormat::llff, "h.npy", "\x93NUMPY", "no .npy");
  write_npy(folder / "i.npy", RowMatrix::Zero(2, 5));
  CHECK_THROWS_WITH(read_cameras(folder / "i.npy", CameraFormat::llff, fits), Contains("5 columns"));
  write_npy(folder / "j.npy", RowMatrix::Zero(2, 17));
  CHECK_THROWS_WITH(read_cameras(folder / "j.npy", CameraFormat::llff, fits), Contains("rotation"));
  fs::create_directories(folder / "model");
  write_text(folder / "model/images.txt", "1 1 0 0 0 0 0 x 3 a.png\n\n");
  write_text(folder / "model/cameras.txt", "3 PINHOLE 640 480 500 500 320 240\n");
  CHECK_THROWS_WITH(read_cameras(folder / "model", CameraFormat::colmap, fits), Contains("images.txt:1"));
  write_text(folder / "model/images.txt", "1 1 0 0 0 0 0 0 3 a.png\n\n");
  write_text(folder / "model/cameras.txt", "3 FOV 640 480 500 500 320 240 0.9\n");
  CHECK_THROWS_WITH(read_cameras(folder / "model", CameraFormat::colmap, fits), Contains("FOV"));
}

TEST_CASE("corners.vnl goes both ways, and mrcal reads it") {
  const test::TempFolder folder;
  std::vector<PictureCorners> pictures(5);
  const char* const names[] = {"frame1-cam0.png", "frame1-cam1.png", "frame2-cam0.png", "frame2-cam1.png",
                               "frame3-cam1.png"};
  for (int i = 0; i < 5; ++i) pictures[i].picture = names[i];
  for (int k = 0; k < 6; ++k)
    for (const int i : {0, 1, 2, 3}) {
      pictures[i].corners_px.emplace_back(100 * i + 10.0 / 3 * k, 20 + k * k / 7.0);
      pictures[i].weights.push_back(k == 4 ? 0.25 : 1);
    }
  pictures[1].corners_px[2].setConstant(std::nan(""));
  pictures[1].weights[2] = 0;
  write_corners_vnl(folder / "corners.vnl", pictures);
  const std::vector<PictureCorners> back = read_corners_vnl(folder / "corners.vnl", 6);
  REQUIRE(back.size() == 5);
  CHECK(back[4].corners_px.empty());
  CHECK(back[1].corners_px[2].hasNaN());
  for (int k = 0; k < 6; ++k) {
    CHECK(back[0].corners_px[k] == pictures[0].corners_px[k]);
    CHECK(back[1].weights[k] == pictures[1].weights[k]);
  }
  const std::string python =
      "import mrcal, numpy; o, i, f = mrcal.compute_chessboard_corners(3, 2, globs_per_camera=('*-cam0.png', "
      "'*-cam1.png'), corners_cache_vnl='" +
      (folder / "corners.vnl").string() +
      "', jobs=-1, weight_column_kind='weight'); print(len(f), repr(float(o[0,1,0,0])), float(o[0,1,1,2]), "
      "float(o[1,0,2,2]))";
  REQUIRE(std::system(("/usr/bin/python3 -c \"" + python + "\" > " + (folder / "seen").string()).c_str()) ==
          0);
  std::istringstream seen(read_text(folder / "seen"));
  int count = 0;
  double x = 0, light = 0, lost = 0;
  seen >> count >> x >> light >> lost;
  CHECK(count == 4);
  CHECK(x == pictures[0].corners_px[3].x());
  CHECK(light == 0.25);
  CHECK(lost <= 0);

  write_text(folder / "levels.vnl",
             "## made by hand\n# filename x y level\na.png 1 2 0\na.png 3 4 1\na.png 5 6 -\nb.png - -\n");
  const std::vector<PictureCorners> levels = read_corners_vnl(folder / "levels.vnl", 3);
  REQUIRE(levels.size() == 2);
  CHECK(levels[0].weights == std::vector<double>{1, 0.5, 0});
  CHECK(levels[1].corners_px.empty());
  CHECK_THROWS_WITH(read_corners_vnl(folder / "levels.vnl", 4), Contains("3 corners of a.png"));
  write_text(folder / "bad.vnl", "# filename x y level\na.png 1 zwei 0\n");
  CHECK_THROWS_WITH(read_corners_vnl(folder / "bad.vnl", 1), Contains("bad.vnl:2") && Contains("zwei"));
}

TEST_CASE("pictures of a corners.vnl are found in a recording by the ends of their paths") {
  Recording recording;
  recording.folder = "/data/rec";
  recording.cameras = {{"c0", 0, 0}, {"c1", 0, 1}};
  for (const char* set : {"s0", "s1"}) {
    FrameSet frames{set, {}};
    for (const char* camera : {"c0", "c1"})
      frames.frames.push_back(
          {FrameStatus::ok, fmt::format("/data/rec/sets/{}/{}.png", set, camera), -1, -1, {}});
    recording.sets.push_back(frames);
  }
  const auto places = places_of({{"s1/c0.png", {}, {}}, {"./sets/s0/c1.png", {}, {}}, {"x/c1.png", {}, {}}},
                                recording, "corners.vnl");
  CHECK((places[0].set == 1 && places[0].camera == 0));
  CHECK((places[1].set == 0 && places[1].camera == 1));
  CHECK(places[2].set == -1);
  CHECK_THROWS_WITH(places_of({{"c0.png", {}, {}}}, recording, "corners.vnl"), Contains("several"));
  CHECK_THROWS_WITH(places_of({{"y.png", {}, {}}}, recording, "corners.vnl"), Contains("names no picture"));
}
