#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "calib/tracking/keyframes.h"
#include "calib/tracking/object_units.h"
#include "calib/tracking/surface_view.h"
#include "calib/tracking/texture.h"

namespace stuv::tracking {

/// Hidden-line removal: how far behind a face a point must lie, in radii of the object.
inline constexpr double kSlack = 2e-3;
/// Texture: corners looked for, and how many must be found to trust their pose.
inline constexpr int kMostCorners = 60, kLeastCorners = 6;
/// Points of a taught view for direct alignment, and those that suffice to weigh a particle.
inline constexpr int kSurfacePoints = 1200, kFewPoints = 160;
/// Independent pixels that brightness counts as in the likelihood of a particle, before and after refinement,
/// and the part of the variance that is never explained.
inline constexpr double kGlancedAt = 6, kLookedAt = 40, kLeastMisfit = 0.05;

/// Likelihood of a fit of brightness (surface_view.h): residuals of `count` independent pixels whose
/// unknown variance is that of the residuals, -count / 2 log(1 - fit).
inline double log_looks(double fit, double count) {
  return -0.5 * count * std::log(kLeastMisfit + 1 - std::clamp(fit, 0.0, 1.0));
}

/// A pose, and how much the picture there looks like a taught view.
struct Place {
  Pose pose;
  double looks = 0;
};

/// The object as the taught views show it, to compare a frame with. Its radius is the unit of length.
class TaughtViews {
 public:
  /// None: nothing is known of how the object looks. `model` and `lens` must outlive it.
  TaughtViews(const ObjectModel& model, const Lens& lens) : model_(model), lens_(lens) {}
  void teach(const std::vector<Keyframe>& keyframes);
  bool empty() const { return views_.empty(); }
  const std::vector<TexturedView>& views() const { return views_; }
  const ImageF& rays() const { return rays_; }

  /// What `likeness_at`, `looks`, `aligned` and `best_places` look at from now on.
  void look_at(const Grey& frame) { smooth_pyramid(frame, pyramid_); }
  /// From now on all poses are compared with the views near this one, or each with those nearest to itself.
  void compare_near(const Pose& pose) { compared_ = surfaces_near(pose); }
  void compare_nearest() { compared_.clear(); }
  bool compares() const { return !compared_.empty(); }

  /// The taught view whose direction is nearest to the pose's.
  const TexturedView* nearest_view(const Pose& pose) const;
  std::vector<PointMatch> texture_matches(const Grey& frame, const Pose& pose) const;
  /// Correlation of the frame with the nearest taught view; NaN if there is none near enough: from far beside
  /// it light and hidden detail change too much to judge by.
  double correlation_at(const Grey& frame, const Pose& pose) const;
  /// A pose from texture alone, from a pose near it, and the points followed, none if they are too few.
  std::optional<Pose> texture_pose(const Grey& frame, const Pose& predicted,
                                   std::vector<PointMatch>& points) const;

  /// Mean over the views that can be compared; NaN: none can.
  Likeness likeness_at(const Pose& pose, int level, int points) const;
  /// Likeness to the taught views by a few points, 0 where it is not known.
  double looks(const Pose& pose, int level) const;
  /// See align: from level `from` down to `to`.
  Alignment aligned(const Pose& pose, int from, int to) const;
  /// The places that look most like a taught view, aligned with it, most alike first.
  std::vector<Place> best_places(const std::vector<Pose>& poses, int most) const;

 private:
  /// The taught views to compare with at a pose: the nearest two.
  std::vector<const SurfaceView*> surfaces_near(const Pose& pose) const;
  std::vector<const SurfaceView*> surfaces_for(const Pose& pose) const;

  const ObjectModel& model_;
  const Lens& lens_;
  ImageF rays_;
  std::vector<TexturedView> views_;
  std::vector<SurfaceView> surfaces_;         ///< of the views, in their order
  std::vector<const SurfaceView*> compared_;  ///< what all poses are compared with; none: the nearest
  SmoothPyramid pyramid_;                     ///< of the frame
};

}  // namespace stuv::tracking
