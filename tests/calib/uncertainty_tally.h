#pragma once

#include <cmath>
#include <vector>

#include "tests/calib/solve_scenes.h"

namespace stuv::test {

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
  void add(const Tallies& other) {
    centres.add(other.centres), rotations.add(other.rotations);
    focals.add(other.focals), lattice.add(other.lattice);
  }
};

/// One noisy rig against its truth. The bound: the covariance at the true corners, without the pull of
/// regularisation, at the true noise.
inline Tallies tally(unsigned seed, double noise_px, int rows = 3, int cols = 3, int boards = 8) {
  const Scene noisy = make_scene(rows, cols, boards, {}, noise_px, seed);
  const Scene exact = make_scene(rows, cols, boards, {}, 0, seed);
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

}  // namespace stuv::test
