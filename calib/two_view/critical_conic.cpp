#include "calib/two_view/critical_conic.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "calib/two_view/fundamental.h"
#include "core/median.h"

namespace stuv {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;

Vector6 monomials(const Eigen::Vector3d& x) {
  Vector6 q;
  q << x.x() * x.x(), x.x() * x.y(), x.y() * x.y(), x.x() * x.z(), x.y() * x.z(), x.z() * x.z();
  return q;
}

/// The conic of least algebraic distance among those through e.
Vector6 conic_through(const Eigen::Vector3d& e, const std::vector<Eigen::Vector2d>& points) {
  Eigen::Matrix<double, 6, 6> A = Eigen::Matrix<double, 6, 6>::Zero();
  for (const Eigen::Vector2d& x : points) {
    const Vector6 q = monomials(x.homogeneous());
    A += q * q.transpose();
  }
  const Eigen::HouseholderQR<Vector6> qr(monomials(e));
  const Eigen::Matrix<double, 6, 5> basis = Eigen::Matrix<double, 6, 6>(qr.householderQ()).rightCols<5>();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 5, 5>> eigen(basis.transpose() * A * basis);
  return basis * eigen.eigenvectors().col(0);
}

double distance(const Vector6& c, const Eigen::Vector2d& x) {
  const Eigen::Vector2d gradient(2 * c[0] * x.x() + c[1] * x.y() + c[3],
                                 c[1] * x.x() + 2 * c[2] * x.y() + c[4]);
  const double value = std::abs(c.dot(monomials(x.homogeneous())));
  return value > 0 ? value / std::max(gradient.norm(), 1e-12) : 0;
}

bool on_conic(std::span<const Match> matches, Eigen::Vector2d Match::*side, const Similarity2& T,
              const Eigen::Vector3d& epipole, double noise_px) {
  constexpr double kOnIt = 2;  ///< deviations of the noise, of the median distance
  const Eigen::Vector3d e = (T.matrix() * epipole).normalized();
  std::vector<Eigen::Vector2d> points;
  for (const Match& m : matches) points.push_back(T * (m.*side));
  const Vector6 c = conic_through(e, points);
  std::vector<double> d;
  for (const Eigen::Vector2d& x : points) d.push_back(distance(c, x));
  return median(std::move(d)) < kOnIt * noise_px * T.scale;
}

}  // namespace

bool on_conic_through_epipole(std::span<const Match> matches, const Eigen::Matrix3d& F, double noise_px) {
  if (matches.empty()) return false;
  const auto [Ta, Tb] = normalisation(matches);
  return on_conic(matches, &Match::a, Ta, epipole_a(F), noise_px) ||
         on_conic(matches, &Match::b, Tb, epipole_b(F), noise_px);
}

}  // namespace stuv
