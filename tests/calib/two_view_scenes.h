#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <random>
#include <vector>

#include "calib/two_view/fundamental.h"
#include "core/pose.h"

namespace stuv::test {

/// Two cameras of 640x480 before a scene, and what they see of it: matches to work on and exact ones to judge
/// by.
struct TwoViewScene {
  Eigen::Matrix3d K, F;
  Pose b_from_a;
  Matches exact, truth;
};

struct TwoViewSceneOptions {
  int points = 200;
  double on_plane = 0;    ///< share of the points
  bool rotation = false;  ///< the camera only turns
  bool forward = false;   ///< towards the scene: both epipoles in the pictures
  double baseline = 0.5;
};

class SceneMaker {
 public:
  explicit SceneMaker(unsigned seed) : random_(seed) {}

  double uniform() { return std::uniform_real_distribution<double>(-1, 1)(random_); }
  Eigen::Vector2d noise(double sigma) {
    std::normal_distribution<double> normal(0, sigma);
    return sigma > 0 ? Eigen::Vector2d(normal(random_), normal(random_)) : Eigen::Vector2d(0, 0);
  }
  Eigen::Vector2d anywhere() { return {320 + 319 * uniform(), 240 + 239 * uniform()}; }

  TwoViewScene make(const TwoViewSceneOptions& options = {}) {
    TwoViewScene s;
    s.K << 700, 0, 320, 0, 700, 240, 0, 0, 1;
    s.b_from_a.R = rotation_from_vector(0.15 * Eigen::Vector3d(uniform(), uniform(), uniform()));
    const Eigen::Vector3d t = options.forward ? Eigen::Vector3d(0.1 * uniform(), 0.1 * uniform(), -1)
                                              : Eigen::Vector3d(uniform(), uniform(), 0.4 * uniform());
    s.b_from_a.t =
        options.rotation ? Eigen::Vector3d(0, 0, 0) : Eigen::Vector3d(options.baseline * t.normalized());
    const Eigen::Matrix3d Ki = s.K.inverse();
    s.F = unit_scale(Ki.transpose() * cross_matrix(s.b_from_a.t) * s.b_from_a.R * Ki);
    const Eigen::Vector3d normal = Eigen::Vector3d(0.4 * uniform(), 0.4 * uniform(), 1).normalized();
    const auto see = [&](bool plane) {
      while (true) {
        const Eigen::Vector2d a = anywhere();
        const Eigen::Vector3d ray = Ki * a.homogeneous();
        const double depth = plane ? 4 / normal.dot(ray) : 4 + 2.5 * uniform();
        const Eigen::Vector3d y = s.K * (s.b_from_a * Eigen::Vector3d(depth * ray));
        if (y.z() < 0.1) continue;
        const Eigen::Vector2d b = y.hnormalized();
        if (b.x() >= 0 && b.y() >= 0 && b.x() < 640 && b.y() < 480) return Match{a, b};
      }
    };
    for (int i = 0; i < options.points; ++i) s.exact.push_back(see(i < options.on_plane * options.points));
    for (int i = 0; i < 12; ++i) s.truth.push_back(see(false));
    return s;
  }

  /// Gaussian noise on both points; the first `outliers` of them, in parts of 1, get a b from anywhere.
  Matches measured(const Matches& exact, double sigma_px, double outliers = 0) {
    Matches m = exact;
    std::shuffle(m.begin(), m.end(), random_);
    for (std::size_t i = 0; i < m.size(); ++i) {
      if (static_cast<double>(i) < outliers * static_cast<double>(m.size())) m[i].b = anywhere();
      m[i].a += noise(sigma_px);
      m[i].b += noise(sigma_px);
    }
    return m;
  }

  std::mt19937& random() { return random_; }

 private:
  std::mt19937 random_;
};

inline double median_line_distance(const Eigen::Matrix3d& F, const Matches& truth) {
  std::vector<double> d;
  for (const Match& m : truth) d.push_back(line_distance(F, m));
  std::sort(d.begin(), d.end());
  return 0.5 * (d[(d.size() - 1) / 2] + d[d.size() / 2]);
}

}  // namespace stuv::test
