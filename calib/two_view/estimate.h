#pragma once

#include <Eigen/Dense>
#include <cstdint>
#include <string>
#include <vector>

#include "calib/two_view/match.h"
#include "calib/two_view/maximum_likelihood.h"

namespace stuv {

enum class TwoViewStatus {
  ok,           ///< F is determined
  planar,       ///< a homography explains the matches, and what is off it does not fix the epipoles
  rotation,     ///< the same, and the homography is that of a camera which only turned
  undetermined  ///< too few matches agree, or they leave F free for another reason
};
const char* name_of(TwoViewStatus status);

struct TwoViewOptions {
  /// Sampson distance from which on a match is an outlier; 0: 1 % of the points' rms radius, doubled (twice
  /// at most) while the inliers' noise fills it and the agreement becomes less likely by chance.
  double threshold_px = 0;
  double confidence = 0.999999;  ///< of the search; the rest of the work costs more than its samples
  int least_samples = 1000,
      most_samples = 5000;  ///< few matches have rival agreements: the best is worth finding
  std::uint64_t seed = 1;
  /// `ok` demands that the line of a point that parallax moved by 10 % of the points' rms radius is known to
  /// this standard deviation, in units of that radius.
  double most_line_sigma = 0.006;
  bool gold_standard = true;  ///< otherwise the Sampson estimate is final
};

struct TwoViewEstimate {
  TwoViewStatus status = TwoViewStatus::undetermined;
  std::string reason;        ///< why not ok, one line
  FundamentalMl ml;          ///< of the inliers; meaningful if ok
  std::vector<bool> inlier;  ///< one per match given; repeated matches follow the first
  int inliers = 0, distinct = 0;
  double sampson_rms_px = 0;                    ///< of the inliers
  Eigen::Matrix3d H = Eigen::Matrix3d::Zero();  ///< the dominant homography, zero if there is none
  bool plane_preferred = false;                 ///< GRIC: a homography describes F's inliers better than F
  int on_plane = 0;                             ///< inliers of it
  double line_sigma_px = 0;                     ///< what most_line_sigma bounds
  int samples = 0;
};

/// F from matches, robust and to maximum likelihood, or a reason why there is none:
///   1. distinct_matches; RANSAC, several times; the dominant plane, and the epipole from what is off it
///      (plane_and_parallax)
///   2. of all these the likeliest, its noise and which matches are right estimated with it
///      (fit_noise_and_shape); Gold Standard with those weights
///   3. model selection: by GRIC between H and F (Torr, ICPR 1998): rho(r^2) + n d log 4 + k log 4n; number
///      of false alarms of the agreement (Moisan, Stival, IJCV 2004), of F and of the epipole given the
///      plane; and how well the covariance says that lines off the points' plane or curve are known.
/// Same matches, options and seed: same bits, for any order of the matches and any number of threads.
TwoViewEstimate estimate_two_view(const Matches& matches, const TwoViewOptions& options = {});

}  // namespace stuv
