#pragma once

#include <algorithm>
#include <random>
#include <set>
#include <vector>

#include "calib/check/check_rig.h"
#include "capture/synthetic/rig.h"

namespace stuv::test {

/// Points that the true cameras see, and the evidence that find_evidence would make of their pictures.
struct CheckSceneOptions {
  int points = 400;
  double near_m = 1, far_m = 4;
  double noise_px = 0.4;
  double outliers = 0.03;  ///< sightings somewhere else
  int neighbours = 6;
};

inline Rig true_rig(int rows, int cols, unsigned seed) {
  synthetic::RigOptions options;
  options.rows = rows;
  options.cols = cols;
  options.seed = seed;
  return synthetic::make_rig(options).rig;
}

inline SceneEvidence evidence_of(const std::vector<Camera>& cameras, unsigned seed,
                                 const CheckSceneOptions& options = {}) {
  std::mt19937 random(seed);
  const auto uniform = [&](double a, double b) {
    return std::uniform_real_distribution<double>(a, b)(random);
  };
  std::normal_distribution<double> noise(0, options.noise_px);
  SceneEvidence evidence;
  evidence.cameras.resize(cameras.size());
  for (SceneSight& sight : evidence.cameras) sight.present = true, sight.features = 1000, sight.level = 0.4;
  for (int i = 0; i < options.points; ++i) {
    const double z = 1 / uniform(1 / options.far_m, 1 / options.near_m);
    const Eigen::Vector3d X(0.5 * z * uniform(-1, 1), 0.4 * z * uniform(-1, 1), z);
    SceneTrack track;
    for (std::size_t c = 0; c < cameras.size(); ++c) {
      const Eigen::Vector3d x = cameras[c].cam_from_rig * X;
      if (x.z() < 0.01) continue;
      Eigen::Vector2d q = project(cameras[c], {x})[0];
      if (q.x() < 0 || q.y() < 0 || q.x() > cameras[c].width - 1 || q.y() > cameras[c].height - 1) continue;
      if (uniform(0, 1) < 0.4) continue;  // not every camera finds every point
      if (uniform(0, 1) < options.outliers) q = {uniform(0, cameras[c].width), uniform(0, cameras[c].height)};
      q += Eigen::Vector2d(noise(random), noise(random));
      track.camera.push_back(static_cast<int>(c));
      track.at_px.push_back(q);
    }
    if (track.camera.size() >= 2) evidence.tracks.push_back(std::move(track));
  }
  for (std::size_t a = 0; a < cameras.size(); ++a)
    for (std::size_t b = a + 1; b < cameras.size(); ++b) {
      ScenePair pair{static_cast<int>(a), static_cast<int>(b), {}};
      for (const SceneTrack& t : evidence.tracks) {
        const auto ia = std::find(t.camera.begin(), t.camera.end(), pair.a),
                   ib = std::find(t.camera.begin(), t.camera.end(), pair.b);
        if (ia != t.camera.end() && ib != t.camera.end())
          pair.matches.push_back({t.at_px[ia - t.camera.begin()], t.at_px[ib - t.camera.begin()]});
      }
      if (pair.matches.size() >= 20) evidence.pairs.push_back(std::move(pair));
    }
  return evidence;
}

inline std::vector<Camera> cameras_in(const Rig& rig) {
  std::vector<Camera> cameras;
  for (const RigCamera& rc : rig.cameras) cameras.push_back(rc.camera);
  return cameras;
}

/// The camera turned [rad, in its frame] and shifted [m, in the rig's].
inline void move(Camera& camera, const Eigen::Vector3d& turn, const Eigen::Vector3d& shift) {
  const Eigen::Vector3d c = camera.cam_from_rig.centre() + shift;
  camera.cam_from_rig.R = rotation_from_vector(turn) * camera.cam_from_rig.R;
  camera.cam_from_rig.t = -(camera.cam_from_rig.R * c);
}

}  // namespace stuv::test
