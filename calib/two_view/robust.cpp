#include "calib/two_view/robust.h"

#include <algorithm>
#include <cmath>

#include "calib/two_view/fundamental.h"
#include "calib/two_view/maximum_likelihood.h"
#include "core/pose.h"

namespace stuv {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// Matches near the origin and of size 1, each coordinate in an array of its own: what the inner loops read.
/// Both pictures share one scale, so distances are those of pixels times it.
struct Arranged {
  Similarity2 Ta, Tb;
  Matches matches;
  std::vector<double> ax, ay, bx, by;
  double threshold2 = 0;

  Arranged(std::span<const Match> in, double threshold_px) {
    std::tie(Ta, Tb) = normalisation(in);
    Ta.scale = Tb.scale = std::sqrt(Ta.scale * Tb.scale);
    threshold2 = std::pow(threshold_px * Ta.scale, 2);
    for (const Match& m : in) {
      matches.push_back({Ta * m.a, Tb * m.b});
      ax.push_back(matches.back().a.x());
      ay.push_back(matches.back().a.y());
      bx.push_back(matches.back().b.x());
      by.push_back(matches.back().b.y());
    }
  }
  int size() const { return static_cast<int>(matches.size()); }
  Matrix3d fundamental_to_px(const Matrix3d& F) const {
    return unit_scale(Tb.matrix().transpose() * F * Ta.matrix());
  }
  Matrix3d homography_to_px(const Matrix3d& H) const {
    return unit_scale(Tb.matrix().inverse() * H * Ta.matrix());
  }
  Matrix3d homography_from_px(const Matrix3d& H) const {
    return unit_scale(Tb.matrix() * H * Ta.matrix().inverse());
  }
};

constexpr int kBlock = 32;

/// Sum of 1 - (1 - v)^2 over the matches, block by block, so that a bad model costs one block.
template <class Residual2>
double truncated_cost(int n, double threshold2, double bail, const Residual2& residual2) {
  const double inverse = 1 / threshold2;
  double cost = 0;
  for (int begin = 0; begin < n && cost < bail; begin += kBlock) {
    const int end = std::min(n, begin + kBlock);
    for (int i = begin; i < end; ++i) {
      const double r2 = residual2(i) * inverse;
      const double v = r2 < 1 ? r2 : 1;
      cost += v * (2 - v);
    }
  }
  return cost;
}

/// Squared Sampson distances of one F.
struct SampsonOf {
  const Arranged& in;
  double f[9];
  SampsonOf(const Arranged& a, const Matrix3d& F) : in(a) {
    for (int i = 0; i < 9; ++i) f[i] = F(i / 3, i % 3);
  }
  double operator()(int i) const {
    const double x = in.ax[i], y = in.ay[i], u = in.bx[i], v = in.by[i];
    const double l0 = f[0] * x + f[1] * y + f[2], l1 = f[3] * x + f[4] * y + f[5];
    const double num = u * l0 + v * l1 + f[6] * x + f[7] * y + f[8];
    const double k0 = f[0] * u + f[3] * v + f[6], k1 = f[1] * u + f[4] * v + f[7];
    return num * num / (l0 * l0 + l1 * l1 + k0 * k0 + k1 * k1 + 1e-300);
  }
};

template <class Residual2>
int count_inliers(int n, double threshold2, const Residual2& residual2) {
  int count = 0;
  for (int i = 0; i < n; ++i) count += residual2(i) < threshold2 ? 1 : 0;
  return count;
}

/// Weights 1 - v of the cost: it is sum of 2 v - v^2, whose slope by r^2 they are.
template <class Residual2>
std::vector<double> cost_weights(int n, double threshold2, const Residual2& residual2) {
  std::vector<double> w(n);
  for (int i = 0; i < n; ++i) w[i] = std::max(0.0, 1 - residual2(i) / threshold2);
  return w;
}

struct FundamentalProblem {
  using Model = Matrix3d;
  static constexpr int kSampleSize = 7, kMostModels = 3;
  const Arranged& in;

  int size() const { return in.size(); }
  int solve(const std::array<int, 7>& sample, std::array<Matrix3d, 3>& models) const {
    std::array<Match, 7> chosen;
    for (int i = 0; i < 7; ++i) chosen[i] = in.matches[sample[i]];
    std::array<Matrix3d, 3> all;
    const int n = seven_point(chosen, all);
    int kept = 0;
    for (int k = 0; k < n; ++k)
      if (oriented(all[k], chosen)) models[kept++] = all[k];
    return kept;
  }
  double cost(const Matrix3d& F, double bail) const {
    return truncated_cost(size(), in.threshold2, bail, SampsonOf(in, F));
  }
  int inliers(const Matrix3d& F) const { return count_inliers(size(), in.threshold2, SampsonOf(in, F)); }
  Matrix3d refine(const Matrix3d& F) const {
    const std::vector<double> w = cost_weights(size(), in.threshold2, SampsonOf(in, F));
    return refine_sampson(in.matches, w, F, 3);
  }

  /// e' x x' and F x point the same way, or opposite ways, for all of the sample.
  static bool oriented(const Matrix3d& F, const std::array<Match, 7>& sample) {
    Vector3d e = F.col(0).cross(F.col(1));
    for (const Vector3d& other : {Vector3d(F.col(1).cross(F.col(2))), Vector3d(F.col(2).cross(F.col(0)))})
      if (other.squaredNorm() > e.squaredNorm()) e = other;
    double first = 0;
    for (const Match& m : sample) {
      const double sign = e.cross(m.b.homogeneous()).dot(F * m.a.homogeneous());
      if (first == 0) first = sign;
      if (sign * first < 0) return false;
    }
    return true;
  }
};

/// Squared residuals of one H.
struct TransferOf {
  const Arranged& in;
  Matrix3d H, H_inverse;
  TransferOf(const Arranged& a, const Matrix3d& h) : in(a), H(h), H_inverse(h.inverse()) {}
  double operator()(int i) const { return transfer_distance2(H, H_inverse, in.matches[i]); }
};

struct HomographyProblem {
  using Model = Matrix3d;
  static constexpr int kSampleSize = 4, kMostModels = 1;
  const Arranged& in;

  int size() const { return in.size(); }
  int solve(const std::array<int, 4>& sample, std::array<Matrix3d, 1>& models) const {
    Eigen::Matrix<double, 8, 8> A;
    Eigen::Matrix<double, 8, 1> b;
    for (int i = 0; i < 4; ++i) {
      const Match& m = in.matches[sample[i]];
      const double x = m.a.x(), y = m.a.y(), u = m.b.x(), v = m.b.y();
      A.row(2 * i) << x, y, 1, 0, 0, 0, -u * x, -u * y;
      A.row(2 * i + 1) << 0, 0, 0, x, y, 1, -v * x, -v * y;
      b.segment<2>(2 * i) << u, v;
    }
    const Eigen::Matrix<double, 8, 1> h = A.partialPivLu().solve(b);
    if (!h.allFinite() || h.norm() > 1e8) return 0;
    models[0] << h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1;
    // Points before the camera stay before it.
    double first = 0;
    for (const int i : sample) {
      const double w = models[0].row(2).dot(in.matches[i].a.homogeneous());
      if (first == 0) first = w;
      if (w * first <= 0) return 0;
    }
    return std::abs(models[0].determinant()) > 1e-9 ? 1 : 0;
  }
  double cost(const Matrix3d& H, double bail) const {
    return truncated_cost(size(), in.threshold2, bail, TransferOf(in, H));
  }
  int inliers(const Matrix3d& H) const { return count_inliers(size(), in.threshold2, TransferOf(in, H)); }
  Matrix3d refine(const Matrix3d& H) const {
    const std::vector<double> w = cost_weights(size(), in.threshold2, TransferOf(in, H));
    return homography_of(in.matches, w).value_or(H);
  }
};

struct ParallaxProblem {
  using Model = Matrix3d;
  static constexpr int kSampleSize = 2, kMostModels = 1;
  const Arranged& in;
  const Matrix3d& H;
  std::span<const int> off_plane;

  int size() const { return static_cast<int>(off_plane.size()); }
  int solve(const std::array<int, 2>& sample, std::array<Matrix3d, 1>& models) const {
    Vector3d line[2];
    for (int i = 0; i < 2; ++i) {
      const Match& m = in.matches[off_plane[sample[i]]];
      line[i] = (H * m.a.homogeneous()).normalized().cross(m.b.homogeneous()).normalized();
    }
    const Vector3d e = line[0].cross(line[1]);
    if (!(e.norm() > 1e-9)) return 0;
    models[0] = cross_matrix(e.normalized()) * H;
    models[0] /= models[0].norm();
    return models[0].allFinite() ? 1 : 0;
  }
  /// Over the matches off the plane: those on it fit any epipole.
  double cost(const Matrix3d& F, double bail) const {
    const SampsonOf sampson(in, F);
    return truncated_cost(size(), in.threshold2, bail, [&](int i) { return sampson(off_plane[i]); });
  }
  int inliers(const Matrix3d& F) const {
    const SampsonOf sampson(in, F);
    return count_inliers(size(), in.threshold2, [&](int i) { return sampson(off_plane[i]); });
  }
  Matrix3d refine(const Matrix3d& F) const { return FundamentalProblem{in}.refine(F); }
};

RansacResult<Matrix3d> polish(const Arranged& in, Matrix3d F) {
  const FundamentalProblem problem{in};
  RansacResult<Matrix3d> result;
  double cost = problem.cost(F, in.size());
  for (int round = 0; round < 30; ++round) {
    const Matrix3d next = problem.refine(F);
    const double next_cost = problem.cost(next, in.size());
    if (!(next_cost < cost * (1 - 1e-9))) break;
    cost = next_cost;
    F = next;
  }
  result.model = in.fundamental_to_px(F);
  result.found = F.allFinite() && cost < in.size();
  result.support = in.size() - cost;
  result.inliers = problem.inliers(F);
  return result;
}

}  // namespace

RansacResult<Matrix3d> ransac_fundamental(std::span<const Match> matches, const RansacOptions& options) {
  const Arranged in(matches, options.threshold_px);
  auto result = ransac(FundamentalProblem{in}, options);
  if (result.found) result.model = in.fundamental_to_px(result.model);
  return result;
}

RansacResult<Matrix3d> ransac_homography(std::span<const Match> matches, const RansacOptions& options) {
  const Arranged in(matches, options.threshold_px);
  auto result = ransac(HomographyProblem{in}, options);
  if (result.found) result.model = in.homography_to_px(result.model);
  return result;
}

RansacResult<Matrix3d> plane_and_parallax(std::span<const Match> matches, const Matrix3d& H,
                                          std::span<const int> off_plane, const RansacOptions& options) {
  const Arranged in(matches, options.threshold_px);
  const Matrix3d plane = in.homography_from_px(H);
  const auto found = ransac(ParallaxProblem{in, plane, off_plane}, options);
  if (!found.found) return found;
  auto result = polish(in, found.model);
  result.samples = found.samples;
  return result;
}

std::optional<Matrix3d> homography_of(std::span<const Match> matches, std::span<const double> weights) {
  if (matches.size() < 4) return std::nullopt;
  const auto [Ta, Tb] = normalisation(matches);
  Eigen::Matrix<double, 9, 9> AtA = Eigen::Matrix<double, 9, 9>::Zero();
  for (std::size_t i = 0; i < matches.size(); ++i) {
    const double weight = weights.empty() ? 1 : weights[i];
    if (weight == 0) continue;
    const Eigen::RowVector3d x = (Ta * matches[i].a).homogeneous().transpose();
    const Eigen::Vector2d y = Tb * matches[i].b;
    Eigen::Matrix<double, 2, 9> rows;
    rows << x, Eigen::RowVector3d::Zero(), -y.x() * x, Eigen::RowVector3d::Zero(), x, -y.y() * x;
    AtA.noalias() += weight * rows.transpose() * rows;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 9, 9>> eigen(AtA);
  const Eigen::Matrix<double, 9, 1> h = eigen.eigenvectors().col(0);
  const Matrix3d H = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(h.data());
  const Matrix3d H_px = unit_scale(Tb.matrix().inverse() * H * Ta.matrix());
  if (!H_px.allFinite()) return std::nullopt;
  return H_px;
}

double transfer_distance2(const Matrix3d& H, const Matrix3d& H_inverse, const Match& m) {
  const Vector3d forth = H * m.a.homogeneous(), back = H_inverse * m.b.homogeneous();
  const double d = (forth.hnormalized() - m.b).squaredNorm() + (back.hnormalized() - m.a).squaredNorm();
  return std::isfinite(d) ? 0.25 * d : std::numeric_limits<double>::infinity();
}

}  // namespace stuv
