#include <cmath>
#include <numeric>

#include "tests/calib/solve_scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;
using Catch::Contains;

namespace {

/// What every stress case is held to: each camera is right within its stated uncertainty (no component of its
/// centre or focal length off by more than 4.5 sigma, which happens by chance once in 150 000), or not
/// determined, with a reason; and a rig with such a camera is not good.
struct Outcome {
  Calibration calibration;
  int determined = 0;
};

Outcome check_honest(const Scene& scene, CalibrationOptions options = {}) {
  options.most_folds = 0;
  Outcome out{calibrate(scene.observations, scene.recording, options)};
  const Calibration& c = out.calibration;
  std::vector<Camera> truth;
  Rig rig;
  std::vector<std::size_t> which;
  for (std::size_t i = 0; i < scene.truth.size(); ++i) {
    CHECK(c.rig.cameras[i].determined == c.cameras[i].undetermined.empty());
    if (!c.rig.cameras[i].determined) continue;
    truth.push_back(scene.truth[i]);
    rig.cameras.push_back(c.rig.cameras[i]);
    which.push_back(i);
    ++out.determined;
  }
  if (out.determined < static_cast<int>(scene.truth.size())) CHECK_FALSE(c.good);
  if (truth.empty()) return out;
  const auto errors = aligned_errors(rig, truth);
  for (std::size_t k = 0; k < which.size(); ++k) {
    INFO("camera " << which[k] << " of " << scene.truth.size());
    for (int axis = 0; axis < 3 && which.size() > 2; ++axis)
      CHECK(std::abs(errors[k][axis]) <= 4.5 * rig.cameras[k].position_sigma_m[axis] + 1e-9);
    for (int axis = 0; axis < 2; ++axis)
      CHECK(std::abs(rig.cameras[k].camera.intrinsics[axis] - truth[k].intrinsics[axis]) <=
            4.5 * c.cameras[which[k]].focal_sigma_px[axis] + 1e-6);
  }
  return out;
}

/// The scene's cameras before other boards.
Scene with_boards(const Scene& scene, const std::vector<Pose>& poses, double noise_px, unsigned seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> noise(0, noise_px);
  Scene out = scene;
  out.observations.boards.clear();
  out.observations.set_names.clear();
  const std::vector<Eigen::Vector3d> model = board_points(scene.observations.board);
  for (std::size_t s = 0; s < poses.size(); ++s) {
    out.observations.set_names.push_back(std::to_string(s));
    for (std::size_t c = 0; c < scene.truth.size(); ++c) {
      std::vector<Eigen::Vector3d> points;
      for (const Eigen::Vector3d& p : model) points.push_back(scene.truth[c].cam_from_rig * (poses[s] * p));
      BoardObservation b{static_cast<int>(c), static_cast<int>(s), project(scene.truth[c], points), {}};
      for (Eigen::Vector2d& q : b.corners_px) q += Eigen::Vector2d(noise(random), noise(random));
      out.observations.boards.push_back(std::move(b));
    }
  }
  return out;
}

Pose board_at(const Eigen::Vector3d& turn, const Eigen::Vector3d& middle) {
  const Pose pose{rotation_from_vector(turn), {0, 0, 0}};
  return {pose.R, middle - pose.R * Eigen::Vector3d(0.18, 0.12, 0)};
}

/// All lengths times `factor`, and the board's square with them.
Scene scaled(Scene scene, double factor) {
  scene.observations.board.square_m *= factor;
  for (Camera& camera : scene.truth) camera.cam_from_rig.t *= factor;
  return scene;
}

}  // namespace

TEST_CASE("stress: boards that all face the cameras") {
  std::vector<Pose> poses;
  for (int s = 0; s < 8; ++s)
    poses.push_back(board_at({0, 0, 0.05 * s}, {0.2 * std::cos(s), 0.1 * std::sin(s), 1.2 + 0.02 * s}));
  const Scene scene = with_boards(make_scene(2, 3, 0), poses, 0.2, 1);
  const Outcome out = check_honest(scene);
  CHECK_FALSE(out.calibration.good);
  CHECK_FALSE(out.calibration.advice.empty());
}

TEST_CASE("stress: one, two and three boards") {
  for (const int boards : {1, 2, 3})
    for (unsigned seed = 1; seed <= 3; ++seed) check_honest(make_scene(2, 3, boards, {}, 0.2, seed));
}

TEST_CASE("stress: boards that are nearly one") {
  std::vector<Pose> poses;
  for (int s = 0; s < 10; ++s)
    poses.push_back(board_at({0.3 + 1e-3 * s, 0.2, 0}, {1e-3 * s, 0, 1.2 + 1e-3 * s}));
  check_honest(with_boards(make_scene(2, 3, 0), poses, 0.2, 1));
}

TEST_CASE("stress: tele lenses and a board far away") {
  Scene tele = make_scene(2, 3, 0);
  for (Camera& camera : tele.truth) camera.intrinsics[0] *= 8, camera.intrinsics[1] *= 8;
  std::vector<Pose> far, same;
  for (int s = 0; s < 12; ++s) {
    const Eigen::Vector3d turn(0.6 * std::cos(2.4 * s), 0.6 * std::sin(2.4 * s), 0.1);
    far.push_back(board_at(turn, {0.1 * std::cos(s), 0.08 * std::sin(s), 9 + 0.3 * (s % 4)}));
    same.push_back(board_at(turn, {1.5 * std::cos(s), 1 * std::sin(s), 12.0 + (s % 4)}));
  }
  check_honest(with_boards(tele, far, 0.1, 1));
  check_honest(with_boards(make_scene(2, 3, 0), same, 0.1, 1));
}

TEST_CASE("stress: corner noise from 0.01 to 2 px") {
  for (const double noise : {0.01, 0.1, 0.5, 2.0}) {
    const Outcome out = check_honest(make_scene(2, 3, 10, {}, noise, 5));
    CHECK(out.calibration.solution.noise_px == Approx(noise).epsilon(0.05));
    CHECK(out.calibration.solution.outliers < 10);
    if (noise <= 0.1) CHECK(out.determined == 6);
  }
}

TEST_CASE("stress: 1 to 30 % gross outliers") {
  for (const double share : {0.01, 0.1, 0.2, 0.3}) {
    Scene scene = make_scene(2, 3, 10, {}, 0.1, 2);
    std::mt19937_64 random(7);
    std::uniform_real_distribution<double> uniform(-1, 1);
    int wrong = 0;
    for (BoardObservation& b : scene.observations.boards)
      for (Eigen::Vector2d& q : b.corners_px)
        if (0.5 * (uniform(random) + 1) < share) {
          q += Eigen::Vector2d(3 + 40 * std::abs(uniform(random)), 40 * uniform(random));
          ++wrong;
        }
    const Outcome out = check_honest(scene);
    INFO("share " << share);
    CHECK(out.determined == 6);
    CHECK(out.calibration.solution.noise_px == Approx(0.1).epsilon(0.05));
    CHECK(out.calibration.solution.outliers >= 0.99 * wrong);
    CHECK(out.calibration.solution.outliers <= 1.01 * wrong + 5);
    CHECK(out.calibration.good == (share <= 0.1));
  }
}

TEST_CASE("stress: camera names swapped are counted by where the cameras stand") {
  Scene scene = make_scene(3, 3, 8, {}, 0.1);
  std::swap(scene.recording.cameras[1].col, scene.recording.cameras[2].col);
  const Outcome out = check_honest(scene);
  CHECK(out.determined == 9);
  CHECK_FALSE(out.calibration.layout.as_recorded);
  CHECK(out.calibration.rig.cameras[1].col == 1);
  CHECK(out.calibration.rig.cameras[2].col == 2);
}

TEST_CASE("stress: lengths from 1e-3 to 1e3 times as large, and millimetres given as metres") {
  const Scene scene = make_scene(2, 3, 10, {}, 0.1);
  const Calibration usual = calibrate(scene.observations, scene.recording);
  for (const double factor : {1e-3, 1.0 / 16, 40.0, 1e3}) {
    const Scene other = scaled(scene, factor);
    const Outcome out = check_honest(other);
    CHECK(out.determined == 6);
    CHECK(out.calibration.rig.s_step_m.norm() == Approx(factor * usual.rig.s_step_m.norm()).epsilon(1e-6));
    CHECK(out.calibration.rig.cameras[2].position_sigma_m.norm() ==
          Approx(factor * usual.rig.cameras[2].position_sigma_m.norm()).epsilon(1e-3));
    CHECK(out.calibration.solution.rms_px == Approx(usual.solution.rms_px).epsilon(1e-6));
    const bool said =
        std::any_of(out.calibration.notes.begin(), out.calibration.notes.end(),
                    [](const auto& n) { return n.find("millimetres as metres") != std::string::npos; });
    CHECK(said == (factor == 1e3));
  }
}

TEST_CASE("stress: fisheyes of 180 degrees") {
  // Equidistant lenses, r = f theta: no model of ours, so splines have to take it up.
  Scene scene = make_scene(1, 3, 0);
  scene.observations.board = parse_board("chessboard:10x7:20mm");
  const double f = 800 / M_PI;
  const auto fisheye = [f](const Eigen::Vector3d& p) -> Eigen::Vector2d {
    const double r = p.head<2>().norm(), theta = std::atan2(r, p.z());
    return Eigen::Vector2d(399.5, 299.5) + f * theta / r * p.head<2>();
  };
  const std::vector<Eigen::Vector3d> model = board_points(scene.observations.board);
  std::mt19937_64 random(1);
  std::normal_distribution<double> noise(0, 0.1);
  int set = 0;
  double widest = 0;
  // Around the cameras, out to the border of their fields, facing them and tilted.
  for (int ring = 0; ring < 5; ++ring)
    for (int k = 0; k < (ring == 0 ? 4 : 14); ++k, ++set) {
      const double theta = 0.35 * ring, phi = 2 * M_PI * k / 14 + 0.1 * ring;
      const Eigen::Vector3d d(std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi),
                              std::cos(theta));
      Pose pose;
      pose.R = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), d).toRotationMatrix() *
               rotation_from_vector({0.5 * std::cos(2.4 * set), 0.5 * std::sin(2.4 * set), 0});
      pose.t = 0.4 * d - pose.R * Eigen::Vector3d(0.09, 0.06, 0);
      scene.observations.set_names.push_back(std::to_string(set));
      for (std::size_t c = 0; c < scene.truth.size(); ++c) {
        BoardObservation b{static_cast<int>(c), set, {}, {}};
        for (const Eigen::Vector3d& p : model) {
          const Eigen::Vector3d x = scene.truth[c].cam_from_rig * (pose * p);
          const double angle = std::atan2(x.head<2>().norm(), x.z());
          const Eigen::Vector2d q = fisheye(x);
          const bool seen = angle < M_PI / 2 && q.x() > 0 && q.y() > 0 && q.x() < 799 && q.y() < 599;
          if (seen) widest = std::max(widest, angle);
          b.weights.push_back(seen ? 1 : 0);
          b.corners_px.push_back(q + Eigen::Vector2d(noise(random), noise(random)));
        }
        if (std::count(b.weights.begin(), b.weights.end(), 1.0) >= 20) scene.observations.boards.push_back(b);
      }
    }
  CHECK(widest > 80 * M_PI / 180);
  CalibrationOptions options;
  options.solve.lens = Lens::splined;
  options.most_folds = 0;
  const Calibration c = calibrate(scene.observations, scene.recording, options);
  std::printf("fisheye: rms %.3f px, %d outliers of %d\n", c.solution.rms_px, c.solution.outliers,
              c.solution.outliers + c.solution.inliers);
  CHECK(c.solution.converged);
  CHECK(c.solution.rms_unweighted_px < 0.11);
  CHECK(c.solution.outliers < 20);
  for (const RigCamera& rc : c.rig.cameras) CHECK(rc.determined);
  const auto errors = aligned_errors(c.rig, scene.truth);
  for (std::size_t i = 0; i < errors.size(); ++i) {
    CHECK(errors[i].norm() < 5e-4);
    for (int axis = 0; axis < 3; ++axis)
      CHECK(std::abs(errors[i][axis]) <= 4.5 * c.rig.cameras[i].position_sigma_m[axis]);
  }
  // With pinhole-like lenses it is not good.
  options.solve.lens = Lens::opencv4;
  CHECK_FALSE(calibrate(scene.observations, scene.recording, options).good);
}
