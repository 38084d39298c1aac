#include "calib/check/resection.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <utility>
#include <vector>

#include "core/median.h"

namespace stuv {
namespace {

constexpr int kParts = 6;             // a side: parts of a picture whose errors are taken as alike
constexpr double kHuber = 1.345;      // deviations: 95 % efficient for Gaussian errors
constexpr double kOutlier = 4;        // deviations
constexpr double kLeastNoise = 1e-3;  // [px]: exact sightings are all inliers

/// Whitened residual of one sighting, with its derivatives.
struct Term {
  Eigen::Vector2d r, raw;
  Eigen::Matrix<double, 2, 6> J, raw_J;
  bool in_front = false;
  double length() const { return r.norm(); }
};

Term term_of(const PointSighting& s, const Pose& pose, double focal_px) {
  const Eigen::Vector3d x = s.point.X.head<3>(), c = pose.centre();
  const double w = s.point.X[3];
  const Eigen::Vector3d y = pose.R * (x - w * c);
  const double length = y.norm();
  const Eigen::Vector3d u = y / length;
  const Eigen::Matrix<double, 2, 3> D =
      focal_px * across(s.ray) * (Eigen::Matrix3d::Identity() - u * u.transpose()) / length;
  Term t;
  t.raw = focal_px * across(s.ray) * u;
  t.raw_J << -D * cross_matrix(y), -w * D * pose.R;
  Eigen::Matrix<double, 3, 4> M;
  M << pose.R, -pose.R * c;
  const Eigen::Matrix<double, 2, 3> J_point = D * M * s.point.tangent;
  const Eigen::Matrix2d spread =
      Eigen::Matrix2d::Identity() + J_point * s.point.covariance * J_point.transpose();
  const Eigen::LLT<Eigen::Matrix2d> llt(spread);
  t.r = llt.matrixL().solve(t.raw);
  t.J = llt.matrixL().solve(t.raw_J);
  t.in_front = u.dot(s.ray) > 0;
  return t;
}

/// Deviation of a coordinate, from the median length (Rayleigh's median is 1.1774 deviations).
double robust_noise(const std::vector<Term>& terms) {
  std::vector<double> lengths;
  for (const Term& t : terms) lengths.push_back(t.in_front ? t.length() : 1e9);
  return std::max(kLeastNoise, median(std::move(lengths)) / 1.1774);
}

Pose changed(const Pose& pose, const Vector6d& change) {
  Pose p;
  p.R = rotation_from_vector(change.head<3>()) * pose.R;
  p.t = -(p.R * (pose.centre() + change.tail<3>()));
  return p;
}

class Fit {
 public:
  Fit(std::span<const PointSighting> sightings, const Pose& start, const ResectionOptions& options)
      : in_(sightings), options_(options), pose_(start) {
    evaluate();
  }

  /// Huber's weights, then least squares of what lies within four deviations.
  bool solve() {
    for (int i = 0; i < 30; ++i)
      if (!step(robust_noise(terms_), true)) return false;
    double noise = robust_noise(terms_);
    for (int i = 0; i < 10; ++i) {
      if (!step(noise, false)) return false;
      noise = robust_noise(terms_);
    }
    limit_ = kOutlier * noise;
    return true;
  }

  std::vector<const Term*> inliers() const {
    std::vector<const Term*> good;
    for (const Term& t : terms_) good.push_back(t.in_front && t.length() <= limit_ ? &t : nullptr);
    return good;
  }
  const Pose& pose() const { return pose_; }
  int unknowns() const { return options_.hold_centre ? 3 : 6; }

 private:
  void evaluate() {
    terms_.clear();
    for (const PointSighting& s : in_) terms_.push_back(term_of(s, pose_, options_.focal_px));
  }

  bool step(double noise, bool huber) {
    Matrix6d N = Matrix6d::Zero();
    Vector6d g = Vector6d::Zero();
    for (const Term& t : terms_) {
      if (!t.in_front) continue;
      const double deviations = t.length() / noise;
      const double weight =
          huber ? std::min(1.0, kHuber / std::max(deviations, 1e-9)) : (deviations <= kOutlier ? 1.0 : 0.0);
      N += weight * t.J.transpose() * t.J;
      g += weight * t.J.transpose() * t.r;
    }
    const int n = unknowns();
    const Eigen::LDLT<Eigen::MatrixXd> ldlt(N.topLeftCorner(n, n));
    Vector6d d = Vector6d::Zero();
    d.head(n) = -ldlt.solve(g.head(n));
    if (!d.allFinite()) return false;
    // A turn beyond half a radian is beyond what a linear step can say.
    if (d.head<3>().norm() > 0.5) d *= 0.5 / d.head<3>().norm();
    pose_ = changed(pose_, d);
    evaluate();
    return true;
  }

  std::span<const PointSighting> in_;
  ResectionOptions options_;
  Pose pose_;
  std::vector<Term> terms_;
  double limit_ = 0;
};

/// By what errors that are alike within parts of the picture raise the variance of a mean.
double likeness_of(std::span<const PointSighting> sightings, const std::vector<const Term*>& inliers,
                   const Eigen::Vector2d& size_px) {
  std::map<std::pair<int, int>, Eigen::Vector2d> parts;
  double single = 0, together = 0;
  for (std::size_t i = 0; i < inliers.size(); ++i) {
    if (inliers[i] == nullptr) continue;
    const Eigen::Vector2d place = kParts * sightings[i].at_px.cwiseQuotient(size_px);
    const std::pair<int, int> part(std::clamp(int(place.x()), 0, kParts - 1),
                                   std::clamp(int(place.y()), 0, kParts - 1));
    parts.try_emplace(part, Eigen::Vector2d::Zero()).first->second += inliers[i]->r;
    single += inliers[i]->r.squaredNorm();
  }
  for (const auto& [part, sum] : parts) together += sum.squaredNorm();
  return single > 0 ? std::max(1.0, together / single) : 1;
}

/// How far the picture of the inliers moved between two poses: rms of the angles' chords [px].
double effect_of(std::span<const PointSighting> sightings, const std::vector<const Term*>& inliers,
                 const Pose& before, const Pose& after, double focal_px) {
  double sum = 0, n = 0;
  for (std::size_t i = 0; i < inliers.size(); ++i) {
    if (inliers[i] == nullptr) continue;
    const Eigen::Vector3d x = sightings[i].point.X.head<3>();
    const double w = sightings[i].point.X[3];
    const auto direction = [&](const Pose& p) {
      return Eigen::Vector3d(p.R * (x - w * p.centre())).normalized();
    };
    sum += (direction(before) - direction(after)).squaredNorm();
    ++n;
  }
  return focal_px * std::sqrt(sum / n);
}

std::optional<Resection> resect_from(std::span<const PointSighting> sightings, const Pose& before,
                                     const Pose& start, const ResectionOptions& options) {
  if (static_cast<int>(sightings.size()) < options.least_inliers) return std::nullopt;
  Fit fit(sightings, start, options);
  if (!fit.solve()) return std::nullopt;
  Resection result;
  result.cam_from_rig = fit.pose();
  result.sightings = static_cast<int>(sightings.size());
  result.change.head<3>() = vector_from_rotation(fit.pose().R * before.R.transpose());
  result.change.tail<3>() = fit.pose().centre() - before.centre();
  if (options.hold_centre) result.change.tail<3>().setZero();

  const std::vector<const Term*> inliers = fit.inliers();
  Matrix6d N = Matrix6d::Zero();
  double sum = 0, raw_sum = 0;
  for (const Term* t : inliers) {
    if (t == nullptr) continue;
    N += t->J.transpose() * t->J;
    sum += t->r.squaredNorm();
    raw_sum += t->raw.squaredNorm();
    ++result.inliers;
  }
  if (result.inliers < options.least_inliers) return std::nullopt;
  const int n = fit.unknowns();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(N.topLeftCorner(n, n));
  if (!(eigen.eigenvalues()[0] > 0)) return std::nullopt;
  const double variance = std::max(kLeastNoise * kLeastNoise, sum / (2.0 * result.inliers - n));
  result.noise_px = std::sqrt(variance);
  result.rms_px = std::sqrt(raw_sum / result.inliers);
  result.likeness = likeness_of(sightings, inliers, options.size_px);
  result.covariance.topLeftCorner(n, n) = result.likeness * variance * eigen.eigenvectors() *
                                          eigen.eigenvalues().cwiseInverse().asDiagonal() *
                                          eigen.eigenvectors().transpose();
  double effect_variance = 0;
  for (const Term* t : inliers)
    if (t != nullptr) effect_variance += (t->raw_J * result.covariance * t->raw_J.transpose()).trace();
  result.effect_px = effect_of(sightings, inliers, before, result.cam_from_rig, options.focal_px);
  result.effect_sigma_px = std::sqrt(effect_variance / result.inliers);
  return result;
}

/// Rotation that takes two directions to two others (Wahba's problem, by SVD).
Eigen::Matrix3d rotation_between(const Eigen::Vector3d& a0, const Eigen::Vector3d& a1,
                                 const Eigen::Vector3d& b0, const Eigen::Vector3d& b1) {
  const Eigen::Matrix3d B = b0 * a0.transpose() + b1 * a1.transpose();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(B, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d d(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant());
  return svd.matrixU() * d.asDiagonal() * svd.matrixV().transpose();
}

}  // namespace

std::optional<Resection> resect(std::span<const PointSighting> sightings, const Pose& before,
                                const ResectionOptions& options) {
  return resect_from(sightings, before, before, options);
}

std::optional<Resection> resect_from_nothing(std::span<const PointSighting> sightings, const Pose& before,
                                             const ResectionOptions& options, double tolerance_rad,
                                             int tries) {
  const std::size_t n = sightings.size();
  if (static_cast<int>(n) < options.least_inliers) return std::nullopt;
  const Eigen::Vector3d c = before.centre();
  std::vector<Eigen::Vector3d> seen;  // from the centre, in the rig's frame
  for (const PointSighting& s : sightings)
    seen.push_back((s.point.X.head<3>() - s.point.X[3] * c).normalized());
  std::mt19937_64 random(1);
  Eigen::Matrix3d best = before.R;
  int most = 0;
  for (int k = 0; k < tries; ++k) {
    const std::size_t i = random() % n, j = random() % n;
    if (i == j) continue;
    const Eigen::Matrix3d R = rotation_between(seen[i], seen[j], sightings[i].ray, sightings[j].ray);
    int agree = 0;
    for (std::size_t m = 0; m < n; ++m)
      agree += (R * seen[m]).dot(sightings[m].ray) > std::cos(tolerance_rad) ? 1 : 0;
    if (agree > most) most = agree, best = R;
  }
  if (most < options.least_inliers) return std::nullopt;
  return resect_from(sightings, before, {best, -(best * c)}, options);
}

}  // namespace stuv
