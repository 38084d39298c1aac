#include <cmath>

#include "core/parallel.h"
#include "tests/calib/solve_scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;
using Catch::Contains;

namespace {

/// Sums of squares of errors over their stated sigma, and of errors and of Cramer-Rao bounds by themselves.
struct Tally {
  double z_sq = 0, error_sq = 0, bound_sq = 0;
  int count = 0;
  void add(double error, double sigma, double bound) {
    z_sq += std::pow(error / sigma, 2);
    error_sq += std::pow(error / bound, 2);
    bound_sq += 1;
    ++count;
  }
  void add(const Tally& other) {
    z_sq += other.z_sq, error_sq += other.error_sq, bound_sq += other.bound_sq, count += other.count;
  }
  double z() const { return std::sqrt(z_sq / count); }
  /// Root mean square of the errors over their bounds.
  double over_bound() const { return std::sqrt(error_sq / bound_sq); }
};

struct Tallies {
  Tally centres, rotations, focals, lattice;
};

/// The truth in the frame of the estimate, by rigid alignment of the centres.
Pose rig_from_truth(const Rig& rig, const std::vector<Camera>& truth) {
  const auto n = static_cast<Eigen::Index>(truth.size());
  Eigen::Matrix3Xd a(3, n), b(3, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    a.col(i) = truth[i].cam_from_rig.centre();
    b.col(i) = rig.cameras[i].camera.cam_from_rig.centre();
  }
  const Eigen::Matrix4d T = Eigen::umeyama(a, b, false);
  return {T.topLeftCorner<3, 3>(), T.topRightCorner<3, 1>()};
}

/// One noisy rig against its truth. The bound: the covariance at the true corners, without the pull of
/// regularisation, at the true noise.
Tallies tally(unsigned seed, double noise_px) {
  const Scene noisy = make_scene(3, 3, 8, {}, noise_px, seed), exact = make_scene(3, 3, 8, {}, 0, seed);
  CalibrationOptions options;
  options.most_folds = 0;
  const Calibration c = calibrate(noisy.observations, noisy.recording, options);
  options.solve.regularise = false;
  Calibration bound = calibrate(exact.observations, exact.recording, options);
  const double scale = noise_px / bound.solution.noise_px;
  const Pose from_truth = rig_from_truth(c.rig, noisy.truth);
  Tallies t;
  for (std::size_t i = 0; i < noisy.truth.size(); ++i) {
    const RigCamera& rc = c.rig.cameras[i];
    const Eigen::Vector3d dc =
        rc.camera.cam_from_rig.centre() - from_truth * noisy.truth[i].cam_from_rig.centre();
    const Eigen::Matrix3d true_R = noisy.truth[i].cam_from_rig.R * from_truth.R.transpose();
    const Eigen::Vector3d turn = vector_from_rotation(rc.camera.cam_from_rig.R.transpose() * true_R);
    for (int k = 0; k < 3; ++k) {
      t.centres.add(dc[k], rc.position_sigma_m[k], scale * bound.rig.cameras[i].position_sigma_m[k]);
      t.rotations.add(turn[k], c.cameras[i].rotation_sigma_rad[k],
                      scale * bound.cameras[i].rotation_sigma_rad[k]);
    }
    for (int k = 0; k < 2; ++k)
      t.focals.add(rc.camera.intrinsics[k] - noisy.truth[i].intrinsics[k], c.cameras[i].focal_sigma_px[k],
                   scale * bound.cameras[i].focal_sigma_px[k]);
  }
  const Layout truth = true_layout(noisy);
  t.lattice.add(c.rig.s_step_m.norm() - truth.s_step_m.norm(), c.lattice_sigma.s_spacing_m,
                scale * bound.lattice_sigma.s_spacing_m);
  t.lattice.add(c.rig.t_step_m.norm() - truth.t_step_m.norm(), c.lattice_sigma.t_spacing_m,
                scale * bound.lattice_sigma.t_spacing_m);
  return t;
}

}  // namespace

TEST_CASE("stated sigmas are those of the errors, and the errors at the Cramer-Rao bound") {
  constexpr int kRigs = 40;
  std::vector<Tallies> each(kRigs);
  parallel_for(kRigs, [&](int i) { each[i] = tally(static_cast<unsigned>(i + 1), 0.3); });
  Tallies all;
  for (const Tallies& t : each) {
    all.centres.add(t.centres);
    all.rotations.add(t.rotations);
    all.focals.add(t.focals);
    all.lattice.add(t.lattice);
  }
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
        const Eigen::Vector3d omega = k < 3 ? Eigen::Vector3d::Unit(k) : Eigen::Vector3d::Zero();
        const Eigen::Vector3d tau = k < 3 ? Eigen::Vector3d::Zero() : Eigen::Vector3d::Unit(k - 3);
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
