#include "calib/two_view/fundamental.h"

#include <algorithm>
#include <cmath>

#include "core/pose.h"

namespace stuv {
namespace {

using Row9 = Eigen::Matrix<double, 1, 9>;

/// Row of A f = 0, f the rows of F one after the other.
Row9 epipolar_row(const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  Row9 row;
  row << b.x() * a.x(), b.x() * a.y(), b.x(), b.y() * a.x(), b.y() * a.y(), b.y(), a.x(), a.y(), 1;
  return row;
}

Eigen::Matrix3d matrix_of(const Eigen::Matrix<double, 9, 1>& f) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(f.data());
}

/// Gauss and Jordan with full pivoting on 7 x 9; the two columns left over give the null space. An SVD costs
/// ten times as much, and RANSAC does this for every sample.
bool null_space_7x9(Eigen::Matrix<double, 7, 9>& A, Eigen::Matrix3d& F1, Eigen::Matrix3d& F2) {
  std::array<int, 9> column{0, 1, 2, 3, 4, 5, 6, 7, 8};
  const double least = 1e-12 * A.cwiseAbs().maxCoeff();
  for (int i = 0; i < 7; ++i) {
    Eigen::Index r = 0, c = 0;
    if (!(A.bottomRightCorner(7 - i, 9 - i).cwiseAbs().maxCoeff(&r, &c) > least)) return false;
    A.row(i).swap(A.row(i + r));
    A.col(i).swap(A.col(i + c));
    std::swap(column[i], column[i + c]);
    A.row(i) /= A(i, i);
    for (int k = 0; k < 7; ++k)
      if (k != i) A.row(k).rightCols(9 - i) -= A(k, i) * A.row(i).rightCols(9 - i);
  }
  Eigen::Matrix<double, 9, 1> f1 = Eigen::Matrix<double, 9, 1>::Zero(), f2 = f1;
  for (int i = 0; i < 7; ++i) {
    f1[column[i]] = -A(i, 7);
    f2[column[i]] = -A(i, 8);
  }
  f1[column[7]] = 1;
  f2[column[8]] = 1;
  F1 = matrix_of(f1);
  F2 = matrix_of(f2);
  return true;
}

/// Real roots of c3 z^3 + c2 z^2 + c1 z + c0; a polynomial of lower degree has fewer.
int real_roots(double c3, double c2, double c1, double c0, std::array<double, 3>& z) {
  const double size = std::max({std::abs(c3), std::abs(c2), std::abs(c1), std::abs(c0)});
  if (!(size > 0)) return 0;
  int n = 0;
  if (std::abs(c3) < 1e-14 * size) {
    if (std::abs(c2) < 1e-14 * size) {
      if (std::abs(c1) > 1e-14 * size) z[n++] = -c0 / c1;
      return n;
    }
    const double d = c1 * c1 - 4 * c2 * c0;
    if (d < 0) return 0;
    const double q = -0.5 * (c1 + std::copysign(std::sqrt(d), c1));
    z[n++] = q / c2;
    if (q != 0) z[n++] = c0 / q;
    return n;
  }
  const double a = c2 / c3, b = c1 / c3, c = c0 / c3;
  const double Q = (a * a - 3 * b) / 9, R = (2 * a * a * a - 9 * a * b + 27 * c) / 54;
  if (R * R < Q * Q * Q) {
    const double t = std::acos(std::clamp(R / std::sqrt(Q * Q * Q), -1.0, 1.0));
    for (int k = -1; k <= 1; ++k) z[n++] = -2 * std::sqrt(Q) * std::cos((t + 2 * M_PI * k) / 3) - a / 3;
  } else {
    const double A = -std::copysign(std::cbrt(std::abs(R) + std::sqrt(R * R - Q * Q * Q)), R);
    z[n++] = A + (A != 0 ? Q / A : 0) - a / 3;
  }
  for (int i = 0; i < n; ++i)  // Newton, against cancellation above
    for (int step = 0; step < 2; ++step) {
      const double f = ((z[i] + a) * z[i] + b) * z[i] + c, df = (3 * z[i] + 2 * a) * z[i] + b;
      if (df != 0 && std::isfinite(f / df)) z[i] -= f / df;
    }
  return n;
}

Similarity2 normalisation_of(std::span<const Match> matches, Eigen::Vector2d Match::*side) {
  Similarity2 s;
  const auto n = static_cast<double>(matches.size());
  for (const Match& m : matches) s.centre += m.*side / n;
  double sum_sq = 0;
  for (const Match& m : matches) sum_sq += (m.*side - s.centre).squaredNorm();
  const double rms = std::sqrt(sum_sq / n);
  if (rms > 0 && std::isfinite(rms)) s.scale = std::sqrt(2) / rms;
  return s;
}

Eigen::Vector3d null_vector(const Eigen::Matrix3d& F) {
  return Eigen::JacobiSVD<Eigen::Matrix3d>(F, Eigen::ComputeFullV).matrixV().col(2);
}

/// Smallest eigenvector of A^T A, as a matrix; A has one normalised row a match.
Eigen::Matrix3d least_squares(std::span<const Match> matches, std::span<const double> weights,
                              const Similarity2& Ta, const Similarity2& Tb) {
  Eigen::Matrix<double, 9, 9> AtA = Eigen::Matrix<double, 9, 9>::Zero();
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const Row9 row = epipolar_row(Ta * matches[i].a, Tb * matches[i].b);
    AtA.noalias() += (weights.empty() ? 1 : weights[i]) * row.transpose() * row;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 9, 9>> eigen(AtA);
  return matrix_of(eigen.eigenvectors().col(0));
}

}  // namespace

Eigen::Matrix3d unit_scale(const Eigen::Matrix3d& F) {
  Eigen::Index r = 0, c = 0;
  if (!(F.cwiseAbs().maxCoeff(&r, &c) > 0)) return F;
  const Eigen::Matrix3d scaled = F / F(r, c);
  return scaled / scaled.norm();
}

Eigen::Matrix3d closest_rank2(const Eigen::Matrix3d& F) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(F, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Vector3d s = svd.singularValues();
  return unit_scale(svd.matrixU() * Eigen::Vector3d(s[0], s[1], 0).asDiagonal() * svd.matrixV().transpose());
}

Eigen::Matrix3d Similarity2::matrix() const {
  Eigen::Matrix3d T;
  T << scale, 0, -scale * centre.x(), 0, scale, -scale * centre.y(), 0, 0, 1;
  return T;
}

std::pair<Similarity2, Similarity2> normalisation(std::span<const Match> matches) {
  return {normalisation_of(matches, &Match::a), normalisation_of(matches, &Match::b)};
}

int seven_point(std::span<const Match, 7> matches, std::array<Eigen::Matrix3d, 3>& F) {
  Eigen::Matrix<double, 7, 9> A;
  for (int i = 0; i < 7; ++i) A.row(i) = epipolar_row(matches[i].a, matches[i].b);
  Eigen::Matrix3d F1, F2;
  if (!null_space_7x9(A, F1, F2)) return 0;
  // det(F1 + z F2) is a cubic in z: c0 = det F1, c3 = det F2, c1 = tr(adj(F1) F2), c2 = tr(adj(F2) F1).
  const auto adjugate_trace = [](const Eigen::Matrix3d& M, const Eigen::Matrix3d& N) {
    return M.row(1).cross(M.row(2)).dot(N.row(0)) + M.row(2).cross(M.row(0)).dot(N.row(1)) +
           M.row(0).cross(M.row(1)).dot(N.row(2));
  };
  std::array<double, 3> z{};
  const double c3 = F2.determinant();
  int n = real_roots(c3, adjugate_trace(F2, F1), adjugate_trace(F1, F2), F1.determinant(), z);
  for (int i = 0; i < n; ++i) {
    // Divided by the larger coefficient, as z may be near infinity.
    F[i] = std::abs(z[i]) > 1 ? Eigen::Matrix3d(F1 / z[i] + F2) : Eigen::Matrix3d(F1 + z[i] * F2);
    F[i] /= F[i].norm();
  }
  if (c3 == 0 && n < 3) F[n++] = F2 / F2.norm();  // the root at infinity
  return n;
}

std::optional<Eigen::Matrix3d> eight_point(std::span<const Match> matches, std::span<const double> weights,
                                           bool normalise) {
  if (matches.size() < 8) return std::nullopt;
  Similarity2 Ta, Tb;
  if (normalise) std::tie(Ta, Tb) = normalisation(matches);
  Eigen::Matrix3d F = least_squares(matches, weights, Ta, Tb);
  if (!F.allFinite()) return std::nullopt;
  F = closest_rank2(F);
  return unit_scale(Tb.matrix().transpose() * F * Ta.matrix());
}

std::optional<Eigen::Matrix3d> translation_fundamental(std::span<const Match> matches) {
  if (matches.size() < 2) return std::nullopt;
  // One lens: both pictures are normalised alike. x'^T [e]_x x = e . (x x x').
  const Similarity2 T = normalisation(matches).first;
  Eigen::Matrix3d AtA = Eigen::Matrix3d::Zero();
  for (const Match& m : matches) {
    const Eigen::Vector3d row = (T * m.a).homogeneous().cross((T * m.b).homogeneous());
    AtA += row * row.transpose();
  }
  if (!AtA.allFinite()) return std::nullopt;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(AtA);
  const Eigen::Matrix3d F = cross_matrix(eigen.eigenvectors().col(0));
  return unit_scale(T.matrix().transpose() * F * T.matrix());
}

std::optional<Eigen::Matrix3d> planar_motion_fundamental(std::span<const Match> matches) {
  if (matches.size() < 8) return std::nullopt;
  const Similarity2 T = normalisation(matches).first;
  Eigen::Matrix3d F = least_squares(matches, {}, T, T);
  if (!F.allFinite()) return std::nullopt;
  for (int round = 0; round < 100; ++round) {
    const Eigen::Matrix3d skew = 0.5 * (F - F.transpose());
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(0.5 * (F + F.transpose()));
    Eigen::Vector3d values = eigen.eigenvalues();
    Eigen::Index least = 0;
    values.cwiseAbs().minCoeff(&least);
    values[least] = 0;
    const Eigen::Matrix3d symmetric =
        eigen.eigenvectors() * values.asDiagonal() * eigen.eigenvectors().transpose();
    F = closest_rank2(symmetric + skew);
  }
  return unit_scale(T.matrix().transpose() * F * T.matrix());
}

Eigen::Vector3d epipole_a(const Eigen::Matrix3d& F) { return null_vector(F); }
Eigen::Vector3d epipole_b(const Eigen::Matrix3d& F) { return null_vector(F.transpose()); }

Matrix34d canonical_camera(const Eigen::Matrix3d& F) {
  const Eigen::Vector3d e = epipole_b(F);
  Matrix34d P;
  P << cross_matrix(e) * F, e;
  return P;
}

Eigen::Matrix3d fundamental_of(const Matrix34d& P_a, const Matrix34d& P_b) {
  const Eigen::Vector4d centre = Eigen::FullPivLU<Matrix34d>(P_a).kernel().col(0);
  const Eigen::Matrix<double, 4, 3> inverse = P_a.transpose() * (P_a * P_a.transpose()).inverse();
  const Eigen::Vector3d e = P_b * centre;
  return unit_scale(cross_matrix(e) * P_b * inverse);
}

double sampson_distance(const Eigen::Matrix3d& F, const Match& m) {
  const Eigen::Vector3d x = m.a.homogeneous(), y = m.b.homogeneous();
  const Eigen::Vector3d l = F * x;
  const Eigen::Vector2d k = F.leftCols<2>().transpose() * y;
  const double d = l.head<2>().squaredNorm() + k.squaredNorm();
  return d > 0 ? y.dot(l) / std::sqrt(d) : 0;
}

double line_distance(const Eigen::Matrix3d& F, const Match& m) {
  const Eigen::Vector3d l = F * m.a.homogeneous();
  const double d = l.head<2>().norm();
  return d > 0 ? std::abs(m.b.homogeneous().dot(l)) / d : 0;
}

double symmetric_epipolar_distance2(const Eigen::Matrix3d& F, const Match& m) {
  return std::pow(line_distance(F, m), 2) + std::pow(line_distance(F.transpose(), {m.b, m.a}), 2);
}

}  // namespace stuv
