#include "calib/tracking/taught_views.h"

#include <algorithm>
#include <limits>

#include "core/parallel.h"

namespace stuv::tracking {
namespace {

/// Cosine between viewing directions up to which a taught view must look like the frame (25 degrees).
constexpr double kComparable = 0.906;
/// How far alignment may lead from where it starts, as movement of the outline (standard deviation).
constexpr double kSpread_px = 30;
/// Places nearer than this are the same.
constexpr double kSamePlace_px = 5;
/// Cosine between viewing directions up to which a second view is compared with (50 degrees).
constexpr double kSecondView = 0.64;
/// Differences of likeness that say nothing.
constexpr double kNoDifference = 0.02;

}  // namespace

void TaughtViews::teach(const std::vector<Keyframe>& keyframes) {
  if (keyframes.empty()) return;
  rays_ = rays_of(lens_.camera());
  for (const Keyframe& k : keyframes) {
    views_.push_back(
        {k.picture, k.cam_from_object, render_depth(model_, lens_, rays_, k.cam_from_object, kSlack)});
    surfaces_.push_back(surface_view(views_.back(), model_, rays_, kSurfacePoints));
  }
  if (std::all_of(surfaces_.begin(), surfaces_.end(), is_plain))
    for (SurfaceView& s : surfaces_) add_unseen_faces(model_, s);
}

const TexturedView* TaughtViews::nearest_view(const Pose& pose) const {
  const TexturedView* best = nullptr;
  double most = 0.3;  // beyond about 70 degrees there is nothing to compare
  for (const TexturedView& view : views_) {
    const double cosine = view.cam_from_object.centre().normalized().dot(pose.centre().normalized());
    if (cosine > most) most = cosine, best = &view;
  }
  return best;
}

std::vector<PointMatch> TaughtViews::texture_matches(const Grey& frame, const Pose& pose) const {
  const TexturedView* view = nearest_view(pose);
  if (view == nullptr || !(pose.t.z() > 1)) return {};
  const WarpedView warped = warp_view(*view, model_, lens_, rays_, pose, kSlack);
  if (warped.picture.empty()) return {};
  return follow_texture(warped, frame, rays_, pose, kMostCorners);
}

double TaughtViews::correlation_at(const Grey& frame, const Pose& pose) const {
  const TexturedView* view = nearest_view(pose);
  const bool comparable =
      view != nullptr && pose.t.z() > 1 &&
      view->cam_from_object.centre().normalized().dot(pose.centre().normalized()) > kComparable;
  if (!comparable) return std::numeric_limits<double>::quiet_NaN();
  // Every second row and column of a large object say as much.
  const int stride = lens_.focal_px() > 60 * pose.t.z() ? 2 : 1;
  return correlation(warp_view(*view, model_, lens_, rays_, pose, kSlack, stride), frame);
}

std::optional<Pose> TaughtViews::texture_pose(const Grey& frame, const Pose& predicted,
                                              std::vector<PointMatch>& points) const {
  points = texture_matches(frame, predicted);
  if (static_cast<int>(points.size()) < kLeastCorners) {
    points.clear();
    return {};
  }
  RefineOptions how;
  how.weights = RefineOptions::Weights::tukey;
  how.c_px = 2;
  how.iterations = 8;
  const Refined r = refine({}, points, lens_, predicted, how);
  if (r.deviation_px > 2) return {};
  return r.cam_from_object;
}

std::vector<const SurfaceView*> TaughtViews::surfaces_near(const Pose& pose) const {
  const TexturedView* nearest = nearest_view(pose);
  if (nearest == nullptr) return {};
  std::vector<const SurfaceView*> near = {&surfaces_[nearest - views_.data()]};
  const SurfaceView* second = nullptr;
  double most = kSecondView;
  for (const SurfaceView& s : surfaces_) {
    const double cosine = s.cam_from_object.centre().normalized().dot(pose.centre().normalized());
    if (&s != near[0] && cosine > most) most = cosine, second = &s;
  }
  if (second != nullptr) near.push_back(second);
  return near;
}

std::vector<const SurfaceView*> TaughtViews::surfaces_for(const Pose& pose) const {
  return compared_.empty() ? surfaces_near(pose) : compared_;
}

Likeness TaughtViews::likeness_at(const Pose& pose, int level, int points) const {
  Likeness sum;
  int fits = 0, wholes = 0, prints = 0;
  const std::vector<const SurfaceView*> near = surfaces_for(pose);
  for (const SurfaceView* s : near) {
    const Likeness l = likeness(*s, pyramid_, level, lens_, pose, points / static_cast<int>(near.size()));
    if (!std::isnan(l.fit)) sum.fit += l.fit, ++fits;
    if (!std::isnan(l.whole)) sum.whole += l.whole, ++wholes;
    if (!std::isnan(l.print)) sum.print += l.print, ++prints;
  }
  return {sum.fit / fits, sum.whole / wholes, sum.print / prints};
}

double TaughtViews::looks(const Pose& pose, int level) const {
  if (surfaces_.empty()) return 0;
  const double fit = likeness_at(pose, level, kFewPoints).fit;
  return std::isnan(fit) ? 0 : fit;
}

Alignment TaughtViews::aligned(const Pose& pose, int from, int to) const {
  const std::vector<const SurfaceView*> near = surfaces_for(pose);
  if (near.empty()) return {};
  return align(near, pyramid_, from, lens_, pose, one_pixel(pose.t.z(), lens_.focal_px()) * kSpread_px, to);
}

std::vector<Place> TaughtViews::best_places(const std::vector<Pose>& poses, int most) const {
  std::vector<Place> places(poses.size());
  parallel_for(static_cast<int>(poses.size()), [&](int i) {
    places[i] = {poses[i], poses[i].t.z() > 1 ? looks(poses[i], 2) : 0};
  });
  // Smaller differences say nothing; then the places given first are the better ones.
  const auto more_alike = [](const Place& a, const Place& b) {
    return std::floor(a.looks / kNoDifference) > std::floor(b.looks / kNoDifference);
  };
  std::stable_sort(places.begin(), places.end(), more_alike);
  std::vector<Place> chosen;
  for (const Place& p : places) {
    if (static_cast<int>(chosen.size()) == most || !(p.looks > 0)) break;
    if (std::none_of(chosen.begin(), chosen.end(), [&](const Place& c) {
          return distance_px(c.pose, p.pose, lens_.focal_px()) < kSamePlace_px;
        }))
      chosen.push_back(p);
  }
  parallel_for(static_cast<int>(chosen.size()), [&](int i) {
    Place& place = chosen[i];
    place.looks = looks(place.pose, 1);
    // Not to the finest level: edges refine what starts here.
    const Alignment better = aligned(place.pose, 2, 1);
    const double looks_then = better.converged ? looks(better.cam_from_object, 1) : 0;
    if (looks_then > place.looks + kNoDifference) place = {better.cam_from_object, looks_then};
  });
  std::stable_sort(chosen.begin(), chosen.end(), more_alike);
  return chosen;
}

}  // namespace stuv::tracking
