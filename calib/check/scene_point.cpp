#include "calib/check/scene_point.h"

#include <cmath>

namespace stuv {
namespace {

using Matrix34 = Eigen::Matrix<double, 3, 4>;

/// y = x - w c, as a matrix on X.
Matrix34 seen_from(const Eigen::Vector3d& centre) {
  Matrix34 M;
  M << Eigen::Matrix3d::Identity(), -centre;
  return M;
}

Eigen::Vector4d linear_solution(std::span<const SightLine> lines) {
  Eigen::Matrix4d A = Eigen::Matrix4d::Zero();
  for (const SightLine& line : lines) {
    const Matrix34 off =
        (Eigen::Matrix3d::Identity() - line.direction * line.direction.transpose()) * seen_from(line.centre);
    A += off.transpose() * off;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(A);
  Eigen::Vector4d X = eigen.eigenvectors().col(0);
  // X and -X are one point; before the cameras for one of the two.
  if (lines[0].direction.dot(seen_from(lines[0].centre) * X) < 0) X = -X;
  return X;
}

Eigen::Matrix<double, 4, 3> tangent_of(const Eigen::Vector4d& X) {
  const Eigen::HouseholderQR<Eigen::Vector4d> qr(X);
  const Eigen::Matrix4d Q = qr.householderQ();
  return Q.rightCols<3>();
}

struct Residual {
  Eigen::Vector2d r;
  Eigen::Matrix<double, 2, 4> J;
  bool in_front = false;
};

Residual residual_of(const SightLine& line, const Eigen::Vector4d& X) {
  const Matrix34 M = seen_from(line.centre);
  const Eigen::Vector3d y = M * X;
  const double length = y.norm();
  const Eigen::Vector3d u = y / length;
  const Eigen::Matrix<double, 2, 3> A = line.focal_px * across(line.direction);
  return {A * u, A * (Eigen::Matrix3d::Identity() - u * u.transpose()) / length * M,
          u.dot(line.direction) > 0};
}

}  // namespace

Eigen::Matrix<double, 2, 3> across(const Eigen::Vector3d& direction) {
  Eigen::Index least = 0;
  direction.cwiseAbs().minCoeff(&least);
  const Eigen::Vector3d a = direction.cross(Eigen::Vector3d::Unit(least)).normalized();
  Eigen::Matrix<double, 2, 3> rows;
  rows << a.transpose(), direction.cross(a).transpose();
  return rows;
}

std::optional<ScenePoint> triangulate(std::span<const SightLine> lines, double most_px) {
  constexpr int kMostSteps = 10;
  constexpr double kLeastPivot = 1e-12;  // of the normal matrix, relative: all centres coincide
  if (lines.size() < 2) return std::nullopt;
  ScenePoint point;
  point.X = linear_solution(lines);
  for (int step = 0; step < kMostSteps; ++step) {
    point.tangent = tangent_of(point.X);
    Eigen::Matrix3d N = Eigen::Matrix3d::Zero();
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
    for (const SightLine& line : lines) {
      const Residual r = residual_of(line, point.X);
      const Eigen::Matrix<double, 2, 3> J = r.J * point.tangent;
      N += J.transpose() * J;
      g += J.transpose() * r.r;
    }
    const Eigen::LDLT<Eigen::Matrix3d> ldlt(N);
    const Eigen::Vector3d pivots = ldlt.vectorD();
    if (!(pivots.minCoeff() > kLeastPivot * pivots.maxCoeff())) return std::nullopt;
    point.covariance = ldlt.solve(Eigen::Matrix3d::Identity());
    const Eigen::Vector3d d = -ldlt.solve(g);
    if (!d.allFinite()) return std::nullopt;
    if (d.norm() < 1e-12) break;
    point.X = (point.X + point.tangent * d).normalized();
  }
  point.tangent = tangent_of(point.X);
  for (const SightLine& line : lines) {
    const Residual r = residual_of(line, point.X);
    if (!r.in_front || !(r.r.norm() <= most_px)) return std::nullopt;
  }
  return point;
}

}  // namespace stuv
