#include "calib/solve/lens_likeness.h"

#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstdio>
#include <limits>

#include "calib/solve/calibrate.h"
#include "tests/calib/solve_scenes.h"

using namespace stuv;
using namespace stuv::test;

namespace {

constexpr std::array<int, 3> kRadial = {4, 5, 8};

/// A row of ten cameras with lenses that opencv4 does not fit. One in the middle sees the boards in its
/// middle only, those at the ends at their pictures' border.
Scene wide_scene(unsigned seed, double alike) {
  Scene scene = make_scene(1, 10, 5, {}, 0, seed, 1.0);
  std::mt19937_64 random(seed);
  std::normal_distribution<double> draw;
  for (std::size_t c = 0; c < scene.truth.size(); ++c) {
    Camera& camera = scene.truth[c];
    camera.lens_model = "LENSMODEL_OPENCV5";
    camera.intrinsics[0] -= 350;
    camera.intrinsics[1] -= 350;
    const double kind = alike > 0 ? 1 : (c % 2 == 0 ? 1 : 0.2);
    camera.intrinsics[4] = kind * -0.12 + alike * 0.002 * draw(random);
    camera.intrinsics[5] = kind * 0.09 + alike * 0.003 * draw(random);
    camera.intrinsics.push_back(kind * -0.06 + alike * 0.003 * draw(random));
  }
  const std::vector<Eigen::Vector3d> model = board_points(scene.observations.board);
  std::vector<Pose> ref_from_board;
  for (int s = 0; s < 5; ++s) {
    Pose pose;
    pose.R = rotation_from_vector({0.4 * std::cos(2.4 * s), 0.4 * std::sin(2.4 * s), 0.05 * draw(random)});
    pose.t = Eigen::Vector3d(0.06 * std::cos(1.7 * s), 0.05 * std::sin(1.7 * s), 0.8 + 0.05 * (s % 3)) -
             pose.R * Eigen::Vector3d(0.18, 0.12, 0);
    ref_from_board.push_back(pose);
  }
  for (BoardObservation& b : scene.observations.boards) {
    std::vector<Eigen::Vector3d> points;
    for (const Eigen::Vector3d& p : model)
      points.push_back(scene.truth[b.camera].cam_from_rig * (ref_from_board[b.set] * p));
    b.corners_px = project(scene.truth[b.camera], points);
  }
  for (BoardObservation& b : scene.observations.boards)
    for (Eigen::Vector2d& q : b.corners_px) {
      q += 0.02 * Eigen::Vector2d(draw(random), draw(random));
      if (q.x() < 0 || q.y() < 0 || q.x() > 799 || q.y() > 599) q.setConstant(std::nan(""));
    }
  return scene;
}

/// Mean over cameras of the radial distortions' squared error over their stated covariance, by numbers.
double normalised_error(const Calibration& c, const Scene& scene) {
  double sum = 0;
  for (std::size_t i = 0; i < scene.truth.size(); ++i) {
    const Eigen::MatrixXd& C = c.cameras[i].lens_covariance;
    REQUIRE(C.rows() == 9);
    Eigen::Vector3d off;
    Eigen::Matrix3d P;
    for (int k = 0; k < 3; ++k) {
      off[k] = c.solution.cameras[i].intrinsics[kRadial[k]] - scene.truth[i].intrinsics[kRadial[k]];
      for (int l = 0; l < 3; ++l) P(k, l) = C(kRadial[k], kRadial[l]);
    }
    sum += off.dot(P.ldlt().solve(off)) / 3;
  }
  return sum / static_cast<double>(scene.truth.size());
}

/// Rms error of where the picture's corners are seen, all cameras [px].
double corner_error_px(const JointSolution& s, const Scene& scene) {
  double sum = 0;
  for (std::size_t i = 0; i < scene.truth.size(); ++i) {
    const double f = scene.truth[i].intrinsics[0], rho = std::hypot(400, 300) / f;
    double off = 0;
    for (int k = 0; k < 3; ++k)
      off += f * std::pow(rho, 3 + 2 * k) *
             (s.cameras[i].intrinsics[kRadial[k]] - scene.truth[i].intrinsics[kRadial[k]]);
    sum += off * off;
  }
  return std::sqrt(sum / static_cast<double>(scene.truth.size()));
}

CalibrationOptions choosing() {
  CalibrationOptions options;
  options.solve.choose_lens = true;
  return options;
}

}  // namespace

TEST_CASE("lenses of one make help each other where opencv4 does not fit") {
  double normalised = 0, alike_px = 0, free_px = 0;
  constexpr int kSeeds = 3;
  for (unsigned seed = 1; seed <= kSeeds; ++seed) {
    const Scene scene = wide_scene(seed, 1);
    const Calibration c = calibrate(scene.observations, scene.recording, choosing());
    REQUIRE(c.solution.converged);
    CHECK(c.lens == Lens::opencv5);
    CHECK(c.lenses_alike);
    for (std::size_t i = 0; i < scene.truth.size(); ++i)
      CHECK(std::abs(c.solution.cameras[i].intrinsics[0] - scene.truth[i].intrinsics[0]) <
            4 * c.cameras[i].focal_sigma_px.x());
    normalised += normalised_error(c, scene) / kSeeds;
    alike_px += corner_error_px(c.solution, scene) / kSeeds;
    CalibrationOptions free;
    free.solve.lens = Lens::opencv5;
    free_px += corner_error_px(calibrate(scene.observations, scene.recording, free).solution, scene) / kSeeds;
  }
  std::printf("picture's corner: %.2f px alike, %.2f px each on its own; error over covariance %.2f\n",
              alike_px, free_px, normalised);
  CHECK(alike_px < 0.5 * free_px);
  // Lenses differ by less than the least spread that is taken, so below 1 is right.
  CHECK(normalised < 1.3);
}

TEST_CASE("lenses of two makes do not spoil each other") {
  const Scene scene = wide_scene(4, 0);
  const Calibration c = calibrate(scene.observations, scene.recording, choosing());
  REQUIRE(c.solution.converged);
  REQUIRE(c.lens == Lens::opencv5);
  CHECK(normalised_error(c, scene) < 2);
  for (std::size_t i = 0; i < scene.truth.size(); ++i)
    CHECK(std::abs(c.solution.cameras[i].intrinsics[0] - scene.truth[i].intrinsics[0]) <
          4 * c.cameras[i].focal_sigma_px.x());
}

TEST_CASE("a lens that fits is kept, and one that is asked for") {
  const Scene fits = make_scene(2, 4, 6, {}, 0.05);
  const Calibration kept = calibrate(fits.observations, fits.recording, choosing());
  CHECK(kept.lens == Lens::opencv4);
  CHECK_FALSE(kept.lenses_alike);
  const Scene scene = wide_scene(1, 1);
  const Calibration asked = calibrate(scene.observations, scene.recording, {});
  CHECK(asked.lens == Lens::opencv4);
}

TEST_CASE("what lenses have in common is not known of few, of other models, or of what is no number") {
  const Scene scene = wide_scene(1, 1);
  CalibrationOptions options;
  options.most_folds = 0;
  options.solve.lens = Lens::opencv5;
  const JointSolution s = calibrate(scene.observations, scene.recording, options).solution;
  const auto prior = lens_likeness(s);
  REQUIRE(prior);
  CHECK(prior->mean[0] == Approx(-0.12).margin(0.02));
  JointSolution few = s;
  for (int i = kFewestAlike - 1; i < 10; ++i) few.solved[i] = false;
  CHECK_FALSE(lens_likeness(few));
  few.solved[kFewestAlike] = true;
  CHECK(lens_likeness(few));
  JointSolution broken = s;
  broken.camera_covariance.setConstant(std::numeric_limits<double>::quiet_NaN());
  CHECK_FALSE(lens_likeness(broken));
  broken = s;
  broken.cameras[3].width *= 2;
  CHECK_FALSE(lens_likeness(broken));
  broken = s;
  broken.converged = false;
  CHECK_FALSE(lens_likeness(broken));
  broken = s;
  for (Camera& camera : broken.cameras) camera.lens_model = "LENSMODEL_OPENCV8";
  CHECK_FALSE(lens_likeness(broken));
}
