#include "calib/tracking/tracker_state.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace stuv::tracking {
namespace {

/// Residuals along one edge go wrong together, so this many count as much as one coordinate of a point.
constexpr double kPointWeight = 10;
/// Least error of a model's edge in a picture, whatever the residuals say.
constexpr double kModelError_px = 0.6;
/// Likeness from which alignment's answer is used.
constexpr double kLikeEnough = 0.6;
/// A pose that moves the outline by this many search ranges between two frames is a slip, not a motion.
constexpr double kMostJump = 5;

}  // namespace

/// What brightness says of the pose.
PosePrior Tracker::State::prior_by_looks(const Pose& pose, const MatchSummary& edges) const {
  const Alignment better = taught.aligned(pose, 1, 0);
  // Plain faces pull the pose inwards, away from the background, and nothing pulls it out.
  if (!better.converged ||
      !(taught.likeness_at(better.cam_from_object, 1, kSurfacePoints).print > kLikeEnough))
    return {};
  // Where most edges are found they tell the pose better; else many of those found may be clutter's. Whether
  // they are a grid's, the likeness says.
  const double missing = double(edges.visible - edges.matched) / std::max(1, edges.matched);
  const double trust = std::min(2.0, missing);
  return {better.cam_from_object,
          trust * kPointWeight * kModelError_px * kModelError_px * better.information};
}

Refined Tracker::State::polish(const Grey& frame, Pose pose, TrackedFrame& out) const {
  RefineOptions how;
  how.weights = RefineOptions::Weights::tukey;
  how.iterations = options.polish ? 5 : 0;
  Refined r;
  std::vector<PointMatch> points;
  PosePrior by_looks;
  double looked = taught.looks(pose, 0);
  for (const double range : {6.0, 3.0, 3.0}) {
    const std::vector<EdgeSample> samples = edges_at(pose, options.spacing_px / 2, range);
    // Matches stay true as the pose moves on: they are places in the picture and on the object.
    if (options.texture && range < 6 && points.empty()) points = taught.texture_matches(frame, pose);
    if (options.texture && range == 6) by_looks = prior_by_looks(pose, summarise(samples));
    for (PointMatch& p : points) p.weight = kPointWeight;
    how.c_px = range / 2;
    r = refine(samples, points, lens, pose, how, by_looks);
    // Clutter's edges may lead away from a place that looks right.
    const double looks_now = taught.looks(r.cam_from_object, 0);
    if (looks_now < looked - kWorse) r.cam_from_object = pose;
    looked = std::max(looked, looks_now);
    pose = r.cam_from_object;
  }
  out.texture_points = static_cast<int>(points.size());
  describe(frame, pose, out);
  return r;
}

/// What the picture shows at the pose: the verdict's evidence.
void Tracker::State::describe(const Grey& frame, const Pose& pose, TrackedFrame& out) const {
  out.edges = summarise(edges_at(pose, options.spacing_px / 2, options.lost_px));
  out.correlation = taught.correlation_at(frame, pose);
  if (taught.empty()) return;
  const Likeness l = taught.likeness_at(pose, 0, kSurfacePoints);
  out.print = l.print;
  out.fit = l.fit;
  out.likeness = l.whole;
}

/// Noise times the inverse of the information, with a prior of an object's size and of pi, so that what the
/// picture does not say is reported as not known.
Matrix6 Tracker::State::covariance_of(const Refined& r) const {
  const double noise = std::max(kModelError_px, r.deviation_px), pi = std::numbers::pi;
  Twist prior;
  prior << 1, 1, 1, 1 / (pi * pi), 1 / (pi * pi), 1 / (pi * pi);
  Matrix6 information = r.information / (kPointWeight * noise * noise);
  information += prior.asDiagonal();
  return information.inverse();
}

void Tracker::State::estimate_pose(const Grey& frame, TrackedFrame& out) {
  if (options.filter) {
    const StageClock clock(out.seconds.filter);
    run_filter(frame, out);
  }
  const StageClock clock(out.seconds.estimate);
  const Pose last = estimate;
  const bool was_tracked = known && !lost && !out.initialised;
  const Refined r = polish(frame, estimate_now, out);
  drift =
      known && !out.initialised ? velocity(options.autoregression, last, r.cam_from_object) : Twist::Zero();
  estimate = r.cam_from_object;
  known = out.has_pose = true;
  out.deviation_px = r.deviation_px;
  const Matrix6 covariance = covariance_of(r);
  is_determined = determines(covariance);
  out.covariance = norm.covariance_back(covariance);
  out.cam_from_object = norm.back(estimate);
  lost = is_lost(out) ||
         (was_tracked && distance_px(last, estimate, lens.focal_px()) > kMostJump * options.search_px);
}

}  // namespace stuv::tracking
