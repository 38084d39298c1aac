#pragma once

#include <algorithm>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "calib/solve/calibrate.h"

namespace stuv::test {

struct Scene {
  Recording recording;
  Observations observations;
  std::vector<Camera> truth;
};

/// rows x cols cameras 0.1 m apart with jitter in place, direction and lens, and tilted boards before them.
inline Scene make_scene(int rows, int cols, int sets, const std::vector<std::string>& missing = {},
                        double noise_px = 0, unsigned seed = 1, double distance_m = 1.2) {
  std::mt19937_64 random(seed);
  const auto draw = [&] {
    // Sum of 12 uniforms: the same on every standard library.
    double sum = -6;
    for (int i = 0; i < 12; ++i) sum += static_cast<double>(random() >> 11) * 0x1p-53;
    return sum;
  };
  Scene scene;
  scene.recording.rows = rows;
  scene.recording.cols = cols;
  for (int r = 0; r < rows; ++r)
    for (int c = 0; c < cols; ++c) {
      Camera camera;
      camera.name = "r" + std::to_string(r) + "c" + std::to_string(c);
      camera.lens_model = "LENSMODEL_OPENCV4";
      const double f = 900 + 5 * draw();
      camera.intrinsics = {f,
                           f + draw(),
                           399.5 + 3 * draw(),
                           299.5 + 3 * draw(),
                           -0.05 + 0.005 * draw(),
                           0.02 + 0.003 * draw(),
                           3e-4 * draw(),
                           3e-4 * draw()};
      camera.width = 800;
      camera.height = 600;
      const Eigen::Vector3d turn(0.01 * draw(), 0.01 * draw(), 0.01 * draw());
      camera.cam_from_rig.R = rotation_from_vector(turn);
      const Eigen::Vector3d centre(0.1 * (c - 0.5 * (cols - 1)) + 0.003 * draw(),
                                   0.1 * (r - 0.5 * (rows - 1)) + 0.003 * draw(), 0.003 * draw());
      camera.cam_from_rig.t = -(camera.cam_from_rig.R * centre);
      if (std::find(missing.begin(), missing.end(), camera.name) != missing.end()) continue;
      scene.truth.push_back(camera);
      scene.recording.cameras.push_back({camera.name, r, c});
      scene.observations.camera_names.push_back(camera.name);
      scene.observations.size_px.emplace_back(800, 600);
    }
  scene.observations.board = parse_board("chessboard:10x7:40mm");
  const std::vector<Eigen::Vector3d> model = board_points(scene.observations.board);
  const Eigen::Vector3d middle(0.18, 0.12, 0);
  for (int s = 0; s < sets; ++s) {
    scene.observations.set_names.push_back(std::to_string(s));
    Pose pose;
    pose.R = rotation_from_vector({0.5 * std::cos(2.4 * s), 0.5 * std::sin(2.4 * s), 0.1 * draw()});
    pose.t = Eigen::Vector3d(0.15 * std::cos(1.7 * s), 0.1 * std::sin(1.7 * s), distance_m + 0.05 * (s % 4)) -
             pose.R * middle;
    for (std::size_t c = 0; c < scene.truth.size(); ++c) {
      std::vector<Eigen::Vector3d> points;
      for (const Eigen::Vector3d& p : model) points.push_back(scene.truth[c].cam_from_rig * (pose * p));
      BoardObservation b{static_cast<int>(c), s, project(scene.truth[c], points), {}};
      for (Eigen::Vector2d& q : b.corners_px) q += noise_px * Eigen::Vector2d(draw(), draw());
      scene.observations.boards.push_back(std::move(b));
    }
  }
  return scene;
}

/// The truth in the frame of the estimate, by rigid alignment of the centres.
/// More noise on the corners of the views that `which` picks.
template <class Which>
void add_noise(Scene& scene, double deviation_px, std::uint64_t seed, Which which) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> noise(0, deviation_px);
  for (BoardObservation& b : scene.observations.boards)
    if (which(b))
      for (Eigen::Vector2d& q : b.corners_px) {
        const double x = noise(random);
        q += Eigen::Vector2d(x, noise(random));
      }
}

inline Pose rig_from_truth(const Rig& rig, const std::vector<Camera>& truth) {
  const auto n = static_cast<Eigen::Index>(truth.size());
  Eigen::Matrix3Xd a(3, n), b(3, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    a.col(i) = truth[i].cam_from_rig.centre();
    b.col(i) = rig.cameras[i].camera.cam_from_rig.centre();
  }
  const Eigen::Matrix4d T = Eigen::umeyama(a, b, false);
  return {T.topLeftCorner<3, 3>(), T.topRightCorner<3, 1>()};
}

/// Estimated minus true centres after rigid alignment, in the frame of the estimate.
inline std::vector<Eigen::Vector3d> aligned_errors(const Rig& rig, const std::vector<Camera>& truth) {
  const Pose from_truth = rig_from_truth(rig, truth);
  std::vector<Eigen::Vector3d> errors;
  for (std::size_t i = 0; i < truth.size(); ++i)
    errors.push_back(rig.cameras[i].camera.cam_from_rig.centre() -
                     from_truth * truth[i].cam_from_rig.centre());
  return errors;
}

/// The lattice that the layout fit finds in the true centres.
inline Layout true_layout(const Scene& scene) {
  std::vector<PlacedCamera> placed;
  for (std::size_t i = 0; i < scene.truth.size(); ++i)
    placed.push_back(
        {scene.truth[i].cam_from_rig, scene.recording.cameras[i].row, scene.recording.cameras[i].col, true});
  return fit_layout(placed, scene.recording.rows, scene.recording.cols);
}

}  // namespace stuv::test
