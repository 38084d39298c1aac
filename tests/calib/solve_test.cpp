#include <cmath>
#include <random>

#include "capture/synthetic/synthetic_source.h"
#include "core/error.h"
#include "tests/calib/solve_scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;
using Catch::Contains;

namespace {

/// The project's own rig as its default is, with the exact corners of its boards, plus noise.
Scene synthetic_scene(double noise_px = 0, std::uint64_t seed = 1) {
  synthetic::SyntheticOptions options;
  options.rig.seed = seed;
  const synthetic::TrueRig rig = make_rig(options.rig);
  Scene scene;
  scene.recording.rows = options.rig.rows;
  scene.recording.cols = options.rig.cols;
  for (const RigCamera& rc : rig.rig.cameras) {
    scene.truth.push_back(rc.camera);
    scene.recording.cameras.push_back({rc.camera.name, rc.row, rc.col});
    scene.observations.camera_names.push_back(rc.camera.name);
    scene.observations.size_px.emplace_back(rc.camera.width, rc.camera.height);
  }
  scene.observations.board = parse_board("chessboard:10x7:40mm");
  std::mt19937_64 random(seed);
  std::normal_distribution<double> noise(0, noise_px);
  for (const Pose& pose : board_poses(options)) {
    const int set = static_cast<int>(scene.observations.set_names.size());
    scene.observations.set_names.push_back(std::to_string(set));
    for (std::size_t c = 0; c < scene.truth.size(); ++c) {
      BoardObservation b{static_cast<int>(c), set, board_pixels(options.board, scene.truth[c], pose), {}};
      const bool whole = std::all_of(b.corners_px.begin(), b.corners_px.end(), [&](const auto& q) {
        return q.x() >= 0 && q.y() >= 0 && q.x() <= options.rig.width - 1 && q.y() <= options.rig.height - 1;
      });
      if (!whole) continue;
      if (noise_px > 0)
        for (Eigen::Vector2d& q : b.corners_px) q += Eigen::Vector2d(noise(random), noise(random));
      scene.observations.boards.push_back(std::move(b));
    }
  }
  return scene;
}

CalibrationOptions exact_options() {
  CalibrationOptions options;
  options.solve.regularise = false;
  options.most_folds = 0;
  return options;
}

/// Centres, focal lengths and lattice to 1e-6, relative to the spacing and the focal length.
void check_exact(const Scene& scene) {
  const Calibration c = calibrate(scene.observations, scene.recording, exact_options());
  CHECK(c.solution.converged);
  CHECK(c.good);
  CHECK(c.solution.outliers == 0);
  const Layout truth = true_layout(scene);
  const double spacing = std::max(truth.s_step_m.norm(), truth.t_step_m.norm());
  for (const Eigen::Vector3d& e : aligned_errors(c.rig, scene.truth)) CHECK(e.norm() < 1e-6 * spacing);
  CHECK((c.rig.s_step_m - truth.s_step_m).norm() < 1e-6 * spacing);
  CHECK((c.rig.t_step_m - truth.t_step_m).norm() < 1e-6 * spacing);
  CHECK((c.rig.lattice_origin_m - truth.origin_m).norm() < 1e-6 * spacing);
  for (std::size_t i = 0; i < scene.truth.size(); ++i) {
    const RigCamera& camera = c.rig.cameras[i];
    CHECK(camera.determined);
    for (int axis = 0; axis < 2; ++axis)
      CHECK(camera.camera.intrinsics[axis] == Approx(scene.truth[i].intrinsics[axis]).epsilon(1e-6));
    CHECK((camera.off_lattice_m - truth.off_lattice_m[i]).norm() < 1e-6 * spacing);
    CHECK(camera.row == scene.recording.cameras[i].row);
    CHECK(camera.col == scene.recording.cameras[i].col);
  }
}

/// Over the seeds: 99 % of the centres' errors within 3 sigma, normalised rms near 1.
template <class MakeScene>
void check_sigmas(MakeScene make) {
  double sum_sq = 0;
  int count = 0, within = 0;
  for (unsigned seed = 1; seed <= 3; ++seed) {
    const Scene scene = make(seed);
    CalibrationOptions options;
    options.most_folds = 0;
    const Calibration c = calibrate(scene.observations, scene.recording, options);
    CHECK(c.solution.noise_px == Approx(0.3).epsilon(0.05));
    const auto errors = aligned_errors(c.rig, scene.truth);
    for (std::size_t i = 0; i < errors.size(); ++i) {
      const Eigen::Vector3d z = errors[i].cwiseQuotient(c.rig.cameras[i].position_sigma_m);
      sum_sq += z.squaredNorm();
      within += static_cast<int>((z.array().abs() < 3).count());
      count += 3;
    }
  }
  std::printf("normalised rms %.3f, %d of %d within 3 sigma\n", std::sqrt(sum_sq / count), within, count);
  CHECK(within >= 0.99 * count);
  CHECK(std::sqrt(sum_sq / count) > 0.8);
  CHECK(std::sqrt(sum_sq / count) < 1.25);
}

}  // namespace

TEST_CASE("exact corners give the rig exactly: full grid") { check_exact(make_scene(5, 5, 8)); }
TEST_CASE("exact corners give the rig exactly: the synthetic rig") { check_exact(synthetic_scene()); }
TEST_CASE("exact corners give the rig exactly: missing cameras") {
  check_exact(make_scene(3, 3, 8, {"r0c0", "r1c1", "r2c1"}));
}
TEST_CASE("exact corners give the rig exactly: a row and a column") {
  check_exact(make_scene(1, 7, 8));
  check_exact(make_scene(6, 1, 8));
}

TEST_CASE("a grid recorded from its other end is counted by geometry") {
  Scene scene = make_scene(2, 4, 8);
  for (RecordedCamera& camera : scene.recording.cameras) camera.col = 3 - camera.col;
  const Calibration c = calibrate(scene.observations, scene.recording, exact_options());
  for (std::size_t i = 0; i < scene.truth.size(); ++i)
    CHECK(c.rig.cameras[i].col == 3 - scene.recording.cameras[i].col);
  CHECK(c.rig.s_step_m.x() == Approx(0.1).margin(0.005));
}

TEST_CASE("rows and columns are counted along the centres where the recorded grid does not fit them") {
  // Three rows of three, one camera missing; recorded as one row, as one column, with two names swapped.
  const Scene truth = make_scene(3, 3, 8, {"r1c2"});
  const auto check = [&](const Scene& scene) {
    const Calibration c = calibrate(scene.observations, scene.recording, exact_options());
    CHECK(c.rig.rows == 3);
    CHECK(c.rig.cols == 3);
    for (std::size_t i = 0; i < scene.truth.size(); ++i) {
      CHECK(c.rig.cameras[i].row == truth.recording.cameras[i].row);
      CHECK(c.rig.cameras[i].col == truth.recording.cameras[i].col);
    }
    REQUIRE(c.notes.size() == 1);
    CHECK_THAT(c.notes[0], Contains("recorded grid") && Contains("3x3"));
  };
  Scene row = truth, column = truth, swapped = truth;
  for (std::size_t i = 0; i < truth.truth.size(); ++i) {
    row.recording.cameras[i].row = column.recording.cameras[i].col = 0;
    row.recording.cameras[i].col = column.recording.cameras[i].row = static_cast<int>(i);
  }
  row.recording.rows = column.recording.cols = 1;
  row.recording.cols = column.recording.rows = 8;
  std::swap(swapped.recording.cameras[0].row, swapped.recording.cameras[7].row);
  std::swap(swapped.recording.cameras[0].col, swapped.recording.cameras[7].col);
  for (const Scene& scene : {row, column, swapped}) check(scene);

  // A row recorded as a column: the pictures stay upright.
  Scene line = make_scene(1, 5, 8);
  line.recording.rows = 5;
  line.recording.cols = 1;
  for (RecordedCamera& camera : line.recording.cameras) std::swap(camera.row, camera.col);
  const Calibration c = calibrate(line.observations, line.recording, exact_options());
  CHECK(c.rig.rows == 1);
  CHECK(c.rig.cols == 5);
  CHECK(c.rig.cameras[0].camera.cam_from_rig.R(0, 0) > 0.9);
}

TEST_CASE("corners in the other order of an ambiguous board are brought into one") {
  Scene scene = make_scene(2, 3, 8);
  // Leave out the last column of corners: 9x7 looks the same turned by 180 degrees.
  scene.observations.board = parse_board("chessboard:9x7:40mm");
  int i = 0;
  for (BoardObservation& b : scene.observations.boards) {
    std::vector<Eigen::Vector2d> corners;
    for (int k = 0; k < 70; ++k)
      if (k % 10 < 9) corners.push_back(b.corners_px[k]);
    if (++i % 3 == 0) std::reverse(corners.begin(), corners.end());
    b.corners_px = corners;
  }
  check_exact(scene);
}

TEST_CASE("sigmas are those of the errors that noisy corners make") {
  check_sigmas([](unsigned seed) { return make_scene(5, 5, 8, {}, 0.3, seed); });
  check_sigmas([](unsigned seed) { return synthetic_scene(0.3, seed); });
}

/// Mean square over the cameras that see X, a point in the rig's frame, of what their pictures of it by the
/// estimate and by the truth differ in, but for a shift and a change of disparity that they share.
double ghosting_error_sq(const Calibration& c, const Scene& scene, const Eigen::Matrix4d& truth_from_rig,
                         const Eigen::Vector3d& X) {
  const Eigen::Vector3d Y = (truth_from_rig * X.homogeneous()).head<3>();
  std::vector<Eigen::Vector2d> errors, places;
  for (std::size_t i = 0; i < scene.truth.size(); ++i) {
    const Camera &estimate = c.rig.cameras[i].camera, &truth = scene.truth[i];
    const Eigen::Vector2d q = project(estimate, {estimate.cam_from_rig * X})[0];
    if (!(q.x() >= 0 && q.y() >= 0 && q.x() <= 799 && q.y() <= 599)) continue;
    errors.emplace_back(q - project(truth, {truth.cam_from_rig * Y})[0]);
    places.emplace_back(estimate.cam_from_rig.centre().head<2>());
  }
  const auto n = static_cast<Eigen::Index>(errors.size());
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(2 * n, 3);
  Eigen::VectorXd e(2 * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    G(2 * i, 0) = G(2 * i + 1, 1) = 1;
    G.block<2, 1>(2 * i, 2) = places[i];
    e.segment<2>(2 * i) = errors[i];
  }
  return (e - G * G.colPivHouseholderQr().solve(e)).squaredNorm() / static_cast<double>(n);
}

TEST_CASE("ghosting is as large as the errors that noisy corners make") {
  double sum_sq = 0;
  int count = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    const Scene scene = make_scene(3, 3, 8, {}, 0.3, seed);
    CalibrationOptions options;
    options.most_folds = 0;
    const Calibration c = calibrate(scene.observations, scene.recording, options);
    Eigen::Matrix3Xd a(3, 9), b(3, 9);
    std::vector<int> all;
    for (int i = 0; i < 9; ++i) {
      a.col(i) = c.rig.cameras[i].camera.cam_from_rig.centre();
      b.col(i) = scene.truth[i].cam_from_rig.centre();
      all.push_back(i);
    }
    const Eigen::Matrix4d truth_from_rig = Eigen::umeyama(a, b, false);
    const std::vector<double>& lens = c.rig.cameras[0].camera.intrinsics;
    for (const double depth : {1.2, 4.0, 1e6}) {
      const Ghosting stated = ghosting(c.solution, c.layout, all, {depth}).front();
      CHECK(stated.rms_px <= stated.worst_px);
      double error_sq = 0;
      for (int j = 0; j < 3; ++j)
        for (int i = 0; i < 5; ++i) {
          const Eigen::Vector2d xy(800 * (0.2 * i - 0.4) / lens[0], 600 * (0.4 * j - 0.4) / lens[1]);
          error_sq += ghosting_error_sq(c, scene, truth_from_rig, depth * xy.homogeneous()) / 15;
        }
      sum_sq += error_sq / std::pow(stated.rms_px, 2);
      ++count;
    }
  }
  std::printf("ghosting over its sigma, rms %.3f\n", std::sqrt(sum_sq / count));
  CHECK(std::sqrt(sum_sq / count) > 0.85);
  CHECK(std::sqrt(sum_sq / count) < 1.15);
}

TEST_CASE("ghosting that is not known is no number") {
  const Scene scene = make_scene(2, 2, 8, {}, 0.3);
  Calibration c = calibrate(scene.observations, scene.recording, {});
  REQUIRE(c.ghosting.size() == 12);
  CHECK(c.ghosting.front().worst_px > 0);
  CHECK(ghosting(c.solution, c.layout, {0}, {1}).empty());
  // Nearer than the cameras' fields meet.
  const Ghosting near = ghosting(c.solution, c.layout, {0, 1, 2, 3}, {0.01}).front();
  CHECK(std::isnan(near.worst_px));
  CHECK(near.worst_camera == -1);
  JointSolution broken = c.solution;
  broken.sigma_px = std::nan("");
  CHECK(std::isnan(ghosting(broken, c.layout, {0, 1, 2, 3}, {1}).front().worst_px));
  broken = c.solution;
  broken.camera_covariance(3, 3) = std::nan("");
  CHECK(std::isnan(ghosting(broken, c.layout, {0, 1, 2, 3}, {1}).front().rms_px));
}

TEST_CASE("a camera that sees fewer boards than the others is the one that ghosts") {
  Scene scene = make_scene(2, 3, 12, {}, 0.3);
  std::erase_if(scene.observations.boards, [](const auto& b) { return b.camera == 4 && b.set > 1; });
  const Calibration c = calibrate(scene.observations, scene.recording, {});
  REQUIRE(c.rig.cameras[4].determined);
  for (const Ghosting& g : c.ghosting) CHECK(g.worst_camera == 4);
}

TEST_CASE("the range that ghosting leaves") {
  const auto row = [](double depth, double px) { return Ghosting{depth, px, px, 0}; };
  const double inf = INFINITY, nan = std::nan("");
  const auto range = good_range({row(1, 0.2), row(2, 0.1), row(4, 0.05), row(8, nan), row(inf, 0.01)}, 0.1);
  REQUIRE(range);
  CHECK(range->from_m == 2);
  CHECK(range->to_m == 4);
  CHECK_FALSE(good_range({row(1, 0.2), row(2, nan)}, 0.1));
  CHECK(ghosting_text({}).empty());
  CHECK(ghosting_text({row(1, nan)}).empty());
  CHECK_THAT(ghosting_text({row(1, nan), row(2, 0.3), row(inf, 0.4)}),
             Contains("0.30 px") && Contains("2.00 m"));
  CHECK_THAT(ghosting_text({row(1, 0.3), row(2, 0.05), row(inf, 0.04)}), Contains("2.00 m and infinity"));
}

TEST_CASE("the richer lens models find the same rig") {
  const Scene scene = make_scene(2, 3, 10, {}, 0.05);
  for (const Lens lens : {Lens::opencv8, Lens::splined}) {
    CalibrationOptions options;
    options.solve.lens = lens;
    options.most_folds = 0;
    const Calibration c = calibrate(scene.observations, scene.recording, options);
    CHECK(c.solution.converged);
    CHECK(c.solution.rms_unweighted_px < 0.06);
    for (const RigCamera& camera : c.rig.cameras) CHECK(camera.determined);
    for (const Eigen::Vector3d& e : aligned_errors(c.rig, scene.truth)) CHECK(e.norm() < 0.002);
  }
}

TEST_CASE("boards that are tiny and far away do not determine the cameras") {
  const Scene scene = make_scene(2, 2, 2, {}, 0.3, 1, 40);
  const Calibration c = calibrate(scene.observations, scene.recording, {});
  CHECK_FALSE(c.good);
  for (const RigCamera& camera : c.rig.cameras) CHECK_FALSE(camera.determined);
}

TEST_CASE("a set whose corners are noisier than their own sigmas know weighs less, and its corners stay") {
  Scene scene = make_scene(3, 3, 8, {}, 0.05);
  add_noise(scene, 0.3, 5, [](const BoardObservation& b) { return b.set == 2; });
  const auto solve = [&](bool reweight) {
    CalibrationOptions options;
    options.solve.reweight = reweight;
    return calibrate(scene.observations, scene.recording, options);
  };
  const auto rms_error = [&](const Calibration& c) {
    double sum = 0;
    for (const Eigen::Vector3d& e : aligned_errors(c.rig, scene.truth)) sum += e.squaredNorm();
    return std::sqrt(sum / static_cast<double>(scene.truth.size()));
  };
  const Calibration alike = solve(false), weighed = solve(true);
  std::printf("noisy set weighed alike: centres %.3f mm, %d outliers; less: %.3f mm, %d\n",
              1e3 * rms_error(alike), alike.solution.outliers, 1e3 * rms_error(weighed),
              weighed.solution.outliers);
  CHECK(rms_error(weighed) < 0.9 * rms_error(alike));
  CHECK(weighed.solution.outliers < alike.solution.outliers / 4);
  CHECK(weighed.solution.noise_px == Approx(0.05).epsilon(0.2));
  CHECK(weighed.solution.rms_px < 0.06);
  CHECK(weighed.solution.rms_unweighted_px > 0.09);
  std::string notes;
  for (const std::string& note : weighed.notes) notes += note;
  CHECK_THAT(notes,
             Contains("the board of set " + scene.observations.set_names[2]) && Contains("weighed less"));
  // Of equal sets none is singled out.
  const Scene equal = make_scene(3, 3, 8, {}, 0.05);
  const Calibration c = calibrate(equal.observations, equal.recording, {});
  CHECK(c.solution.rms_px == Approx(c.solution.rms_unweighted_px).epsilon(1e-9));
}

TEST_CASE("outliers are found and do no harm") {
  Scene scene = make_scene(3, 3, 8, {}, 0.05);
  for (std::size_t i = 0; i < scene.observations.boards.size(); i += 6)
    scene.observations.boards[i].corners_px[i % 70] += Eigen::Vector2d(4, -3);
  const Calibration c = calibrate(scene.observations, scene.recording, {});
  CHECK(c.solution.outliers >= 12);
  CHECK(c.solution.outliers <= 16);
  for (std::size_t i = 0; i < scene.observations.boards.size(); i += 6) CHECK(c.solution.outlier[i][i % 70]);
  CHECK(c.solution.rms_unweighted_px == Approx(0.05).epsilon(0.1));
  REQUIRE(c.cross_validation_px);
  CHECK(*c.cross_validation_px < 0.1);
}

TEST_CASE("a corner that is not finite takes no part, nor does a view with fewer than six") {
  Scene scene = make_scene(2, 2, 6);
  scene.observations.boards[0].corners_px[5].x() = std::nan("");
  scene.observations.boards[3].corners_px[7].y() = INFINITY;
  check_exact(scene);
  for (std::size_t k = 5; k < 70; ++k) scene.observations.boards[0].corners_px[k].x() = std::nan("");
  const Calibration c = calibrate(scene.observations, scene.recording, exact_options());
  CHECK(c.observations.boards.size() == scene.observations.boards.size() - 1);
  CHECK_THAT(c.notes.at(0), Contains("fewer than 6 corners"));
  for (BoardObservation& b : scene.observations.boards)
    for (Eigen::Vector2d& q : b.corners_px) q.x() = std::nan("");
  CHECK_THROWS_WITH(calibrate(scene.observations, scene.recording), Contains("fewer than 6 finite corners"));
}

TEST_CASE("boards are read and refused") {
  CHECK(parse_board("chessboard:28x17:2cm").square_m == Approx(0.02));
  CHECK(board_spec(parse_board("chessboard:28x17:0.02m")) == "chessboard:28x17:20mm");
  for (const char* bad :
       {"", "circles:3x4:1mm", "chessboard:28x17", "chessboard:28x17:20", "chessboard:2x9:1mm",
        "chessboard:7x7:1mm", "chessboard:9x6:-1mm", "chessboard:9x6:nanmm"})
    CHECK_THROWS_AS(parse_board(bad), Error);
}
