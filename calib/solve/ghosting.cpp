#include "calib/solve/ghosting.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/solve/camera_sight.h"

namespace stuv {
namespace {

/// What one camera makes of a point: d e / d (its states), and its place (s, t).
struct Sight {
  int camera = 0;
  Eigen::Matrix<double, 2, Eigen::Dynamic> J;
  Eigen::Vector2d place;
};

class Sights {
 public:
  Sights(const JointSolution& solution, const Layout& layout, const std::vector<int>& which)
      : solution_(solution),
        ref_from_rig_(layout.rig_from_ref.inverse()),
        which_(which),
        lens_(lens_model_of(solution.cameras[which.front()])) {}

  /// The cameras that see a point of the rig's frame, x / z, y / z and 1 / z.
  std::vector<Sight> of(const Eigen::Vector2d& xy, double inverse_m) const {
    const FarPoint point{ref_from_rig_.R * xy.homogeneous() + inverse_m * ref_from_rig_.t, inverse_m};
    std::vector<Sight> sights;
    for (const int c : which_) {
      Sight sight{c, {}, {}};
      if (see(point, sight)) sights.push_back(std::move(sight));
    }
    return sights;
  }

 private:
  bool see(const FarPoint& point, Sight& sight) const {
    const Camera& camera = solution_.cameras[sight.camera];
    const std::optional<CameraSight> seen = camera_sight(camera, lens_, point);
    if (!seen || !seen->in_picture) return false;
    const Pose rig_from_cam = (camera.cam_from_rig * ref_from_rig_).inverse();  // cam_from_ref, here
    const Eigen::Rotation2Dd upright(std::atan2(rig_from_cam.R(1, 0), rig_from_cam.R(0, 0)));
    sight.J = upright.toRotationMatrix() * seen->by_states;
    sight.place = rig_from_cam.t.head<2>();
    return true;
  }

  const JointSolution& solution_;
  Pose ref_from_rig_;
  const std::vector<int>& which_;
  mrcal_lensmodel_t lens_;
};

Eigen::MatrixXd covariance_of(const std::vector<Sight>& sights, const JointSolution& solution) {
  const auto n = static_cast<Eigen::Index>(sights.size());
  const int k = solution.camera_states;
  Eigen::MatrixXd S(2 * n, 2 * n);
  for (Eigen::Index a = 0; a < n; ++a)
    for (Eigen::Index b = 0; b <= a; ++b) {
      const Eigen::Matrix2d block =
          sights[a].J * solution.camera_covariance.block(k * sights[a].camera, k * sights[b].camera, k, k) *
          sights[b].J.transpose();
      S.block<2, 2>(2 * a, 2 * b) = block;
      S.block<2, 2>(2 * b, 2 * a) = block.transpose();
    }
  return S;
}

/// Each camera's part of trace(P S P), P off the shifts and the change of disparity.
Eigen::VectorXd ghosting_variances(const std::vector<Sight>& sights, const Eigen::MatrixXd& S) {
  const auto n = static_cast<Eigen::Index>(sights.size());
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Sight& sight : sights) mean += sight.place / static_cast<double>(n);
  Eigen::MatrixXd G = Eigen::MatrixXd::Zero(2 * n, 3);
  for (Eigen::Index i = 0; i < n; ++i) {
    G(2 * i, 0) = G(2 * i + 1, 1) = 1 / std::sqrt(static_cast<double>(n));
    G.block<2, 1>(2 * i, 2) = sights[i].place - mean;
  }
  const double extent = G.col(2).norm();
  if (extent > 0) G.col(2) /= extent;
  const Eigen::MatrixXd P = Eigen::MatrixXd::Identity(2 * n, 2 * n) - G * G.transpose();
  const Eigen::VectorXd variance = (P * S * P).diagonal();
  return Eigen::VectorXd::NullaryExpr(n,
                                      [&](Eigen::Index i) { return variance[2 * i] + variance[2 * i + 1]; });
}

Ghosting ghosting_at(const Sights& sights, const JointSolution& solution, const Camera& reference,
                     double depth_m) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  Ghosting result{depth_m, kNaN, kNaN, -1};
  double sum_sq = 0, worst = -1;
  int count = 0;
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 5; ++i) {
      // A tenth of the picture in from its border.
      const Eigen::Vector2d xy(reference.width * (0.1 + 0.2 * i - 0.5) / reference.intrinsics[0],
                               reference.height * (0.1 + 0.4 * j - 0.5) / reference.intrinsics[1]);
      const std::vector<Sight> seen = sights.of(xy, 1 / depth_m);
      if (seen.size() < 2) continue;
      const Eigen::VectorXd variances = ghosting_variances(seen, covariance_of(seen, solution));
      const double square = std::pow(solution.sigma_px, 2) * variances.mean();
      if (!std::isfinite(square)) return {depth_m, kNaN, kNaN, -1};
      sum_sq += square;
      ++count;
      if (square <= worst) continue;
      worst = square;
      Eigen::Index most = 0;
      variances.maxCoeff(&most);
      result.worst_camera = seen[most].camera;
    }
  if (count == 0) return result;
  result.rms_px = std::sqrt(sum_sq / count);
  result.worst_px = std::sqrt(std::max(0.0, worst));
  return result;
}

}  // namespace

std::vector<Ghosting> ghosting(const JointSolution& solution, const Layout& layout,
                               const std::vector<int>& which, const std::vector<double>& depths_m) {
  std::vector<Ghosting> result;
  if (solution.camera_covariance.size() == 0 || which.size() < 2) return result;
  const Sights sights(solution, layout, which);
  for (const double depth : depths_m)
    result.push_back(ghosting_at(sights, solution, solution.cameras[which.front()], depth));
  return result;
}

}  // namespace stuv
