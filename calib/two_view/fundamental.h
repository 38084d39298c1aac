#pragma once

#include <Eigen/Dense>
#include <array>
#include <optional>
#include <span>
#include <vector>

#include "calib/two_view/match.h"

namespace stuv {

// F maps a point x of picture A to its line l' = F x in picture B: x'^T F x = 0, homogeneous, |F| = 1
// (Frobenius). F e = 0, e'^T F = 0, rank 2. F of the pictures exchanged is F^T. Source of all: Hartley and
// Zisserman, Multiple View Geometry, 2nd ed., chapters 9 and 11.

using Matrix34d = Eigen::Matrix<double, 3, 4>;

/// Of Frobenius norm 1, its largest entry positive: one F for all multiples.
Eigen::Matrix3d unit_scale(const Eigen::Matrix3d& F);
/// The closest matrix of rank 2 (Frobenius), unit_scale.
Eigen::Matrix3d closest_rank2(const Eigen::Matrix3d& F);

/// Moves a picture's points to mean 0 and scales them to rms distance sqrt(2) (Hartley, PAMI 1997).
struct Similarity2 {
  double scale = 1;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  Eigen::Vector2d operator*(const Eigen::Vector2d& x) const { return scale * (x - centre); }
  Eigen::Matrix3d matrix() const;
};
/// Of all a, of all b. Scale 1 where the points coincide.
std::pair<Similarity2, Similarity2> normalisation(std::span<const Match> matches);

/// All F through seven matches: the null space F1, F2 of the 7 x 9 system, and det(z F1 + (1 - z) F2) = 0, a
/// cubic with one or three real solutions. Writes them to `F` (rank 2 to rounding) and returns how many; 0 if
/// the system has rank below 7.
int seven_point(std::span<const Match, 7> matches, std::array<Eigen::Matrix3d, 3>& F);

/// Least squares of x'^T F x with |F| = 1 over n >= 8 matches, each weighed (empty: all 1), in normalised
/// coordinates, then rank 2 enforced there. `normalise` false is for comparison only. Nothing if n < 8 or a
/// value is not finite.
std::optional<Eigen::Matrix3d> eight_point(std::span<const Match> matches,
                                           std::span<const double> weights = {}, bool normalise = true);

/// F of a pure translation with one lens, F = [e]_x (2 degrees of freedom): least squares over n >= 2 matches
/// in normalised coordinates.
std::optional<Eigen::Matrix3d> translation_fundamental(std::span<const Match> matches);

/// F of planar motion with one lens (turns about an axis normal to the translation, wheels on a floor): also
/// det(F + F^T) = 0, 6 degrees of freedom. The closest such F: the symmetric part to rank 2, then F to rank
/// 2, in turns. Nothing below 8 matches.
std::optional<Eigen::Matrix3d> planar_motion_fundamental(std::span<const Match> matches);

/// Null vectors of F and of F^T, of unit length; third component 0 where the epipole is at infinity.
Eigen::Vector3d epipole_a(const Eigen::Matrix3d& F);
Eigen::Vector3d epipole_b(const Eigen::Matrix3d& F);

/// Cameras P = [I | 0], P' = [[e']_x F | e'] that F belongs to (up to a projectivity of space).
Matrix34d canonical_camera(const Eigen::Matrix3d& F);
/// F of two cameras: [e']_x P' P^+, e' = P' C.
Eigen::Matrix3d fundamental_of(const Matrix34d& P_a, const Matrix34d& P_b);

/// Signed first-order distance of the match from the variety x'^T F x = 0 [px]:
/// x'^T F x / sqrt((Fx)_1^2 + (Fx)_2^2 + (F^T x')_1^2 + (F^T x')_2^2). 0 where the gradient vanishes (both
/// epipoles).
double sampson_distance(const Eigen::Matrix3d& F, const Match& m);
/// d(x', F x)^2 + d(x, F^T x')^2 [px^2].
double symmetric_epipolar_distance2(const Eigen::Matrix3d& F, const Match& m);
/// d(x', F x), the distance of b from the epipolar line of a [px].
double line_distance(const Eigen::Matrix3d& F, const Match& m);

}  // namespace stuv
