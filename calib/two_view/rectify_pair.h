#pragma once

#include <Eigen/Dense>
#include <array>
#include <optional>

#include "calib/two_view/match.h"
#include "core/image.h"
#include "core/pose.h"

namespace stuv {

/// A pair whose epipolar lines are rows: a point at (x, y) of A is at (x + D, y) of B.
struct RectifiedPair {
  Image a, b;  ///< masked where the pictures do not reach
  /// Where each rectified pixel lies in its picture [px], two channels x, y; NaN outside of it.
  ImageF from_a, from_b;
  bool polar = false;
  /// Planar: rectified = H picture. Zero if polar.
  Eigen::Matrix3d H_a = Eigen::Matrix3d::Zero(), H_b = Eigen::Matrix3d::Zero();
};

/// Homographies that send both epipoles to (1, 0, 0), uncalibrated (Hartley, IJCV 1999): B is turned and
/// sheared so that the middle of the picture keeps its shape and right angles, A follows by F with the x
/// shift, scale and shear that bring the matches closest. Nothing where that would stretch a corner more than
/// `most_stretch` times the opposite one: the epipole is in or near the picture.
struct RectifyingHomographies {
  Eigen::Matrix3d a, b;
};
std::optional<RectifyingHomographies> rectifying_homographies(const Eigen::Matrix3d& F,
                                                              const Matches& inliers,
                                                              const Eigen::Vector2i& size_a,
                                                              const Eigen::Vector2i& size_b,
                                                              double most_stretch = 3);

/// Calibrated: both cameras turn until their x axes lie on the baseline, their z axes as near to their mean
/// as that allows. K_a, K_b: pinholes; both results have A's focal length.
RectifyingHomographies rectifying_homographies(const Eigen::Matrix3d& K_a, const Eigen::Matrix3d& K_b,
                                               const Pose& b_from_a);

/// Warps both pictures; the frame holds both whole, at most twice their width.
RectifiedPair rectify_planar(const Image& a, const Image& b, const RectifyingHomographies& H);

/// Rows are half epipolar lines around the epipole, columns the distance from it [px] (Pollefeys, Koch, Van
/// Gool, ICCV 1999), or towards it where A lies to its left: always possible while the epipoles are finite.
/// Rows are so close that no pixel is lost. The matches tell which half lines belong together.
std::optional<RectifiedPair> rectify_polar(const Image& a, const Image& b, const Eigen::Matrix3d& F,
                                           const Matches& inliers);

/// Planar where it can be, else polar.
std::optional<RectifiedPair> rectify_pair(const Image& a, const Image& b, const Eigen::Matrix3d& F,
                                          const Matches& inliers);

/// A match of the pictures in rectified coordinates (nearest pixel whose source is there); nothing outside.
std::optional<Match> rectified(const RectifiedPair& pair, const Match& m);

}  // namespace stuv
