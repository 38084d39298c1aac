#include "calib/two_view/essential.h"

#include <cmath>

#include "calib/two_view/fundamental.h"

namespace stuv {
namespace {

// Polynomials in x, y, z up to degree 3, as coefficients of the monomials in kPowers.
constexpr int kTerms = 20;
constexpr int kPowers[kTerms][3] = {{3, 0, 0}, {2, 1, 0}, {2, 0, 1}, {1, 2, 0}, {1, 1, 1},
                                    {1, 0, 2}, {0, 3, 0}, {0, 2, 1}, {0, 1, 2}, {0, 0, 3},
                                    {2, 0, 0}, {1, 1, 0}, {1, 0, 1}, {0, 2, 0}, {0, 1, 1},
                                    {0, 0, 2}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, 0, 0}};

using Polynomial = Eigen::Matrix<double, kTerms, 1>;

int term_of(int x, int y, int z) {
  for (int i = 0; i < kTerms; ++i)
    if (kPowers[i][0] == x && kPowers[i][1] == y && kPowers[i][2] == z) return i;
  return -1;
}

/// Index of the product of two monomials; -1 beyond degree 3.
const std::array<std::array<int, kTerms>, kTerms>& products() {
  static const auto table = [] {
    std::array<std::array<int, kTerms>, kTerms> t{};
    for (int i = 0; i < kTerms; ++i)
      for (int j = 0; j < kTerms; ++j)
        t[i][j] = term_of(kPowers[i][0] + kPowers[j][0], kPowers[i][1] + kPowers[j][1],
                          kPowers[i][2] + kPowers[j][2]);
    return t;
  }();
  return table;
}

Polynomial operator_times(const Polynomial& a, const Polynomial& b) {
  Polynomial c = Polynomial::Zero();
  for (int i = 0; i < kTerms; ++i) {
    if (a[i] == 0) continue;
    for (int j = 0; j < kTerms; ++j)
      if (b[j] != 0) c[products()[i][j]] += a[i] * b[j];
  }
  return c;
}

/// The ten constraints on E = x E1 + y E2 + z E3 + E4, a row each.
Eigen::Matrix<double, 10, kTerms> constraints(const std::array<Eigen::Matrix3d, 4>& basis) {
  std::array<std::array<Polynomial, 3>, 3> E, EEt;
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) {
      E[r][c].setZero();
      for (int k = 0; k < 4; ++k) E[r][c][16 + k] = basis[k](r, c);
    }
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) {
      EEt[r][c].setZero();
      for (int k = 0; k < 3; ++k) EEt[r][c] += operator_times(E[r][k], E[c][k]);
    }
  const Polynomial trace = EEt[0][0] + EEt[1][1] + EEt[2][2];
  Eigen::Matrix<double, 10, kTerms> A;
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c) {
      Polynomial p = -operator_times(trace, E[r][c]);
      for (int k = 0; k < 3; ++k) p += 2 * operator_times(EEt[r][k], E[k][c]);
      A.row(3 * r + c) = p.transpose();
    }
  const auto minor = [&](int a, int b) {
    return Polynomial(operator_times(E[1][a], E[2][b]) - operator_times(E[1][b], E[2][a]));
  };
  A.row(9) = (operator_times(E[0][0], minor(1, 2)) - operator_times(E[0][1], minor(0, 2)) +
              operator_times(E[0][2], minor(0, 1)))
                 .transpose();
  return A;
}

}  // namespace

std::vector<Eigen::Matrix3d> five_point(std::span<const Match, 5> matches) {
  Eigen::Matrix<double, 9, 9> A = Eigen::Matrix<double, 9, 9>::Zero();
  for (int i = 0; i < 5; ++i) {
    const Eigen::Vector3d x = matches[i].a.homogeneous(), y = matches[i].b.homogeneous();
    for (int k = 0; k < 3; ++k) A.block<1, 3>(i, 3 * k) = y[k] * x.transpose();
  }
  if (!A.allFinite()) return {};
  const Eigen::JacobiSVD<Eigen::Matrix<double, 9, 9>> svd(A, Eigen::ComputeFullV);
  if (!(svd.singularValues()[4] > 1e-12 * svd.singularValues()[0])) return {};
  std::array<Eigen::Matrix3d, 4> basis;
  for (int k = 0; k < 4; ++k) {
    const Eigen::Matrix<double, 9, 1> v = svd.matrixV().col(5 + k);
    basis[k] = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(v.data());
  }
  // Cubic monomials by the lower ones: m3 = -B m, m = (x^2, xy, xz, y^2, yz, z^2, x, y, z, 1).
  const Eigen::Matrix<double, 10, kTerms> C = constraints(basis);
  const Eigen::Matrix<double, 10, 10> B = C.leftCols<10>().fullPivLu().solve(C.rightCols<10>());
  if (!B.allFinite()) return {};
  // Multiplication by x on the ten lower monomials; its left eigenvectors hold their values.
  Eigen::Matrix<double, 10, 10> M = Eigen::Matrix<double, 10, 10>::Zero();
  for (int i = 0; i < 10; ++i) {
    const int t = products()[16][10 + i];
    if (t < 10)
      M.row(i) = -B.row(t);
    else
      M(i, t - 10) = 1;
  }
  const Eigen::EigenSolver<Eigen::Matrix<double, 10, 10>> eigen(M);
  std::vector<Eigen::Matrix3d> solutions;
  for (int i = 0; i < 10; ++i) {
    if (std::abs(eigen.eigenvalues()[i].imag()) > 1e-9 * (1 + std::abs(eigen.eigenvalues()[i]))) continue;
    const Eigen::Matrix<double, 10, 1> v = eigen.eigenvectors().col(i).real();
    Eigen::Matrix3d E = v[6] * basis[0] + v[7] * basis[1] + v[8] * basis[2] + v[9] * basis[3];
    if (E.norm() > 1e-12) solutions.push_back(E / E.norm());
  }
  return solutions;
}

RelativePose pose_of(const Eigen::Matrix3d& E, std::span<const Match> matches) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(E, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d W;
  W << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  RelativePose best;
  for (int k = 0; k < 4; ++k) {
    Eigen::Matrix3d R =
        svd.matrixU() * (k < 2 ? W : Eigen::Matrix3d(W.transpose())) * svd.matrixV().transpose();
    if (R.determinant() < 0) R = -R;
    const Eigen::Vector3d t = (k % 2 ? -1 : 1) * svd.matrixU().col(2);
    int in_front = 0;
    for (const Match& m : matches) {
      // a R x + t = b y: depths by least squares.
      const Eigen::Vector3d u = R * m.a.homogeneous(), y = m.b.homogeneous();
      const double uu = u.squaredNorm(), yy = y.squaredNorm(), uy = u.dot(y), ut = u.dot(t), yt = y.dot(t);
      const double d = uu * yy - uy * uy;
      in_front += d > 0 && uy * yt - yy * ut > 0 && uu * yt - uy * ut > 0 ? 1 : 0;
    }
    if (k == 0 || in_front > best.in_front) best = {{R, t}, in_front};
  }
  return best;
}

Eigen::Matrix3d closest_essential(const Eigen::Matrix3d& E) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(E, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return svd.matrixU() * Eigen::Vector3d(1, 1, 0).asDiagonal() * svd.matrixV().transpose();
}

}  // namespace stuv
