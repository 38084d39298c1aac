#pragma once

#include <Eigen/Dense>
#include <utility>
#include <vector>

#include "calib/two_view/estimate.h"
#include "calib/two_view/match.h"
#include "core/image.h"

namespace stuv {

/// One channel, 0..1 for integer pixels: 0.299 R + 0.587 G + 0.114 B.
ImageF grey(const Image& picture);

/// Interest points of one picture with a descriptor each (rows of `descriptors`).
struct Features {
  std::vector<Eigen::Vector2d> points_px;
  Raster<float> descriptors;
};

/// OpenCV's SIFT at its usual contrast threshold, the strongest `most`; descriptors as the roots of their
/// L1-normalised entries, whose Euclidean distance compares histograms better (Arandjelovic, Zisserman, CVPR
/// 2012).
Features detect_features(const Image& picture, int most = 8000);

/// Pairs of features that are each other's nearest and nearer by `ratio` than the second (Lowe, IJCV 2004);
/// as indices, and as their places.
std::vector<std::pair<int, int>> match_feature_indices(const Features& a, const Features& b,
                                                       double ratio = 0.8);
Matches match_features(const Features& a, const Features& b, double ratio = 0.8);

/// The same among the features of b within `band_px` of the epipolar line, and of a likewise: with fewer
/// rivals, a ratio that asks for less finds more.
Matches guided_matches(const Features& a, const Features& b, const Eigen::Matrix3d& F, double band_px,
                       double ratio = 0.9);

/// match_features and estimate_two_view, then guided_matches and again, until no more agree.
struct MatchedPair {
  Matches matches;
  TwoViewEstimate estimate;
};
MatchedPair match_and_estimate(const Features& a, const Features& b, const TwoViewOptions& options);

/// For small motion: Shi and Tomasi's corners, compared by normalised cross-correlation of 15 x 15 windows
/// over those within `most_motion_px`; pairs that are each other's best, above `least_ncc`; sub-pixel by a
/// parabola through the correlation at the neighbouring pixels.
Matches match_corners(const Image& a, const Image& b, double most_motion_px, double least_ncc = 0.8);

}  // namespace stuv
