#include "calib/two_view/rotation.h"

#include <ceres/ceres.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "calib/two_view/fundamental.h"
#include "calib/two_view/robust.h"
#include "core/pose.h"

namespace stuv {
namespace {

/// Residual of b - K R K^-1 a; k = (log f, cx, cy), r the rotation vector.
struct Turned {
  Match m;
  template <class T>
  bool operator()(const T* k, const T* r, T* residual) const {
    const T f = exp(k[0]);
    const T ray[3] = {(m.a.x() - k[1]) / f, (m.a.y() - k[2]) / f, T(1)};
    T turned[3];
    ceres::AngleAxisRotatePoint(r, ray, turned);
    residual[0] = f * turned[0] / turned[2] + k[1] - m.b.x();
    residual[1] = f * turned[1] / turned[2] + k[2] - m.b.y();
    return true;
  }
};

/// Residual of b - H a.
struct Mapped {
  Match m;
  template <class T>
  bool operator()(const T* h, T* residual) const {
    const T w = h[6] * m.a.x() + h[7] * m.a.y() + h[8];
    residual[0] = (h[0] * m.a.x() + h[1] * m.a.y() + h[2]) / w - m.b.x();
    residual[1] = (h[3] * m.a.x() + h[4] * m.a.y() + h[5]) / w - m.b.y();
    return true;
  }
};

double solve(ceres::Problem& problem) {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.max_num_iterations = 100;
  options.function_tolerance = 1e-10;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return summary.IsSolutionUsable() ? 2 * summary.final_cost : std::numeric_limits<double>::infinity();
}

/// From a focal length and the turn that comes closest to K^-1 H K.
double rotation_cost(const Matches& matches, const Eigen::Matrix3d& H, double f) {
  const Eigen::Matrix3d K = Eigen::Vector3d(f, f, 1).asDiagonal();
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(K.inverse() * H * K, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d R = svd.matrixU() * svd.matrixV().transpose();
  if (R.determinant() < 0) R = -R;
  const Eigen::Vector3d v = vector_from_rotation(R);
  std::array<double, 3> k{std::log(f), 0, 0}, r{v.x(), v.y(), v.z()};
  ceres::Problem problem;
  for (const Match& m : matches)
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Turned, 2, 3, 3>(new Turned{m}), nullptr,
                             k.data(), r.data());
  return solve(problem);
}

double free_cost(const Matches& matches, const Eigen::Matrix3d& H) {
  std::array<double, 9> h{};
  for (int i = 0; i < 9; ++i) h[i] = H(i / 3, i % 3);
  ceres::Problem problem;
  for (const Match& m : matches)
    problem.AddResidualBlock(new ceres::AutoDiffCostFunction<Mapped, 2, 9>(new Mapped{m}), nullptr, h.data());
  return solve(problem);
}

}  // namespace

bool is_rotation(const Eigen::Matrix3d& H, std::span<const Match> matches, double noise_px) {
  constexpr std::size_t kMost = 300;
  if (matches.size() < 8) return false;
  // One lens: one normalisation for both pictures.
  Similarity2 T = normalisation(matches).first;
  Matches points;
  const std::size_t n = std::min(kMost, matches.size());
  for (std::size_t i = 0; i < n; ++i) {
    const Match& m = matches[i * matches.size() / n];
    points.push_back({T * m.a, T * m.b});
  }
  Eigen::Matrix3d h = T.matrix() * H * T.matrix().inverse();
  h /= std::cbrt(h.determinant());
  const double unit = 2 * std::pow(noise_px * T.scale, 2);  // both ends of a transfer have noise
  const double free = free_cost(points, h) / unit;
  double turned = std::numeric_limits<double>::infinity();
  for (const double f : {2.0, 4.0, 8.0}) turned = std::min(turned, rotation_cost(points, h, f) / unit);
  const double per_parameter = std::log(4.0 * static_cast<double>(n));
  return turned + 6 * per_parameter < free + 8 * per_parameter;
}

}  // namespace stuv
