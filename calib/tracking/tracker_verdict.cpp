#include "calib/tracking/tracker_state.h"

#include <algorithm>
#include <cmath>

namespace stuv::tracking {
namespace {

/// A start is believed where the taught view's corners are found and the correlation is this, or, of objects
/// without corners, where it is higher and this part of the edge samples matches.
constexpr double kAlike = 0.45, kVeryAlike = 0.95, kSurePart = 0.5;
/// With print, a pose is not certain where most of the weight is elsewhere and not nearly all edges are
/// found.
constexpr double kPrintedRivals = 0.5, kClearPart = 0.8;
/// Without print, it is not where rivals have more than this of the weight, where its place is not known to
/// this part of the distance or its turn to 3 degrees, or where fewer of the edges are found; and what starts
/// must be seen for some frames to be believed.
constexpr double kMostRivals = 0.2, kMostSigma = 0.05, kMostTurn_rad = 0.05, kSymmetry_rad = 1,
                 kPlainPart = 0.45;
/// An object that is this much less alike up to its rim than inside is not where its outline is taken to be.
constexpr double kOtherRim = 0.2;
/// Brightness that the taught views explain less of is not the object's.
constexpr double kLeastFit = 0.6, kPlainFit = 0.9;
/// How far the distance of a start may be from the taught one, as a factor.
constexpr double kMostScale = 1.6;

}  // namespace

/// A plain object that looks alike much nearer or farther than it was taught is something else more often.
bool Tracker::State::has_taught_size(const Pose& pose) const {
  const TexturedView* view = taught.nearest_view(pose);
  if (view == nullptr) return true;
  const double part = pose.t.norm() / view->cam_from_object.t.norm();
  return part > 1 / kMostScale && part < kMostScale;
}

bool Tracker::State::is_near_last() const {
  return !good_particles.empty() && frames_lost < kKeptFrames &&
         distance_px(good_estimate, estimate, lens.focal_px()) < options.search_px * (1 + frames_lost);
}

bool Tracker::State::is_lost(const TrackedFrame& f) const {
  if (f.edges.visible < 6) return true;
  if (f.print - f.correlation > kOtherRim) return true;
  if (f.print > kSamePrint) return false;
  if (f.print < kOtherPrint) return true;
  // Plain faces are told by little else than that the background's pattern is not on them.
  const bool is_plain = std::isnan(f.print);
  if (is_plain && !taught.empty() && !has_taught_size(estimate)) return true;
  if (f.fit < (is_plain ? kPlainFit : kLeastFit)) return true;
  // A start comes from a taught view, which must then be there to compare with; but not far from where it
  // was last seen a plain face that fits is the same object still.
  const bool goes_on = is_plain && f.fit > kPlainFit && is_near_last();
  const bool must_compare = f.initialised && !taught.empty() && !goes_on;
  const double alike = std::isnan(f.likeness) ? f.correlation : f.likeness;
  if (alike < options.lost_correlation || (must_compare && std::isnan(alike))) return true;
  if (must_compare && !has_taught_size(estimate)) return true;
  return !has_enough_edges(f, must_compare, alike);
}

/// Whether enough edges are found for how alike the object looks. One that looks as taught may have edges
/// that are faint or hidden.
bool Tracker::State::has_enough_edges(const TrackedFrame& f, bool must_compare, double alike) const {
  const double matched = static_cast<double>(f.edges.matched) / f.edges.visible;
  const bool looks_right = (alike > kAlike && f.texture_points >= kLeastCorners) ||
                           (alike > kVeryAlike && (!must_compare || matched >= kSurePart));
  if (must_compare && !looks_right) return false;
  if (looks_right) return !(matched < 0.5 * options.lost_part);
  // One plain face, without contrast to compare.
  const bool fits = std::isnan(f.print) && f.fit > kVeryAlike && !(alike < kPlainFit);
  return !(matched < (fits ? (f.initialised ? kSurePart : 0.75 * options.lost_part) : options.lost_part));
}

/// Whether the estimate's standard deviations are small enough for a pose. A turn that is not known at all
/// is an object's symmetry, not an error.
bool Tracker::State::determines(const Matrix6& covariance) const {
  const double place = std::sqrt(covariance.topLeftCorner<3, 3>().trace());
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> turns(covariance.bottomRightCorner<3, 3>(),
                                                             Eigen::EigenvaluesOnly);
  const Eigen::Array3d turn = turns.eigenvalues().array().max(0).sqrt();
  return place <= kMostSigma * estimate.t.norm() && (turn <= kMostTurn_rad || turn > kSymmetry_rad).all();
}

/// Whether a pose that is followed is also to be relied on. An object without print is told from its
/// surroundings by its edges only, so there must be enough of them and nothing else that fits; and its
/// start is believed after some frames, as wrong ones seldom last.
bool Tracker::State::is_certain(const TrackedFrame& f) {
  frames_seen = lost || f.initialised ? 0 : frames_seen + 1;
  if (taught.empty()) return true;
  const double matched = static_cast<double>(f.edges.matched) / std::max(1, f.edges.visible);
  if (!std::isnan(f.print)) return f.rivals <= kPrintedRivals || matched >= kClearPart;
  return frames_seen >= kConfirmations && f.rivals <= kMostRivals && is_determined && matched >= kPlainPart;
}

/// The residuals are much larger than they have been: perhaps a local minimum that looks nearly right.
bool Tracker::State::is_doubtful(const TrackedFrame& f) const {
  return usual_deviation > 0 && f.deviation_px > std::max(0.5, 3 * usual_deviation);
}

}  // namespace stuv::tracking
