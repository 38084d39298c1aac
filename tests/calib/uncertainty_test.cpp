#include <cmath>

#include "core/parallel.h"
#include "tests/calib/uncertainty_tally.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;
using Catch::Contains;

TEST_CASE("stated sigmas are those of the errors, and the errors at the Cramer-Rao bound") {
  constexpr int kRigs = 60;
  std::vector<Tallies> each(kRigs);
  parallel_for(kRigs, [&](int i) { each[i] = tally(static_cast<unsigned>(i + 1), 0.3); });
  Tallies all;
  for (const Tallies& t : each) all.add(t);
  const auto check = [](const char* what, const Tally& t) {
    std::printf("%s: error over sigma %.3f, over bound %.3f (%d)\n", what, t.z(), t.over_bound(), t.count);
    CHECK(t.z() > 0.9);
    CHECK(t.z() < 1.15);
    CHECK(t.over_bound() < 1.1);
  };
  check("centres", all.centres);
  check("rotations", all.rotations);
  check("focal lengths", all.focals);
  check("lattice", all.lattice);
}

TEST_CASE("aligned covariances do not know what all cameras do together") {
  const std::vector<Eigen::Vector3d> plane = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0.1}};
  const std::vector<Eigen::Vector3d> line = {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}};
  for (const auto& centres : {plane, line}) {
    const auto n = static_cast<Eigen::Index>(centres.size());
    for (int k = 0; k < 6; ++k) {
      Eigen::VectorXd x(6 * n);
      for (Eigen::Index i = 0; i < n; ++i) {
        Eigen::Vector3d omega = Eigen::Vector3d::Zero(), tau = omega;
        (k < 3 ? omega : tau)[k % 3] = 1;
        x.segment<6>(6 * i) << omega, omega.cross(centres[i]) + tau;
      }
      CHECK(rigidly_aligned_poses(x * x.transpose(), centres).cwiseAbs().maxCoeff() < 1e-9);
    }
  }
  // A camera that turns by itself keeps its turn, but for what the line leaves free.
  Eigen::VectorXd x = Eigen::VectorXd::Zero(18);
  x[1] = 1;
  CHECK(rigidly_aligned_poses(x * x.transpose(), line)(1, 1) == Approx(1));
  x.setZero();
  x[0] = 1;  // about the line: a third of it is all cameras' turn
  CHECK(rigidly_aligned_poses(x * x.transpose(), line)(0, 0) == Approx(4.0 / 9));
}

TEST_CASE("projection maps are those of the pictures' errors") {
  // Against boards: the truth is aligned by the boards' mean motion, as the maps are.
  double z_sq = 0;
  int count = 0;
  for (unsigned seed = 1; seed <= 12; ++seed) {
    const Scene noisy = make_scene(2, 2, 8, {}, 0.3, seed), exact = make_scene(2, 2, 8, {}, 0, seed);
    CalibrationOptions options;
    options.most_folds = 0;
    const Calibration c = calibrate(noisy.observations, noisy.recording, options);
    options.solve.regularise = false;
    const Calibration t = calibrate(exact.observations, exact.recording, options);
    for (std::size_t i = 0; i < c.cameras.size(); ++i) {
      REQUIRE(c.cameras[i].maps.size() == 3);
      const ProjectionMap& map = c.cameras[i].maps[1];
      const Camera &est = c.solution.cameras[i], &tru = t.solution.cameras[i];
      std::size_t cell = 0;
      for (int y = 0; y < map.ny; ++y)
        for (int x = 0; x < map.nx; ++x, ++cell) {
          const Eigen::Vector2d q((x + 0.5) * 800 / map.nx - 0.5, (y + 0.5) * 600 / map.ny - 0.5);
          const Eigen::Vector3d p = est.cam_from_rig.inverse() * (map.distance_m * unproject(est, {q})[0]);
          Eigen::Vector3d moved = Eigen::Vector3d::Zero();
          for (int s = 0; s < 8; ++s)
            moved += t.solution.ref_from_board[s] * (c.solution.ref_from_board[s].inverse() * p) / 8;
          const Eigen::Vector2d e = project(tru, {tru.cam_from_rig * moved})[0] - q;
          // sigma is that of the worst direction: at most half of e's square lies across it.
          z_sq += e.squaredNorm() / std::pow(map.sigma_px[cell], 2);
          ++count;
        }
    }
  }
  const double z = std::sqrt(z_sq / count);
  std::printf("projections: error over sigma %.3f (1 to 1.41 is right)\n", z);
  CHECK(z > 0.95);
  CHECK(z < 1.5);
}
