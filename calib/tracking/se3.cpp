#include "calib/tracking/se3.h"

#include <cmath>

namespace stuv::tracking {

Pose exp(const Twist& twist) {
  const Eigen::Vector3d v = twist.head<3>(), w = twist.tail<3>();
  const double p2 = w.squaredNorm(), p = std::sqrt(p2);
  double a = 1 - p2 / 6, b = 0.5 - p2 / 24, c = 1.0 / 6 - p2 / 120;
  if (p > 1e-3) {
    const double half = std::sin(p / 2);  // 1 - cos p without cancellation
    a = std::sin(p) / p;
    b = 2 * half * half / p2;
    c = (1 - a) / p2;
  }
  const Eigen::Matrix3d W = cross_matrix(w), W2 = W * W;
  const Eigen::Matrix3d I = Eigen::Matrix3d::Identity();
  return {I + a * W + b * W2, (I + b * W + c * W2) * v};
}

Twist log(const Pose& pose) {
  const Eigen::Quaterniond q = Eigen::Quaterniond(pose.R).normalized();
  const Eigen::Vector3d u = q.w() < 0 ? Eigen::Vector3d(-q.vec()) : q.vec();
  const double sine = u.norm(), cosine = std::abs(q.w());
  // |w| = 2 atan2(sine, cosine); near 0 their ratio tends to 2.
  const double scale = sine < 1e-9 ? 2.0 : 2 * std::atan2(sine, cosine) / sine;
  const Eigen::Vector3d w = scale * u;
  const double p = w.norm();
  // V^-1 = I - W / 2 + d W^2
  const double d = p < 1e-3 ? 1.0 / 12 + p * p / 720 : (1 - p / 2 * cosine / sine) / (p * p);
  const Eigen::Matrix3d W = cross_matrix(w);
  Twist twist;
  twist << (Eigen::Matrix3d::Identity() - 0.5 * W + d * W * W) * pose.t, w;
  return twist;
}

Pose mean(const std::vector<Pose>& poses, const std::vector<double>& weights) {
  Eigen::Matrix3d R = Eigen::Matrix3d::Zero();
  Eigen::Vector3d t = Eigen::Vector3d::Zero();
  double sum = 0;
  for (std::size_t i = 0; i < poses.size(); ++i) {
    R += weights[i] * poses[i].R;
    t += weights[i] * poses[i].t;
    sum += weights[i];
  }
  if (!(sum > 0)) return {};
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R / sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const double sign = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1;
  return {svd.matrixU() * Eigen::Vector3d(1, 1, sign).asDiagonal() * svd.matrixV().transpose(), t / sum};
}

}  // namespace stuv::tracking
