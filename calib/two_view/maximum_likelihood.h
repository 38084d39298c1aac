#pragma once

#include <Eigen/Dense>
#include <optional>
#include <span>
#include <vector>

#include "calib/two_view/fundamental.h"

namespace stuv {

/// One of 36 minimal parametrisations of F (7 numbers), which hold wherever the epipoles lie, at infinity
/// too:
///
///   F = L B R,  B 2 x 2 with its largest entry fixed at 1,  R = [I | -(e1, e2)^T],  L = [I | -(e'1, e'2)]^T
///
/// up to the order of rows and columns: column k of F hangs on the others by F e = 0 with e_k = 1, row l by
/// F^T e' = 0 with e'_l = 1; k, l and the entry of B are those that are largest, 3 x 3 x 4 of them. Hartley
/// and Zisserman, 11.4.2.
struct FundamentalChart {
  int k = 2, l = 2, fixed = 0;
  using Parameters = Eigen::Matrix<double, 7, 1>;  ///< e1, e2, e'1, e'2, the other three of B

  static FundamentalChart of(const Eigen::Matrix3d& F);
  Parameters parameters(const Eigen::Matrix3d& F) const;
  Eigen::Matrix3d matrix(const Parameters& p) const;
  /// d F / d p, F row by row.
  Eigen::Matrix<double, 9, 7> jacobian(const Parameters& p) const;
};

/// Minimises sum_i w_i s_i^2, s the Sampson distance, by Levenberg and Marquardt over the chart that fits F,
/// chosen anew at every step. First order of the maximum likelihood. `matches` have coordinates of about 1
/// (normalisation()).
Eigen::Matrix3d refine_sampson(std::span<const Match> matches, std::span<const double> weights,
                               Eigen::Matrix3d F, int most_steps = 20);

struct FundamentalMl {
  Eigen::Matrix3d F = Eigen::Matrix3d::Zero();  ///< unit_scale
  bool converged = false;
  double noise_px = 0;  ///< sqrt(sum d^2 / (n - 7)); NaN for n = 7
  /// Covariance of F's entries row by row for noise of 1 px, tangential to rank 2 and norm 1 (rank 7): times
  /// noise_px^2. The Cramer-Rao bound where the corrected points are the true ones.
  Eigen::Matrix<double, 9, 9> covariance = Eigen::Matrix<double, 9, 9>::Zero();
  /// Largest over smallest standard deviation of F's seven directions, in normalised coordinates: 1e6 and
  /// more says that the matches leave F free.
  double condition = 0;
};

/// Gold Standard: minimises sum d(x, x^)^2 + d(x', x'^)^2 over P' and all points, P = [I | 0], x^'^T F x^ =
/// 0, by Ceres with the points eliminated (sparse). Points are (x^, y^, 1, rho), so they may be at infinity;
/// P' is a full 3 x 4. Starts from the Sampson estimate. Hartley and Zisserman, algorithm 11.3. Nothing below
/// 7 matches. `weights` of the matches' squares, above 0; empty: all 1. With others, noise_px is the caller's
/// to set.
std::optional<FundamentalMl> gold_standard(std::span<const Match> matches, const Eigen::Matrix3d& start,
                                           std::span<const double> weights = {});
/// The cheap version: refine_sampson.
std::optional<FundamentalMl> sampson_estimate(std::span<const Match> matches, const Eigen::Matrix3d& start,
                                              std::span<const double> weights = {});

/// Where the line F x lies, to `sigmas` standard deviations: between the branches of the conic y^T C y = 0,
/// C = l l^T - k^2 Sigma_l (Hartley and Zisserman, 11.11; Csurka and others 1997). `covariance` of F in px.
Eigen::Matrix3d line_envelope(const Eigen::Matrix3d& F, const Eigen::Matrix<double, 9, 9>& covariance,
                              const Eigen::Vector2d& a, double sigmas);
/// Standard deviation, across the line, of F x at the point of the line that is nearest to b [px].
double line_sigma(const Eigen::Matrix3d& F, const Eigen::Matrix<double, 9, 9>& covariance,
                  const Eigen::Vector2d& a, const Eigen::Vector2d& b);

/// The points closest to (a, b) that satisfy x'^T F x = 0 exactly (Kanatani's iteration, which converges on
/// the optimum of Hartley and Sturm in a few steps).
Match corrected(const Eigen::Matrix3d& F, const Match& m);
/// Homogeneous X of least algebraic error in both pictures; exact for corrected points.
Eigen::Vector4d triangulate(const Matrix34d& P_a, const Matrix34d& P_b, const Match& m);

}  // namespace stuv
