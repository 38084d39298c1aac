#pragma once

#include <vector>

#include "calib/tracking/edge_search.h"
#include "calib/tracking/lens.h"
#include "calib/tracking/se3.h"
#include "calib/tracking/visible_edges.h"

namespace stuv::tracking {

/// A point on a visible model edge, where it is seen, and the picture edges found along its normal.
struct EdgeSample {
  Eigen::Vector3d x;     ///< in the object's frame
  Eigen::Vector2d p, n;  ///< its pixel; unit normal of the projected edge
  EdgeHypotheses found;
};

/// Points along the visible edges, `spacing_px` apart in the picture, that lie inside it.
std::vector<EdgeSample> sample_edges(const ObjectModel& model, const Lens& lens, const Pose& cam_from_object,
                                     double spacing_px, double slack);

/// Fills `found` of every sample: see search_edges.
void match_edges(const GradientPicture& picture, double range_px, double least_cosine,
                 std::vector<EdgeSample>& samples);

struct LikelihoodOptions {
  double lambda_v = 25;  ///< on the part of the visible samples without a match
  double lambda_e = 1;   ///< [1/px] on the mean distance of the matched
};

/// p_v visible and p_m matched samples, and the mean distance e of the matched to their nearest picture edge.
struct MatchSummary {
  int visible = 0, matched = 0;
  double mean_distance_px = 0;
};
MatchSummary summarise(const std::vector<EdgeSample>& samples);

/// Equations 7 and 8 of Choi and Christensen, as a logarithm: -lambda_v (p_v - p_m) / p_v - lambda_e e.
/// Without a match e is `range_px`, the worst there is; nothing visible is the same as nothing matched.
double log_likelihood(const MatchSummary& matches, double range_px, const LikelihoodOptions& options);

/// A point of the object that was found in the picture.
struct PointMatch {
  Eigen::Vector3d x;
  Eigen::Vector2d q;
  double weight = 1;
};

struct RefineOptions {
  enum class Weights {
    reciprocal,  ///< 1 / (c + |e|), equation 10
    tukey        ///< biweight that ends at 4.7 robust deviations (of edges, of points), but not within c
  };
  Weights weights = Weights::reciprocal;
  double c_px = 1;
  int iterations = 4;
};

/// What is known of the pose besides edges and points: mu of X exp(mu), X = `cam_from_object`, has this
/// information, in units of an edge's [1/px^2]. All 0: nothing.
struct PosePrior {
  Pose cam_from_object;
  Matrix6 information = Matrix6::Zero();
};

struct Refined {
  Pose cam_from_object;
  Matrix6 information = Matrix6::Zero();  ///< J^T W J, weights at most 1 [1/px^2]
  double deviation_px = 0;  ///< robust (1.48 times the median) deviation: the larger of edges' and points'
  int residuals = 0;
};

/// Equations 9 and 10: iteratively reweighted least squares on X exp(mu), mu = (J^T W J)^-1 J^T W e.
///
/// e: distance along the sample's normal from the projected point to its nearest hypothesis, chosen again in
/// every step; for point matches, both components. Directions that the data leave free are not moved (a
/// damping of 1e-6 of the largest diagonal element). Units of the twist: those of the pose. With fewer than 3
/// residuals the pose is returned as it was.
Refined refine(const std::vector<EdgeSample>& samples, const std::vector<PointMatch>& points,
               const Lens& lens, const Pose& cam_from_object, const RefineOptions& options,
               const PosePrior& prior = {});

}  // namespace stuv::tracking
