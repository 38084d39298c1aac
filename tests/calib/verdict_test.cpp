#include <cmath>

#include "calib/solve/report.h"
#include "capture/synthetic/synthetic_source.h"
#include "core/error.h"
#include "tests/calib/solve_scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;
using Catch::Contains;

namespace {

bool has(const std::vector<std::string>& texts, const std::string& part) {
  return std::any_of(texts.begin(), texts.end(),
                     [&](const std::string& t) { return t.find(part) != std::string::npos; });
}

std::string all_of(const Calibration& c) {
  std::string text;
  for (const auto* list : {&c.reasons, &c.notes, &c.advice})
    for (const std::string& t : *list) text += t + "\n";
  return text;
}

}  // namespace

TEST_CASE("cameras that see no board, or none with the others, are named; the rest is kept") {
  Scene scene = make_scene(2, 4, 10, {}, 0.1);
  // Camera 5 sees nothing. Cameras 3 and 7 see the last sets, which nobody else sees.
  std::erase_if(scene.observations.boards, [](const auto& b) {
    return b.camera == 5 || (b.camera == 3 || b.camera == 7) != (b.set > 6);
  });
  const Calibration c = calibrate(scene.observations, scene.recording);
  CHECK_FALSE(c.good);
  REQUIRE(c.reasons.size() == 3);
  CHECK_THAT(c.cameras[5].undetermined, Contains("never sees the board"));
  CHECK_THAT(c.cameras[3].undetermined, Contains("shares no board with r0c0"));
  CHECK_THAT(c.cameras[7].undetermined, Contains("shares no board with"));
  for (const int i : {0, 1, 2, 4, 6}) CHECK(c.rig.cameras[i].determined);
  CHECK(c.rig.s_step_m.norm() == Approx(0.1).epsilon(0.03));
  CHECK(c.rig.nearest_seen_m > 0.8);

  const Json report = report_json(c, 1, 1);
  CHECK(report["cameras"][5]["position_m"].is_null());
  CHECK(report["cameras"][5]["focal_px"].is_null());
  CHECK_THAT(report["cameras"][3]["reason"].get<std::string>(), Contains("shares no board"));
  CHECK(report["cameras"][0]["reason"].is_null());
  CHECK(report_page(c).find("never sees the board") != std::string::npos);

  // Such a rig is written and read.
  const TempFolder folder;
  write_rig(folder.path(), c.rig);
  const Rig read = read_rig(folder.path());
  CHECK_FALSE(read.cameras[5].determined);
  CHECK(read.cameras[4].determined);
  CHECK(read_json(folder / "rig.json")["cameras"][5]["position_m"].is_null());
}

TEST_CASE("boards that a single camera sees take part") {
  Scene scene = make_scene(1, 3, 12, {}, 0.2);
  Scene shared = scene;
  // Sets from 6 on are seen by one camera each.
  std::erase_if(scene.observations.boards, [](const auto& b) { return b.set >= 6 && b.set % 3 != b.camera; });
  std::erase_if(shared.observations.boards, [](const auto& b) { return b.set >= 6; });
  const Calibration with = calibrate(scene.observations, scene.recording);
  const Calibration without = calibrate(shared.observations, shared.recording);
  for (int i = 0; i < 3; ++i) {
    CHECK(with.cameras[i].boards == 8);
    CHECK(with.cameras[i].focal_sigma_px.x() < without.cameras[i].focal_sigma_px.x());
  }
}

TEST_CASE("one camera and two cameras are solved") {
  for (const int n : {1, 2}) {
    const Scene scene = make_scene(1, n, 10, {}, 0.1);
    const Calibration c = calibrate(scene.observations, scene.recording);
    INFO(all_of(c));
    CHECK(c.good);
    for (int i = 0; i < n; ++i)
      CHECK(std::abs(c.rig.cameras[i].camera.intrinsics[0] - scene.truth[i].intrinsics[0]) <
            4 * c.cameras[i].focal_sigma_px.x());
  }
}

TEST_CASE("left-out boards and half-data solves differ by what the uncertainty says") {
  double halves = 0, left_out = 0;
  constexpr int kSeeds = 5;
  for (unsigned seed = 1; seed <= kSeeds; ++seed) {
    const Scene scene = make_scene(2, 3, 12, {}, 0.2, seed);
    const Calibration c = calibrate(scene.observations, scene.recording);
    REQUIRE(c.validation);
    REQUIRE(c.validation->left_out);
    REQUIRE(c.validation->halves);
    CHECK(c.validation->halves->cameras.size() == 6);
    halves +=
        (std::pow(c.validation->halves->lens_ratio, 2) + std::pow(c.validation->halves->centre_ratio, 2)) / 2;
    left_out += c.validation->left_out->rms_px / c.validation->left_out->predicted_px / kSeeds;
    CHECK(c.good);
    CHECK_FALSE(has(c.notes, "too small"));
  }
  halves = std::sqrt(halves / kSeeds);
  std::printf("halves over prediction %.3f, left-out boards over prediction %.3f\n", halves, left_out);
  CHECK(halves > 0.8);
  CHECK(halves < 1.2);
  CHECK(left_out > 0.95);
  CHECK(left_out < 1.05);
}

TEST_CASE("errors that corners of a view share make stated uncertainties larger, independent ones do not") {
  // Smooth over each view, as blur and a lens model that does not quite fit make them.
  Scene scene = make_scene(2, 3, 8, {}, 0.1);
  Scene shared = scene;
  std::mt19937_64 random(7);
  std::normal_distribution<double> normal(0, 0.1);
  for (BoardObservation& b : shared.observations.boards) {
    Eigen::Matrix<double, 2, 6> a;
    for (Eigen::Index i = 0; i < a.size(); ++i) a.data()[i] = normal(random);
    for (Eigen::Vector2d& q : b.corners_px) {
      const double x = q.x() / 400 - 1, y = q.y() / 300 - 1;
      Eigen::Matrix<double, 6, 1> shape;
      shape << 1, x, y, x * x, x * y, y * y;
      q += a * shape;
    }
  }
  const Calibration independent = calibrate(scene.observations, scene.recording);
  CHECK(independent.validation->sigma.scale == 1);
  CHECK(independent.validation->sigma.ratio == Approx(1).margin(0.4));
  CHECK(independent.solution.sigma_px == independent.solution.noise_px);
  CHECK_FALSE(has(independent.notes, "independent errors"));

  const Calibration c = calibrate(shared.observations, shared.recording);
  INFO(all_of(c));
  const double scale = c.validation->sigma.scale;
  CHECK(scale > 1.5);
  CHECK(c.solution.sigma_px == Approx(scale * c.solution.noise_px));
  CHECK(c.cameras[0].focal_sigma_px.x() ==
        Approx(scale * c.solution.noise_px * c.solution.focal_sigma[0].x()));
  CHECK(report_json(c, 1, 1)["sigma"]["scale"] == Approx(scale));
  double z_sq = 0, centre_sq = 0;
  const auto errors = aligned_errors(c.rig, shared.truth);
  for (std::size_t i = 0; i < shared.truth.size(); ++i) {
    for (int k = 0; k < 2; ++k)
      z_sq += std::pow((c.rig.cameras[i].camera.intrinsics[k] - shared.truth[i].intrinsics[k]) /
                           c.cameras[i].focal_sigma_px[k],
                       2) /
              12;
    for (int k = 0; k < 3; ++k)
      centre_sq += std::pow(errors[i][k] / c.rig.cameras[i].position_sigma_m[k], 2) / 18;
  }
  std::printf("shared errors: scale %.2f, focal lengths' error over sigma %.2f, centres' %.2f\n", scale,
              std::sqrt(z_sq), std::sqrt(centre_sq));
  CHECK(std::sqrt(z_sq) < 2);
  CHECK(std::sqrt(centre_sq) < 2);
  CHECK(scale * std::sqrt(std::min(z_sq, centre_sq)) > 1.2);  // without the scale they would be too small
}

TEST_CASE("two boards fit any lens: nothing confirms it") {
  Scene scene = make_scene(2, 3, 8, {}, 0.05);
  Scene two = scene;
  std::erase_if(two.observations.boards, [](const auto& b) { return b.set > 1; });
  const Calibration c = calibrate(two.observations, two.recording);
  INFO(all_of(c));
  CHECK(c.solution.rms_px < 0.06);
  CHECK_FALSE(c.good);
  for (const CameraSummary& camera : c.cameras) CHECK_THAT(camera.undetermined, Contains("nothing confirms"));
  CHECK(has(c.reasons, "nothing confirms its lens"));
}

TEST_CASE("a camera with one whole board and a cut one is named, two whole ones or three are enough") {
  for (const int whole : {1, 2}) {
    Scene scene = make_scene(2, 3, 8, {}, 0.05);
    std::erase_if(scene.observations.boards, [](const auto& b) { return b.camera == 5 && b.set > 1; });
    for (BoardObservation& b : scene.observations.boards)
      if (whole == 1 && b.camera == 5 && b.set == 1)
        for (std::size_t k = 0; k < 10; ++k) b.corners_px[k].x() = std::nan("");
    const Calibration c = calibrate(scene.observations, scene.recording);
    INFO(all_of(c));
    for (int i = 0; i < 5; ++i) CHECK(c.rig.cameras[i].determined);
    if (whole == 1) CHECK_FALSE(c.good);
    CHECK(c.rig.cameras[5].determined == (whole == 2));
    if (whole == 1) CHECK_THAT(c.cameras[5].undetermined, Contains("one whole board and one in part"));
  }
}

/// Boards that move across the cameras' view by up to `speed` [m/s], camera after camera `delay_s` later.
void move_between_frames(Scene& scene, double speed, double delay_s) {
  const std::vector<Eigen::Vector3d> model = board_points(scene.observations.board);
  const Calibration truth = calibrate(scene.observations, scene.recording, {.most_folds = 0});
  for (BoardObservation& b : scene.observations.boards) {
    const Eigen::Vector3d velocity(speed * std::cos(b.set), speed * std::sin(2.0 * b.set), 0);
    const Camera& camera = truth.solution.cameras[b.camera];
    const Pose pose = truth.solution.ref_from_board[b.set];
    for (std::size_t k = 0; k < model.size(); ++k) {
      const Eigen::Vector3d x = pose * model[k], later = x + delay_s * b.camera * velocity;
      b.corners_px[k] +=
          project(camera, {camera.cam_from_rig * later})[0] - project(camera, {camera.cam_from_rig * x})[0];
    }
  }
}

TEST_CASE("a board that moved between the cameras' frames is suspected") {
  Scene scene = make_scene(2, 3, 12, {}, 0.1);
  const Scene still = scene;
  move_between_frames(scene, 0.1, 1e-3);
  const Calibration moved = calibrate(scene.observations, scene.recording);
  INFO(all_of(moved) << " view " << moved.structure.view_px << " " << moved.structure.view_ratio);
  CHECK(has(moved.notes, "not taken together"));
  CHECK_FALSE(has(calibrate(still.observations, still.recording).notes, "not taken together"));
}

TEST_CASE("lenses that boards bend which moved between frames are not determined") {
  for (const unsigned seed : {1U, 2U, 3U}) {
    Scene scene = make_scene(2, 2, 12, {}, 0.1, seed);
    move_between_frames(scene, 0.2, 0.03);
    const Calibration c = calibrate(scene.observations, scene.recording);
    INFO(all_of(c) << " view " << c.structure.view_px << " " << c.structure.view_ratio);
    REQUIRE(c.own_lenses.size() == 4);
    int named = 0;
    for (std::size_t i = 0; i < 4; ++i) {
      const OwnLens& own = c.own_lenses[i];
      const double true_px = scene.truth[i].intrinsics[0];
      REQUIRE(own.solved);
      CHECK(std::abs(own.focal_px[0] - true_px) < 4 * own.focal_sigma_px[0]);
      const double error_px = std::abs(c.solution.cameras[i].intrinsics[0] - true_px);
      std::printf("frames apart: true %.1f px, alone %.1f (sigma %.1f), together %.1f, %s\n", true_px,
                  own.focal_px[0], own.focal_sigma_px[0], c.solution.cameras[i].intrinsics[0],
                  c.cameras[i].undetermined.c_str());
      if (c.cameras[i].undetermined.find("not taken together") != std::string::npos) {
        ++named;
        CHECK_THAT(c.cameras[i].undetermined, Contains("by its own boards alone"));
      } else {
        CHECK(error_px < 8 * own.focal_sigma_px[0]);
      }
    }
    CHECK(named > 0);
  }
}

TEST_CASE("rolling shutters before a moving board are suspected") {
  Scene scene = make_scene(2, 3, 12, {}, 0.1);
  const Scene still = scene;
  const std::vector<Eigen::Vector3d> model = board_points(scene.observations.board);
  const Calibration truth = calibrate(still.observations, still.recording, {.most_folds = 0});
  for (BoardObservation& b : scene.observations.boards) {
    // Down and up: a rolling shutter stretches and shrinks it. 20 ms a frame; every second camera global.
    if (b.camera % 2 == 0) continue;
    const Eigen::Vector3d velocity(0, b.set % 2 == 0 ? 0.2 : -0.2, 0);
    const Camera& camera = truth.solution.cameras[b.camera];
    const Pose pose = truth.solution.ref_from_board[b.set];
    for (std::size_t k = 0; k < model.size(); ++k) {
      const double time = 0.02 * (b.corners_px[k].y() / 600 - 0.5);
      const Eigen::Vector3d x = pose * model[k], later = x + time * velocity;
      b.corners_px[k] +=
          project(camera, {camera.cam_from_rig * later})[0] - project(camera, {camera.cam_from_rig * x})[0];
    }
  }
  const Calibration moved = calibrate(scene.observations, scene.recording);
  INFO(all_of(moved) << " row " << moved.structure.row_px << " " << moved.structure.row_ratio);
  CHECK(has(moved.notes, "rolling shutter"));
  CHECK_FALSE(has(calibrate(still.observations, still.recording).notes, "rolling shutter"));
}

TEST_CASE("shared and held lenses") {
  Scene scene = make_scene(2, 3, 5, {}, 0.3);
  // Identical cameras: all have the first one's lens.
  const std::vector<Eigen::Vector3d> model = board_points(scene.observations.board);
  Scene same = scene;
  const Calibration poses = calibrate(scene.observations, scene.recording, {.most_folds = 0});
  std::mt19937_64 random(1);
  std::normal_distribution<double> noise(0, 0.3);
  for (Camera& camera : same.truth) camera.intrinsics = scene.truth[0].intrinsics;
  for (BoardObservation& b : same.observations.boards) {
    Camera camera = poses.solution.cameras[b.camera];
    camera.intrinsics = scene.truth[0].intrinsics;
    for (std::size_t k = 0; k < model.size(); ++k)
      b.corners_px[k] =
          project(camera, {camera.cam_from_rig * (poses.solution.ref_from_board[b.set] * model[k])})[0] +
          Eigen::Vector2d(noise(random), noise(random));
  }
  CalibrationOptions options;
  options.most_folds = 0;
  const Calibration own = calibrate(same.observations, same.recording, options);
  options.solve.shared_lens = true;
  const Calibration shared = calibrate(same.observations, same.recording, options);
  for (std::size_t i = 0; i < same.truth.size(); ++i) {
    CHECK(shared.rig.cameras[i].camera.intrinsics == shared.rig.cameras[0].camera.intrinsics);
    CHECK(shared.cameras[i].focal_sigma_px.x() < 0.7 * own.cameras[i].focal_sigma_px.x());
    CHECK(std::abs(shared.rig.cameras[i].camera.intrinsics[0] - same.truth[0].intrinsics[0]) <
          4 * shared.cameras[i].focal_sigma_px.x());
  }

  options.solve.shared_lens = false;
  options.solve.known = same.truth;
  const Calibration held = calibrate(same.observations, same.recording, options);
  INFO(all_of(held));
  CHECK(held.good);
  for (std::size_t i = 0; i < same.truth.size(); ++i) {
    CHECK(held.rig.cameras[i].camera.intrinsics == same.truth[i].intrinsics);
    CHECK(held.cameras[i].focal_sigma_px.norm() == 0);
    CHECK(held.rig.cameras[i].position_sigma_m.norm() < own.rig.cameras[i].position_sigma_m.norm());
  }
  options.solve.known.pop_back();
  CHECK_THROWS_WITH(calibrate(same.observations, same.recording, options), Contains("has no lens"));
}

TEST_CASE("a camera out of focus weighs less and is named") {
  Scene scene = make_scene(2, 3, 10, {}, 0.1);
  add_noise(scene, 1.5, 3, [](const BoardObservation& b) { return b.camera == 4; });
  const Calibration c = calibrate(scene.observations, scene.recording);
  INFO(all_of(c));
  CHECK(c.cameras[4].noise_px == Approx(1.5).epsilon(0.1));
  CHECK(c.cameras[0].noise_px == Approx(0.1).epsilon(0.1));
  CHECK(has(c.notes, "camera r1c1's corners are noisier"));
  const auto errors = aligned_errors(c.rig, scene.truth);
  for (std::size_t i = 0; i < errors.size(); ++i)
    for (int k = 0; k < 3; ++k) CHECK(std::abs(errors[i][k]) < 4 * c.rig.cameras[i].position_sigma_m[k]);
}

TEST_CASE("the advice is to tilt the board where all boards are parallel") {
  Scene scene = make_scene(2, 2, 6, {}, 0.1);
  const Calibration good = calibrate(scene.observations, scene.recording);
  for (const std::string& a : good.advice) CHECK_THAT(a, !Contains("nearly parallel"));
  std::erase_if(scene.observations.boards, [](const auto& b) { return b.set > 0; });
  const Calibration single = calibrate(scene.observations, scene.recording);
  CHECK_FALSE(single.good);
  CHECK(has(single.advice, "show more boards"));
}
