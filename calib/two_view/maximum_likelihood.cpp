#include "calib/two_view/maximum_likelihood.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace stuv {
namespace {

using Vector9 = Eigen::Matrix<double, 9, 1>;
using Matrix7 = Eigen::Matrix<double, 7, 7>;
using Vector7 = Eigen::Matrix<double, 7, 1>;

constexpr int kOthers[3][2] = {{1, 2}, {0, 2}, {0, 1}};

Vector9 vector_of(const Eigen::Matrix3d& F) {
  Vector9 f;
  f << F.row(0).transpose(), F.row(1).transpose(), F.row(2).transpose();
  return f;
}

/// The null direction as a cross product: the longest of three.
Eigen::Vector3d quick_null(const Eigen::Matrix3d& F) {
  const Eigen::Vector3d c[3] = {F.row(0).cross(F.row(1)), F.row(1).cross(F.row(2)), F.row(2).cross(F.row(0))};
  const Eigen::Vector3d* longest = &c[0];
  for (const Eigen::Vector3d& v : c)
    if (v.squaredNorm() > longest->squaredNorm()) longest = &v;
  return *longest;
}

/// Sampson distance and its derivative by F, row by row.
double sampson_with_gradient(const Eigen::Matrix3d& F, const Match& m, Vector9& gradient) {
  const double x[3] = {m.a.x(), m.a.y(), 1}, y[3] = {m.b.x(), m.b.y(), 1};
  double l[2], k[2];
  for (int i = 0; i < 2; ++i) {
    l[i] = F(i, 0) * x[0] + F(i, 1) * x[1] + F(i, 2);
    k[i] = F(0, i) * y[0] + F(1, i) * y[1] + F(2, i);
  }
  const double l2 = F(2, 0) * x[0] + F(2, 1) * x[1] + F(2, 2);
  const double d = l[0] * l[0] + l[1] * l[1] + k[0] * k[0] + k[1] * k[1];
  if (!(d > 0)) return gradient.setZero(), 0;
  const double num = y[0] * l[0] + y[1] * l[1] + l2;
  const double inverse = 1 / std::sqrt(d), slope = num * inverse / d;
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      gradient[3 * j + i] =
          inverse * y[j] * x[i] - slope * ((j < 2 ? l[j] * x[i] : 0) + (i < 2 ? k[i] * y[j] : 0));
  return num * inverse;
}

struct Normal {
  Matrix7 A = Matrix7::Zero();
  Vector7 b = Vector7::Zero();
  double cost = 0;
};

/// J^T W J, J^T W s of the Sampson distances s over the chart's parameters.
Normal normal_equations(std::span<const Match> matches, std::span<const double> weights,
                        const Eigen::Matrix3d& F, const Eigen::Matrix<double, 9, 7>& chart) {
  Eigen::Matrix<double, 9, 9> A = Eigen::Matrix<double, 9, 9>::Zero();
  Vector9 b = Vector9::Zero(), g;
  Normal n;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const double w = weights.empty() ? 1 : weights[i];
    if (w == 0) continue;
    const double s = sampson_with_gradient(F, matches[i], g);
    n.cost += w * s * s;
    b += (w * s) * g;
    A.noalias() += w * g * g.transpose();
  }
  n.A = chart.transpose() * A * chart;
  n.b = chart.transpose() * b;
  return n;
}

double weighted_cost(std::span<const Match> matches, std::span<const double> weights,
                     const Eigen::Matrix3d& F) {
  double cost = 0;
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const double s = sampson_distance(F, matches[i]);
    cost += (weights.empty() ? 1 : weights[i]) * s * s;
  }
  return cost;
}

Matches normalised(std::span<const Match> matches, const Similarity2& Ta, const Similarity2& Tb) {
  Matches out;
  out.reserve(matches.size());
  for (const Match& m : matches) out.push_back({Ta * m.a, Tb * m.b});
  return out;
}

/// Both pictures at one scale: distances then stay those of pixels, up to that scale.
std::pair<Similarity2, Similarity2> common_normalisation(std::span<const Match> matches) {
  auto [Ta, Tb] = normalisation(matches);
  Ta.scale = Tb.scale = std::sqrt(Ta.scale * Tb.scale);
  return {Ta, Tb};
}

/// F = L B R of the chart, for numbers and for Ceres's dual numbers.
template <class T>
Eigen::Matrix<T, 3, 3> chart_matrix(const FundamentalChart& chart, const T* p) {
  const int *cols = kOthers[chart.k], *rows = kOthers[chart.l];
  Eigen::Matrix<T, 3, 3> F;
  for (int i = 0, at = 4; i < 4; ++i) F(rows[i / 2], cols[i % 2]) = i == chart.fixed ? T(1) : p[at++];
  for (int i = 0; i < 2; ++i) F(rows[i], chart.k) = -p[0] * F(rows[i], cols[0]) - p[1] * F(rows[i], cols[1]);
  F.row(chart.l) = -p[2] * F.row(rows[0]) - p[3] * F.row(rows[1]);
  return F;
}

/// P' = [[e']_x F | e'] of the chart's parameters; F^T e' = 0 is built into them.
template <class T>
Eigen::Matrix<T, 3, 4> chart_camera(const FundamentalChart& chart, const T* p) {
  const Eigen::Matrix<T, 3, 3> F = chart_matrix(chart, p);
  Eigen::Matrix<T, 3, 1> e;
  e[chart.l] = T(1);
  e[kOthers[chart.l][0]] = p[2];
  e[kOthers[chart.l][1]] = p[3];
  Eigen::Matrix<T, 3, 4> P;
  for (int i = 0; i < 3; ++i) P.col(i) = e.cross(F.col(i));
  P.col(3) = e;
  return P;
}

struct Reprojection {
  Match m;
  FundamentalChart chart;
  double root = 1;  ///< of the match's weight
  template <class T>
  bool operator()(const T* p, const T* X, T* r) const {
    const Eigen::Matrix<T, 3, 4> P = chart_camera(chart, p);
    r[0] = root * (X[0] - m.a.x());
    r[1] = root * (X[1] - m.a.y());
    const Eigen::Matrix<T, 3, 1> y = P * Eigen::Matrix<T, 4, 1>(X[0], X[1], T(1), X[2]);
    r[2] = root * (y[0] / y[2] - m.b.x());
    r[3] = root * (y[1] / y[2] - m.b.y());
    return true;
  }
};

/// rho of the point (x, y, 1, rho) that P' = [M | t] sees at b, for corrected matches.
double inverse_depth(const Matrix34d& P, const Match& m) {
  // b x (M x + rho t) = 0
  const Eigen::Vector3d y = m.b.homogeneous();
  const Eigen::Vector3d u = y.cross(P.leftCols<3>() * m.a.homogeneous()), v = y.cross(P.col(3));
  const double d = v.squaredNorm();
  return d > 0 ? -u.dot(v) / d : 0;
}

/// What the estimate says of itself, in px: noise, covariance, condition. F and matches in normalised
/// coordinates.
void finish(std::span<const Match> matches, const Eigen::Matrix3d& F, double cost, const Similarity2& Ta,
            const Similarity2& Tb, FundamentalMl& ml) {
  const double n = static_cast<double>(matches.size());
  ml.noise_px = n > 7 ? std::sqrt(cost / (n - 7)) / Ta.scale : std::numeric_limits<double>::quiet_NaN();
  Matches points;
  for (const Match& m : matches) points.push_back(corrected(F, m));
  const FundamentalChart chart = FundamentalChart::of(F);
  const FundamentalChart::Parameters p = chart.parameters(F);
  const Eigen::Matrix3d own = chart.matrix(p);
  const Eigen::Matrix<double, 9, 7> J = chart.jacobian(p);
  const Matrix7 information = normal_equations(points, {}, own, J).A;
  // Onto an orthonormal basis of the tangent space, where directions can be compared.
  const Eigen::HouseholderQR<Eigen::Matrix<double, 9, 7>> qr(J);
  const Matrix7 R = qr.matrixQR().topRows<7>().triangularView<Eigen::Upper>();
  const Matrix7 R_inverse = R.inverse();
  const Eigen::SelfAdjointEigenSolver<Matrix7> eigen(R_inverse.transpose() * information * R_inverse);
  const Vector7 values = eigen.eigenvalues().cwiseMax(1e-14 * eigen.eigenvalues().maxCoeff());
  ml.condition = std::sqrt(values.maxCoeff() / values.minCoeff());
  const Matrix7 inverse = R_inverse * eigen.eigenvectors() * values.cwiseInverse().asDiagonal() *
                          eigen.eigenvectors().transpose() * R_inverse.transpose();
  // F_px = Tb^T F Ta, then to norm 1: f / |f| has the derivative (I - f f^T) / |f|.
  Eigen::Matrix<double, 9, 9> T;
  for (int i = 0; i < 9; ++i) {
    Eigen::Matrix3d E = Eigen::Matrix3d::Zero();
    E(i / 3, i % 3) = 1;
    T.col(i) = vector_of(Tb.matrix().transpose() * E * Ta.matrix());
  }
  const Eigen::Matrix3d F_px = Tb.matrix().transpose() * F * Ta.matrix();
  ml.F = unit_scale(F_px);
  const Vector9 f = vector_of(ml.F);
  const double length = (T * vector_of(own)).norm();
  const Eigen::Matrix<double, 9, 7> K =
      (Eigen::Matrix<double, 9, 9>::Identity() - f * f.transpose()) / length * T * J;
  ml.covariance = K * inverse * K.transpose() * (Ta.scale * Ta.scale);
}

}  // namespace

FundamentalChart FundamentalChart::of(const Eigen::Matrix3d& F) {
  FundamentalChart chart;
  quick_null(F).cwiseAbs().maxCoeff(&chart.k);
  quick_null(F.transpose()).cwiseAbs().maxCoeff(&chart.l);
  double largest = -1;
  for (int i = 0; i < 4; ++i) {
    const double entry = std::abs(F(kOthers[chart.l][i / 2], kOthers[chart.k][i % 2]));
    if (entry > largest) largest = entry, chart.fixed = i;
  }
  return chart;
}

FundamentalChart::Parameters FundamentalChart::parameters(const Eigen::Matrix3d& F) const {
  const Eigen::Vector3d e = quick_null(F), f = quick_null(F.transpose());
  const int *cols = kOthers[k], *rows = kOthers[l];
  Parameters p;
  p[0] = e[cols[0]] / e[k];
  p[1] = e[cols[1]] / e[k];
  p[2] = f[rows[0]] / f[l];
  p[3] = f[rows[1]] / f[l];
  const double unit = F(rows[fixed / 2], cols[fixed % 2]);
  for (int i = 0, at = 4; i < 4; ++i)
    if (i != fixed) p[at++] = F(rows[i / 2], cols[i % 2]) / unit;
  return p;
}

Eigen::Matrix3d FundamentalChart::matrix(const Parameters& p) const { return chart_matrix(*this, p.data()); }

Eigen::Matrix<double, 9, 7> FundamentalChart::jacobian(const Parameters& p) const {
  const int *cols = kOthers[k], *rows = kOthers[l];
  Eigen::Matrix<double, 3, 2> L = Eigen::Matrix<double, 3, 2>::Zero();
  Eigen::Matrix<double, 2, 3> R = Eigen::Matrix<double, 2, 3>::Zero();
  Eigen::Matrix2d B;
  for (int i = 0, at = 4; i < 4; ++i) B(i / 2, i % 2) = i == fixed ? 1 : p[at++];
  L(rows[0], 0) = L(rows[1], 1) = R(0, cols[0]) = R(1, cols[1]) = 1;
  R.col(k) << -p[0], -p[1];
  L.row(l) << -p[2], -p[3];
  Eigen::Matrix<double, 9, 7> J;
  for (int i = 0; i < 2; ++i) {
    Eigen::Matrix<double, 2, 3> dR = Eigen::Matrix<double, 2, 3>::Zero();
    Eigen::Matrix<double, 3, 2> dL = Eigen::Matrix<double, 3, 2>::Zero();
    dR(i, k) = -1;
    dL(l, i) = -1;
    J.col(i) = vector_of(L * B * dR);
    J.col(2 + i) = vector_of(dL * B * R);
  }
  for (int i = 0, at = 4; i < 4; ++i)
    if (i != fixed) J.col(at++) = vector_of(L.col(i / 2) * R.row(i % 2));
  return J;
}

Eigen::Matrix3d refine_sampson(std::span<const Match> matches, std::span<const double> weights,
                               Eigen::Matrix3d F, int most_steps) {
  double damping = 1e-4;
  FundamentalChart chart = FundamentalChart::of(F);
  FundamentalChart::Parameters p = chart.parameters(F);
  F = chart.matrix(p);
  if (!F.allFinite()) return F;
  Normal n = normal_equations(matches, weights, F, chart.jacobian(p));
  for (int step = 0; step < most_steps; ++step) {
    Matrix7 A = n.A;
    A.diagonal() *= 1 + damping;
    A.diagonal().array() += 1e-15 * n.A.trace();
    const Vector7 change = A.ldlt().solve(n.b);
    const Eigen::Matrix3d moved = chart.matrix(p - change);
    const double cost = weighted_cost(matches, weights, moved);
    if (!(cost <= n.cost)) {
      if ((damping *= 10) > 1e8) break;
      continue;
    }
    const double gain = n.cost - cost;
    damping = std::max(1e-12, damping * 0.1);
    F = moved / moved.norm();
    if (gain <= 1e-14 * n.cost) break;
    chart = FundamentalChart::of(F);
    p = chart.parameters(F);
    F = chart.matrix(p);
    n = normal_equations(matches, weights, F, chart.jacobian(p));
  }
  return F / F.norm();
}

std::optional<FundamentalMl> sampson_estimate(std::span<const Match> matches, const Eigen::Matrix3d& start,
                                              std::span<const double> weights) {
  if (matches.size() < 7 || !start.allFinite()) return std::nullopt;
  const auto [Ta, Tb] = common_normalisation(matches);
  const Matches points = normalised(matches, Ta, Tb);
  const Eigen::Matrix3d begin =
      closest_rank2(Tb.matrix().transpose().inverse() * start * Ta.matrix().inverse());
  const Eigen::Matrix3d F = refine_sampson(points, weights, begin, 100);
  if (!F.allFinite()) return std::nullopt;
  FundamentalMl ml;
  ml.converged = true;
  finish(points, F, weighted_cost(points, weights, F), Ta, Tb, ml);
  return ml;
}

std::optional<FundamentalMl> gold_standard(std::span<const Match> matches, const Eigen::Matrix3d& start,
                                           std::span<const double> weights) {
  if (matches.size() < 7 || !start.allFinite()) return std::nullopt;
  const auto [Ta, Tb] = common_normalisation(matches);
  const Matches points = normalised(matches, Ta, Tb);
  const Eigen::Matrix3d begin =
      closest_rank2(Tb.matrix().transpose().inverse() * start * Ta.matrix().inverse());
  const Eigen::Matrix3d first = refine_sampson(points, weights, begin, 100);
  if (!first.allFinite()) return std::nullopt;
  const FundamentalChart chart = FundamentalChart::of(first);
  FundamentalChart::Parameters p = chart.parameters(first);
  const Matrix34d P = chart_camera(chart, p.data());
  std::vector<Eigen::Vector3d> X;
  ceres::Problem::Options own;
  own.disable_all_safety_checks = true;
  ceres::Problem problem(own);
  problem.AddParameterBlock(p.data(), 7);
  X.reserve(points.size());
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Match c = corrected(first, points[i]);
    X.emplace_back(c.a.x(), c.a.y(), inverse_depth(P, c));
    const double root = weights.empty() ? 1 : std::sqrt(weights[i]);
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<Reprojection, 4, 7, 3>(new Reprojection{points[i], chart, root}),
        nullptr, p.data(), X.back().data());
    ordering->AddElementToGroup(X.back().data(), 0);
  }
  ordering->AddElementToGroup(p.data(), 1);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = ordering;
  options.num_threads = 1;
  options.max_num_iterations = 50;
  options.function_tolerance = 1e-12;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  const Eigen::Matrix3d F = closest_rank2(chart.matrix(p));
  if (!summary.IsSolutionUsable() || !F.allFinite()) return sampson_estimate(matches, start, weights);
  FundamentalMl ml;
  ml.converged = summary.termination_type == ceres::CONVERGENCE;
  finish(points, F, 2 * summary.final_cost, Ta, Tb, ml);
  return ml;
}

Eigen::Matrix3d line_envelope(const Eigen::Matrix3d& F, const Eigen::Matrix<double, 9, 9>& covariance,
                              const Eigen::Vector2d& a, double sigmas) {
  // l = F x; scaled to |l| = 1, which takes the free scale out of its covariance.
  const Eigen::Vector3d x = a.homogeneous();
  Eigen::Matrix<double, 3, 9> J = Eigen::Matrix<double, 3, 9>::Zero();
  for (int i = 0; i < 3; ++i) J.block<1, 3>(i, 3 * i) = x.transpose();
  const Eigen::Vector3d l = F * x;
  const Eigen::Vector3d unit = l.normalized();
  const Eigen::Matrix3d D = (Eigen::Matrix3d::Identity() - unit * unit.transpose()) / l.norm();
  return unit * unit.transpose() - sigmas * sigmas * D * J * covariance * J.transpose() * D.transpose();
}

double line_sigma(const Eigen::Matrix3d& F, const Eigen::Matrix<double, 9, 9>& covariance,
                  const Eigen::Vector2d& a, const Eigen::Vector2d& b) {
  const Eigen::Vector3d x = a.homogeneous(), l = F * x;
  const double d = l.head<2>().norm();
  if (!(d > 0)) return std::numeric_limits<double>::infinity();
  const double off = b.homogeneous().dot(l) / (d * d);
  const Eigen::Vector3d y = (b - off * l.head<2>()).homogeneous();
  Vector9 g;
  for (int i = 0; i < 3; ++i) g.segment<3>(3 * i) = y[i] * x / d;
  return std::sqrt(std::max(0.0, g.dot(covariance * g)));
}

Match corrected(const Eigen::Matrix3d& F, const Match& m) {
  // Kanatani, Sugaya, Niitsuma, BMVC 2008: Newton's step at the corrected point of the last round.
  Match c = m;
  for (int round = 0; round < 10; ++round) {
    const Eigen::Vector2d l = (F * c.a.homogeneous()).head<2>();
    const Eigen::Vector2d k = (F.transpose() * c.b.homogeneous()).head<2>();
    const double d = l.squaredNorm() + k.squaredNorm();
    if (!(d > 0)) return m;
    const Eigen::Vector2d da = m.a - c.a, db = m.b - c.b;
    const double e = c.b.homogeneous().dot(F * c.a.homogeneous()) + l.dot(db) + k.dot(da);
    const Match next{m.a - e / d * k, m.b - e / d * l};
    const double moved = (next.a - c.a).squaredNorm() + (next.b - c.b).squaredNorm();
    c = next;
    if (moved < 1e-24) break;
  }
  return c;
}

Eigen::Vector4d triangulate(const Matrix34d& P_a, const Matrix34d& P_b, const Match& m) {
  Eigen::Matrix4d A;
  A << m.a.x() * P_a.row(2) - P_a.row(0), m.a.y() * P_a.row(2) - P_a.row(1),
      m.b.x() * P_b.row(2) - P_b.row(0), m.b.y() * P_b.row(2) - P_b.row(1);
  for (int i = 0; i < 4; ++i) A.row(i).normalize();
  return Eigen::JacobiSVD<Eigen::Matrix4d>(A, Eigen::ComputeFullV).matrixV().col(3);
}

}  // namespace stuv
