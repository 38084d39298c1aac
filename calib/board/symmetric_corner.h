#pragma once

#include <Eigen/Dense>
#include <opencv2/core.hpp>
#include <optional>
#include <vector>

#include "calib/board/board.h"

namespace stuv {

/// The picture of the board's plane around one of its corners, q: p(d) = q + A d + B (d1^2, d1 d2, d2^2),
/// with d in half windows along the board's axes. B holds what perspective and lens bend.
struct LocalLattice {
  Eigen::Matrix2d A;
  Eigen::Matrix<double, 2, 3> B;
};

struct SymmetricCorner {
  Eigen::Vector2d at_px;
  Eigen::Matrix2d covariance;
};

/// The luma picture that refine_by_symmetry reads: smoothed a little, so that it may be interpolated.
cv::Mat smooth_for_symmetry(const cv::Mat& luma);

/// Where two edges cross, to a part of a pixel: the point around which the picture is the same when turned by
/// half a turn in the board's plane.
///
///   q = argmin min_c sum_d w(d) (I(p(d)) - I(p(-d)) - c . d)^2,   |d1|, |d2| < 1
///
/// w falls to 0 at the window's border, c is a plane of shading. Blur, gamma and the picture's contrast keep
/// the symmetry, and so does a lens once B follows its bend, so that none of them moves q; and every pixel of
/// the edges takes part. (findChessboardCornersSB shares errors of up to 0.1 px among all views of a pose.)
///
/// Its covariance is that of weighted least squares from the residuals themselves, clustered by the window's
/// rows and columns (White, 1980; Cameron, Gelbach, Miller, 2011): what spoils the symmetry counts (dirt, a
/// hidden quarter), also where it is alike all along an edge, as the raster's errors are on edges that follow
/// it.
///
/// `smooth`: CV_32F of smooth_for_symmetry. Nothing if the point moves more than most_shift_px from `start`
/// or has no two directions of edges. Pairs of which one is outside the picture are left out.
std::optional<SymmetricCorner> refine_by_symmetry(const cv::Mat& smooth, const LocalLattice& lattice,
                                                  const Eigen::Vector2d& start, double most_shift_px);

/// All of a view's corners (Board::corners() of them, NaN where none was seen) by refine_by_symmetry, with
/// windows clear of all other edges; sigma_px: sqrt(trace(covariance) / 2). A corner without neighbours in
/// two directions, or where the search fails, stays where it is with sigma kUnrefinedPx; absent ones have
/// NaN.
std::vector<double> refine_all_by_symmetry(const cv::Mat& luma, const Board& board,
                                           std::vector<Eigen::Vector2d>& corners_px);

inline constexpr double kUnrefinedPx = 0.5;

}  // namespace stuv
