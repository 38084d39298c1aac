#include "calib/tracking/moving_adjust.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>

#include "calib/bundle_covariance.h"

namespace stuv::tracking {
namespace {

/// Sights farther off than this many deviations are taken out; below the least deviation none is.
constexpr double kOutlier = 4, kLeastDeviation_px = 0.05;
/// A picture is cut into this many parts each way, within which errors are taken to be alike.
constexpr int kParts = 4;

/// Nearest point to the rays; false if it is not in front of all its cameras.
bool triangulate(const TrackedPoint& point, const std::vector<Pose>& poses, Eigen::Vector3d& x) {
  Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
  Eigen::Vector3d b = Eigen::Vector3d::Zero();
  for (const Sight& s : point) {
    const Eigen::Vector3d d = (poses[s.frame].R.transpose() * s.ray.homogeneous()).normalized();
    const Eigen::Matrix3d P = Eigen::Matrix3d::Identity() - d * d.transpose();
    A += P;
    b += P * poses[s.frame].centre();
  }
  x = A.ldlt().solve(b);
  return x.allFinite() && std::all_of(point.begin(), point.end(),
                                      [&](const Sight& s) { return (poses[s.frame] * x).z() > 0; });
}

struct Reprojection {
  Eigen::Vector2d ray;
  double focal_px;
  template <class T>
  bool operator()(const T* pose, const T* x, T* residual) const {
    T p[3];
    ceres::AngleAxisRotatePoint(pose, x, p);
    for (int i = 0; i < 3; ++i) p[i] += pose[3 + i];
    residual[0] = focal_px * (p[0] / p[2] - ray.x());
    residual[1] = focal_px * (p[1] / p[2] - ray.y());
    return true;
  }
};

/// Centre and direction stay near the tracked ones.
struct PosePrior {
  Pose tracked;
  double sigma_m, sigma_rad;
  template <class T>
  bool operator()(const T* pose, T* residual) const {
    // The centre, -R^T t, and the small rotation between the two.
    const T back[3] = {-pose[0], -pose[1], -pose[2]};
    T centre[3];
    ceres::AngleAxisRotatePoint(back, pose + 3, centre);
    const Eigen::Vector3d c = tracked.centre();
    const Eigen::Vector3d r = vector_from_rotation(tracked.R);
    for (int i = 0; i < 3; ++i) residual[i] = (-centre[i] - c[i]) / sigma_m;
    T q[4], q0[4], inverse[4], between[4], turn[3];
    const T r0[3] = {T(r.x()), T(r.y()), T(r.z())};
    ceres::AngleAxisToQuaternion(pose, q);
    ceres::AngleAxisToQuaternion(r0, q0);
    inverse[0] = q0[0];
    for (int i = 1; i < 4; ++i) inverse[i] = -q0[i];
    ceres::QuaternionProduct(q, inverse, between);
    ceres::QuaternionToAngleAxis(between, turn);
    for (int i = 0; i < 3; ++i) residual[3 + i] = turn[i] / sigma_rad;
    return true;
  }
};

class Adjustment {
 public:
  Adjustment(const std::vector<Pose>& tracked, const std::vector<TrackedPoint>& points, double focal_px,
             double sigma_m)
      : tracked_(tracked), focal_px_(focal_px), sigma_m_(sigma_m) {
    for (const Pose& p : tracked) {
      const Eigen::Vector3d r = vector_from_rotation(p.R);
      poses_.push_back({r.x(), r.y(), r.z(), p.t.x(), p.t.y(), p.t.z()});
    }
    for (const TrackedPoint& point : points) {
      Eigen::Vector3d x;
      if (point.size() < 2 || !triangulate(point, tracked, x)) continue;
      sights_.push_back(point);
      points_.push_back(x);
      inlier_.emplace_back(point.size(), true);
    }
  }

  Adjusted run() {
    Adjusted out;
    if (points_.empty()) {
      out.poses = tracked_;
      note_residuals(out);
      return out;
    }
    out.converged = solve(true);
    reject();
    out.converged = solve(false) && out.converged;
    for (std::size_t i = 0; i < poses_.size(); ++i) out.poses.push_back(pose(i));
    out.points = points_;
    note_residuals(out);
    if (out.converged) out.centre_covariance = centre_covariance(out.poses);
    return out;
  }

 private:
  Pose pose(std::size_t i) const {
    const auto& p = poses_[i];
    return {rotation_from_vector({p[0], p[1], p[2]}), {p[3], p[4], p[5]}};
  }

  Eigen::Vector2d residual(const Pose& pose, std::size_t j, const Sight& s) const {
    return focal_px_ * ((pose * points_[j]).hnormalized() - s.ray);
  }

  bool solve(bool robust) {
    ceres::Problem problem;
    for (std::size_t j = 0; j < points_.size(); ++j)
      for (std::size_t k = 0; k < sights_[j].size(); ++k) {
        if (!inlier_[j][k]) continue;
        const Sight& s = sights_[j][k];
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<Reprojection, 2, 6, 3>(new Reprojection{s.ray, focal_px_}),
            robust ? new ceres::HuberLoss(1) : nullptr, poses_[s.frame].data(), points_[j].data());
      }
    for (std::size_t i = 0; i < poses_.size(); ++i)
      problem.AddResidualBlock(
          new ceres::AutoDiffCostFunction<PosePrior, 6, 6>(new PosePrior{tracked_[i], sigma_m_, 0.05}),
          new ceres::CauchyLoss(1), poses_[i].data());
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::SPARSE_SCHUR;
    options.max_num_iterations = 60;
    options.num_threads = 1;  // sums in a fixed order
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    return summary.IsSolutionUsable();
  }

  /// Takes sights beyond four deviations out, and points left with one.
  void reject() {
    std::vector<double> lengths;
    for (std::size_t j = 0; j < points_.size(); ++j)
      for (const Sight& s : sights_[j]) lengths.push_back(residual(pose(s.frame), j, s).norm());
    const auto middle = lengths.begin() + static_cast<std::ptrdiff_t>(lengths.size() / 2);
    std::nth_element(lengths.begin(), middle, lengths.end());
    // 1.1774: the median of Rayleigh's distribution
    const double most = kOutlier * std::max(kLeastDeviation_px, *middle / 1.1774);
    for (std::size_t j = 0; j < points_.size(); ++j) {
      int left = 0;
      for (std::size_t k = 0; k < sights_[j].size(); ++k) {
        inlier_[j][k] = residual(pose(sights_[j][k].frame), j, sights_[j][k]).norm() < most;
        left += inlier_[j][k] ? 1 : 0;
      }
      if (left < 2) inlier_[j].assign(inlier_[j].size(), false);
    }
  }

  void note_residuals(Adjusted& a) const {
    a.sum_sq.assign(a.poses.size(), 0);
    a.count.assign(a.poses.size(), 0);
    a.outliers.assign(a.poses.size(), 0);
    for (std::size_t j = 0; j < points_.size(); ++j)
      for (std::size_t k = 0; k < sights_[j].size(); ++k) {
        const Sight& s = sights_[j][k];
        if (!inlier_[j][k]) {
          ++a.outliers[s.frame];
          continue;
        }
        const double e = residual(a.poses[s.frame], j, s).norm();
        a.sum_sq[s.frame] += e * e;
        a.count[s.frame] += 2;
        a.worst_px = std::max(a.worst_px, e);
      }
  }

  /// Which part of which picture a sight lies in.
  int part_of(const Sight& s, const Eigen::Vector2d& extent) const {
    const Eigen::Vector2d place = 0.5 * kParts * (s.ray.cwiseQuotient(extent).array() + 1);
    const int x = std::clamp(static_cast<int>(place.x()), 0, kParts - 1),
              y = std::clamp(static_cast<int>(place.y()), 0, kParts - 1);
    return (s.frame * kParts + y) * kParts + x;
  }

  /// Of centres; parameters of frame i, columns 6 i ..: a turn w of the camera, exp(w) R, and its centre.
  Eigen::MatrixXd centre_covariance(const std::vector<Pose>& poses) const {
    Eigen::Vector2d extent = Eigen::Vector2d::Constant(1e-9);
    for (const TrackedPoint& point : sights_)
      for (const Sight& s : point) extent = extent.cwiseMax(s.ray.cwiseAbs());
    std::vector<LinearObservation> observations;
    for (std::size_t j = 0; j < points_.size(); ++j)
      for (std::size_t k = 0; k < sights_[j].size(); ++k) {
        if (!inlier_[j][k]) continue;
        const Sight& s = sights_[j][k];
        const Eigen::Vector3d p = poses[s.frame] * points_[j];
        Eigen::Matrix<double, 2, 3> by_p;
        by_p << 1, 0, -p.x() / p.z(), 0, 1, -p.y() / p.z();
        by_p *= focal_px_ / p.z();
        LinearObservation o;
        o.point = static_cast<int>(j);
        o.part = part_of(s, extent);
        o.column = 6 * s.frame;
        o.by_point = by_p * poses[s.frame].R;
        o.by_camera.resize(2, 6);
        o.by_camera << -by_p * cross_matrix(p), -o.by_point;
        o.residual = residual(poses[s.frame], j, s);
        observations.push_back(o);
      }
    const auto n = static_cast<Eigen::Index>(poses.size());
    const Eigen::MatrixXd all =
        bundle_covariance(observations, static_cast<int>(6 * n), free_directions(poses, observations));
    if (all.size() == 0) return {};
    Eigen::MatrixXd centres(3 * n, 3 * n);
    for (Eigen::Index i = 0; i < n; ++i)
      for (Eigen::Index j = 0; j < n; ++j)
        centres.block<3, 3>(3 * i, 3 * j) = all.block<3, 3>(6 * i + 3, 6 * j + 3);
    return centres;
  }

  /// How the parameters change when the whole scene moves, turns or grows, 7 columns; and the frames that see
  /// nothing, 6 each.
  static Eigen::MatrixXd free_directions(const std::vector<Pose>& poses,
                                         const std::vector<LinearObservation>& observations) {
    const auto n = static_cast<Eigen::Index>(poses.size());
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const Pose& p : poses) mean += p.centre() / static_cast<double>(n);
    std::vector<bool> sees(poses.size(), false);
    for (const LinearObservation& o : observations) sees[static_cast<std::size_t>(o.column / 6)] = true;
    const auto blind = static_cast<Eigen::Index>(std::count(sees.begin(), sees.end(), false));
    Eigen::MatrixXd G = Eigen::MatrixXd::Zero(6 * n, 7 + 6 * blind);
    Eigen::Index next = 7;
    for (Eigen::Index i = 0; i < n; ++i) {
      if (sees[static_cast<std::size_t>(i)]) continue;
      G.block<6, 6>(6 * i, next).setIdentity();
      next += 6;
    }
    for (Eigen::Index i = 0; i < n; ++i) {
      const Pose& p = poses[static_cast<std::size_t>(i)];
      const Eigen::Vector3d c = p.centre() - mean;
      G.block<3, 3>(6 * i + 3, 0).setIdentity();
      G.block<3, 3>(6 * i, 3) = -p.R;
      G.block<3, 3>(6 * i + 3, 3) = -cross_matrix(c);
      G.block<3, 1>(6 * i + 3, 6) = c;
    }
    return G;
  }

  const std::vector<Pose>& tracked_;
  double focal_px_, sigma_m_;
  std::vector<std::array<double, 6>> poses_;
  std::vector<TrackedPoint> sights_;
  std::vector<Eigen::Vector3d> points_;
  std::vector<std::vector<bool>> inlier_;
};

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

Eigen::Vector3d median_centre(const std::vector<Pose>& poses) {
  Eigen::Vector3d out;
  for (int k = 0; k < 3; ++k) {
    std::vector<double> values;
    for (const Pose& p : poses) values.push_back(p.centre()[k]);
    out[k] = median(std::move(values));
  }
  return out;
}

/// The median over pairs of frames, without those of [leave_from, leave_to); none if there is no such pair.
std::optional<double> scale_of(const std::vector<Pose>& tracked, const std::vector<Pose>& now,
                               std::size_t leave_from, std::size_t leave_to) {
  const auto left_out = [&](std::size_t i) { return i >= leave_from && i < leave_to; };
  std::vector<double> ratios;
  for (std::size_t i = 0; i < now.size(); ++i)
    for (std::size_t j = i + 1; j < now.size(); ++j) {
      if (left_out(i) || left_out(j)) continue;
      const Eigen::Vector3d d = now[i].centre() - now[j].centre();
      if (d.squaredNorm() > 0)
        ratios.push_back((tracked[i].centre() - tracked[j].centre()).dot(d) / d.squaredNorm());
    }
  if (ratios.empty()) return {};
  const double scale = median(std::move(ratios));
  return scale > 0 && std::isfinite(scale) ? std::optional(scale) : std::nullopt;
}

/// Jackknife over blocks of neighbouring frames, relative.
double scale_sigma(const std::vector<Pose>& tracked, const std::vector<Pose>& now) {
  constexpr double none = std::numeric_limits<double>::quiet_NaN();
  const std::size_t n = now.size(), blocks = std::min<std::size_t>(n, 8);
  std::vector<double> scales;
  for (std::size_t b = 0; b < blocks; ++b) {
    const auto scale = scale_of(tracked, now, b * n / blocks, (b + 1) * n / blocks);
    if (!scale) return none;
    scales.push_back(*scale);
  }
  double mean = 0, spread = 0;
  for (const double s : scales) mean += s / static_cast<double>(blocks);
  for (const double s : scales) spread += (s - mean) * (s - mean);
  return n < 3 ? none
               : std::sqrt(spread * static_cast<double>(blocks - 1) / static_cast<double>(blocks)) / mean;
}

}  // namespace

Adjusted adjust_moving(const std::vector<Pose>& tracked, const std::vector<TrackedPoint>& points,
                       double focal_px, double sigma_m) {
  return Adjustment(tracked, points, focal_px, sigma_m).run();
}

bool restore_scale(const std::vector<Pose>& tracked, Adjusted& a) {
  const std::optional<double> scale = scale_of(tracked, a.poses, 0, 0);
  if (!scale) return false;
  a.scale_sigma = scale_sigma(tracked, a.poses);
  const Eigen::Vector3d from = median_centre(a.poses), to = median_centre(tracked);
  for (Pose& p : a.poses) p.t = -(p.R * (to + *scale * (p.centre() - from)));
  for (Eigen::Vector3d& x : a.points) x = to + *scale * (x - from);
  a.centre_covariance *= *scale * *scale;
  return true;
}

}  // namespace stuv::tracking
