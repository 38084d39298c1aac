#include "capture/synthetic/synthetic_source.h"

#include <tbb/global_control.h>

#include <cmath>

#include "capture/capture.h"
#include "capture/config.h"
#include "capture/synthetic/lens_grid.h"
#include "capture/synthetic/random.h"
#include "tests/capture/support.h"

using namespace stuv;
using namespace stuv::synthetic;
using namespace stuv::test;

namespace {

SyntheticOptions built_in() { return std::get<SyntheticOptions>(default_capture_config()); }

/// A rig whose pictures take milliseconds.
SyntheticOptions small_options() {
  SyntheticOptions options = built_in();
  options.rig.rows = 1;
  options.rig.cols = 2;
  options.rig.width = 96;
  options.rig.height = 72;
  options.rig.focal_px = 90;
  options.board_sets = options.scene_sets = 1;
  return options;
}

/// Binomial smoothing, by which the samples of sharp edges stop to depend on where pixels lie.
ImageF smoothed(ImageF image) {
  for (int round = 0; round < 4; ++round) {
    const ImageF from = image;
    for (int y = 1; y + 1 < image.height; ++y)
      for (int x = 1; x + 1 < image.width; ++x)
        image.at(x, y) =
            (4 * from.at(x, y) +
             2 * (from.at(x - 1, y) + from.at(x + 1, y) + from.at(x, y - 1) + from.at(x, y + 1)) +
             from.at(x - 1, y - 1) + from.at(x + 1, y - 1) + from.at(x - 1, y + 1) + from.at(x + 1, y + 1)) /
            16;
  }
  return image;
}

/// The point through which the lines of all edges around it pass (Foerstner), weighted by a Gaussian around
/// that point, so that the window cuts edges symmetrically. Starts at a whole pixel near `about`.
Eigen::Vector2d corner_near(const ImageF& image, const Eigen::Vector2d& about) {
  constexpr int half = 9;
  constexpr double sigma_px = 2.5;
  const int cx = static_cast<int>(std::lround(about.x())), cy = static_cast<int>(std::lround(about.y()));
  Eigen::Vector2d corner(cx, cy);
  for (int round = 0; round < 60; ++round) {
    Eigen::Matrix2d A = Eigen::Matrix2d::Zero();
    Eigen::Vector2d b = Eigen::Vector2d::Zero();
    for (int y = cy - half; y <= cy + half; ++y)
      for (int x = cx - half; x <= cx + half; ++x) {
        const Eigen::Vector2d p(x, y);
        const Eigen::Vector2d g(image.at(x + 1, y) - image.at(x - 1, y),
                                image.at(x, y + 1) - image.at(x, y - 1));
        const double weight = std::exp(-(p - corner).squaredNorm() / (2 * sigma_px * sigma_px));
        A += weight * g * g.transpose();
        b += weight * g * g.dot(p);
      }
    corner = A.ldlt().solve(b);
  }
  return corner;
}

bool inside(const Eigen::Vector2d& q, const Camera& camera, double margin) {
  return q.x() >= margin && q.y() >= margin && q.x() <= camera.width - 1 - margin &&
         q.y() <= camera.height - 1 - margin;
}

}  // namespace

TEST_CASE("rig: without jitter the lattice is exact; missing cameras change no other") {
  RigOptions options;
  options.rows = 2;
  options.cols = 3;
  options.spacing_m = {0.05, 0.04};
  TrueRig jittered = make_rig(options);
  options.missing = {"r0c1"};
  const TrueRig thinned = make_rig(options);
  REQUIRE(thinned.rig.cameras.size() == 5);
  CHECK(thinned.rig.cameras[1].camera.name == "r0c2");
  CHECK(thinned.rig.cameras[1].camera.intrinsics == jittered.rig.cameras[2].camera.intrinsics);
  CHECK(thinned.rig.cameras[1].camera.cam_from_rig.t == jittered.rig.cameras[2].camera.cam_from_rig.t);
  options.missing.clear();
  options.jitter = {{0, 0, 0}, 0, 0, 0, {0, 0, 0, 0}, 0, 0, 0};
  const TrueRig exact = make_rig(options);
  CHECK((exact.rig.cameras[5].camera.cam_from_rig.centre() - Eigen::Vector3d(0.05, 0.02, 0)).norm() < 1e-15);
  CHECK(exact.rig.cameras[0].camera.intrinsics == exact.rig.cameras[5].camera.intrinsics);
}

TEST_CASE("lens grid: rays follow the lens model to far less than 0.001 px") {
  RigOptions options = built_in().rig;
  options.distortion = {-0.25, 0.1, 0.002, -0.001};
  const Camera camera = make_rig(options).rig.cameras[3].camera;
  const LensGrid lens(camera);
  double worst_px = 0;
  for (std::uint64_t i = 0; i < 300; ++i) {
    const Eigen::Vector2d q(-0.5 + camera.width * uniform(hash({i, 1})),
                            -0.5 + camera.height * uniform(hash({i, 2})));
    const Eigen::Vector2d back = project(camera, {LensGrid::Row(lens, q.y())(q.x()).homogeneous()})[0];
    worst_px = std::max(worst_px, (back - q).norm());
  }
  CHECK(worst_px < 1e-4);
}

TEST_CASE("board: the corners in the picture are where the truth says") {
  SyntheticOptions options = built_in();
  options.rig.rows = options.rig.cols = 1;
  options.board.bend_m = {0.002, -0.001};
  const Camera camera = make_rig(options.rig).rig.cameras[0].camera;
  double sum = 0, worst = 0;
  int count = 0;
  for (const Pose& pose : synthetic::board_poses(options)) {
    const ImageF picture = smoothed(render_board(options.board, camera, pose));
    for (const Eigen::Vector2d& q : board_pixels(options.board, camera, pose)) {
      if (!inside(q, camera, 12)) continue;
      const double error = (corner_near(picture, q) - q).norm();
      sum += error * error;
      worst = std::max(worst, error);
      ++count;
    }
  }
  CHECK(count > 500);
  CAPTURE(worst);
  CHECK(std::sqrt(sum / count) < 0.03);
  CHECK(worst < 0.1);
}

TEST_CASE("board: squares begin at whole multiples, seen straight on by a pinhole") {
  BoardOptions board;
  Camera camera{"a", "LENSMODEL_PINHOLE", {400, 400, 159.5, 119.5}, 320, 240, {}};
  Pose pose;
  pose.t = {-0.18, -0.12, 1.0};  // corners 16 px apart, the first at 159.5 - 72, 119.5 - 48
  const auto pixels = board_pixels(board, camera, pose);
  CHECK((pixels[0] - Eigen::Vector2d(87.5, 71.5)).norm() < 1e-9);
  CHECK((pixels[11] - Eigen::Vector2d(103.5, 87.5)).norm() < 1e-9);
  const ImageF picture = render_board(board, camera, pose);
  // An edge exactly between two pixels leaves both pure; the squares around a corner alternate.
  const float a = picture.at(87, 71), b = picture.at(88, 71), c = picture.at(88, 72);
  CHECK(std::abs(a - c) < 0.01F);
  CHECK(std::abs(a - b) > 0.5F);
  CHECK(std::abs(picture.at(80, 71) - a) < 0.01F);
}

TEST_CASE("board: poses are seen whole by most cameras") {
  const SyntheticOptions options = built_in();
  const Rig rig = make_rig(options.rig).rig;
  for (const Pose& pose : synthetic::board_poses(options)) {
    int whole = 0;
    for (const RigCamera& camera : rig.cameras) {
      const auto pixels = board_pixels(options.board, camera.camera, pose);
      whole += std::all_of(pixels.begin(), pixels.end(),
                           [&](const auto& q) { return inside(q, camera.camera, 6); });
    }
    CHECK(whole >= 20);
  }
}

TEST_CASE("depth: the wall's is the plane's, along each camera's own axis") {
  RigOptions rig = small_options().rig;
  rig.jitter.direction_rad = 0.1;
  SceneOptions wall;
  wall.kind = SceneOptions::Kind::wall;
  wall.wall_m = 2;
  const Camera camera = make_rig(rig).rig.cameras[1].camera;
  const ImageF depth = render_picture(Scene(wall), camera).depth;
  const Pose rig_from_cam = camera.cam_from_rig.inverse();
  double worst = 0;
  for (int y = 0; y < depth.height; y += 7)
    for (int x = 0; x < depth.width; x += 5) {
      const Eigen::Vector3d ray = unproject(camera, {Eigen::Vector2d(x, y)})[0];
      const double t = (2 - rig_from_cam.t.z()) / (rig_from_cam.R * ray).z();
      worst = std::max(worst, std::abs(t * ray.z() - depth.at(x, y)));
    }
  CHECK(worst < 1e-5);
}

TEST_CASE("scene: time moves the ball and nothing else") {
  Camera camera{"a", "LENSMODEL_PINHOLE", {300, 300, 159.5, 119.5}, 320, 240, {}};
  const Scene scene;
  const std::int64_t later_ns = 50'000'000;
  const ImageF before = render_picture(scene, camera, 0).depth,
               after = render_picture(scene, camera, later_ns).depth;
  int changed = 0, elsewhere = 0;
  for (int y = 0; y < before.height; ++y)
    for (int x = 0; x < before.width; ++x) {
      if (before.at(x, y) == after.at(x, y)) continue;
      ++changed;
      bool at_ball = false;
      for (const std::int64_t time : {std::int64_t{0}, later_ns}) {
        const Eigen::Vector3d centre = scene.ball_centre(time), ray(x - 159.5, y - 119.5, 300);
        at_ball |= centre.cross(ray.normalized()).norm() <= Scene::kBallRadius_m * 1.0001;
      }
      elsewhere += at_ball ? 0 : 1;
    }
  CHECK(changed > 100);
  CHECK(elsewhere == 0);
}

TEST_CASE("sensor: noise has the mean and the variance it should") {
  ImageF light(400, 300, 1, 0.3F);
  SensorOptions sensor;
  sensor.gamma = 1;
  sensor.full_well_e = 2000;
  sensor.read_noise_e = 20;
  const Image image = expose(light, 1, sensor, {1, 0, 5});
  double sum = 0, squares = 0;
  for (const std::byte b : image.bytes) {
    sum += std::to_integer<int>(b);
    squares += std::to_integer<int>(b) * std::to_integer<int>(b);
  }
  const double n = static_cast<double>(image.bytes.size()), mean = sum / n;
  CHECK(mean == Approx(0.3 * 255).margin(0.05));
  const double expected = 255 * 255 * (0.3 / 2000 + 0.01 * 0.01) + 1.0 / 12;
  CHECK(squares / n - mean * mean == Approx(expected).epsilon(0.03));
}

TEST_CASE("sensor: gain and vignetting darken as stated") {
  ImageF light(101, 101, 1, 0.5F);
  SensorOptions sensor;
  sensor.gamma = 1;
  sensor.full_well_e = 0;
  const Image image = expose(light, 1, sensor, {0.8, 0.5, 0});
  CHECK(std::to_integer<int>(image.bytes[50 * 101 + 50]) == 102);
  CHECK(std::to_integer<int>(image.bytes[0]) == 51);
}

TEST_CASE("synthetic: the same pictures whatever the number of threads") {
  const auto pictures = [] {
    const auto source = open_synthetic(small_options());
    std::vector<std::vector<std::byte>> bytes;
    while (const auto set = source->next())
      for (const SourceFrame& frame : set->frames) bytes.push_back(std::get<Image>(frame.content).bytes);
    return bytes;
  };
  std::vector<std::vector<std::byte>> one;
  {
    const tbb::global_control single(tbb::global_control::max_allowed_parallelism, 1);
    one = pictures();
  }
  const tbb::global_control many(tbb::global_control::max_allowed_parallelism, 7);
  CHECK(one.size() == 4);
  CHECK(one == pictures());
  CHECK(one[0] != one[1]);
}

TEST_CASE("synthetic: truth lies beside the frames and skew shows in the timestamps") {
  const TempFolder folder;
  SyntheticOptions options = small_options();
  options.rig.jitter.time_skew_ns = 1e6;
  capture(*open_synthetic(options), folder / "rec", {});
  const Recording recording = open_recording(folder / "rec");
  const TrueRig truth = make_rig(options.rig);
  const Rig rig = read_rig(folder / "rec" / "truth");
  REQUIRE(rig.cameras.size() == 2);
  CHECK(rig.cameras[1].camera.intrinsics[0] ==
        Approx(truth.rig.cameras[1].camera.intrinsics[0]).epsilon(1e-12));
  const FrameSet& scene = recording.sets.at(static_cast<std::size_t>(recording.set_index("scene00")));
  CHECK(scene.frames[1].timestamp_ns - scene.frames[0].timestamp_ns ==
        truth.time_skew_ns[1] - truth.time_skew_ns[0]);
  CHECK(truth.time_skew_ns[1] != truth.time_skew_ns[0]);
  const Json boards = read_json(folder / "rec" / "truth" / "boards.json");
  const auto pixels =
      board_pixels(options.board, truth.rig.cameras[1].camera, synthetic::board_poses(options)[0]);
  CHECK(boards["sets"][0]["corners_px"]["r0c1"][69][1].get<double>() == pixels[69].y());
  CHECK(read_pfm(folder / "rec" / "truth" / "depth" / "scene00" / "r0c1.pfm").width == 96);
}
