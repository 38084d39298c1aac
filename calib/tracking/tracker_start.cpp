#include "calib/tracking/tracker_state.h"

#include <algorithm>

#include "calib/tracking/view_search.h"
#include "core/parallel.h"

namespace stuv::tracking {
namespace {

/// Places that look like a taught view, where keypoints do not say where the object is: how many are tried,
/// and how much more likely a better correlation makes one.
constexpr int kViewPlaces = 8;
constexpr double kViewLikelihood = 20;
/// Keypoint poses drawn for each particle that starts from one: minimal sets often hold a wrong match.
constexpr int kHypothesesPerParticle = 6;
/// Places that are aligned at a start.
constexpr int kStarted = 12;

}  // namespace

/// Particles from keypoint matches, drawn by their weights (equation 6); false without enough matches.
bool Tracker::State::particles_from_keypoints(const Grey& frame, int count, std::vector<Particle>& out) {
  if (matches_frame != frame_number) matches = matcher.match(frame);
  matches_frame = frame_number;
  HypothesisOptions wanted;
  wanted.count = kHypothesesPerParticle * count;
  const std::vector<Hypothesis> drawn = draw_hypotheses(matches, lens, random(), wanted);
  if (drawn.empty()) return false;
  follow_keypoints(drawn);
  std::vector<Particle> candidates;
  for (const Hypothesis& h : drawn) {
    Particle p;
    p.pose = h.cam_from_object;
    p.log_weight = h.log_weight;
    candidates.push_back(p);
  }
  out = resample(candidates, normalised_weights(candidates), count, 0.5);
  // Equal copies would stay equal.
  for (Particle& p : out) p.pose = p.pose * exp(noise_at(p.pose, 0.5 * options.noise_px));
  return true;
}

/// The matches that fit the best of the hypotheses are points that were found in the picture.
void Tracker::State::follow_keypoints(const std::vector<Hypothesis>& drawn) {
  const Hypothesis& best = *std::max_element(
      drawn.begin(), drawn.end(), [](const auto& a, const auto& b) { return a.log_weight < b.log_weight; });
  std::vector<PointMatch> points;
  for (const KeypointMatch& m : matches) {
    Eigen::Vector2d q;
    if (lens.project(best.cam_from_object * m.point.x, q) &&
        (q - m.point.q).norm() < HypothesisOptions{}.inlier_px)
      points.push_back(m.point);
  }
  if (static_cast<int>(points.size()) >= kLeastCorners) texture_points = points;
}

/// Particles from places that look like a taught view, for objects without enough keypoints: each place is
/// first improved by following its texture, and counts by how it looks then.
bool Tracker::State::particles_from_views(const Grey& frame, int count, std::vector<Particle>& out) {
  std::vector<ViewMatch> places = search_views(taught.views(), frame, taught.rays(), kViewPlaces);
  if (places.empty()) return false;
  std::vector<std::vector<PointMatch>> followed(places.size());
  parallel_for(static_cast<int>(places.size()), [&](int i) {
    ViewMatch& m = places[i];
    if (const auto better = taught.texture_pose(frame, m.cam_from_object, followed[i])) {
      const double correlation = taught.correlation_at(frame, *better);
      if (correlation > m.correlation) return void(m = {*better, correlation});
    }
    followed[i].clear();
  });
  std::vector<Particle> candidates;
  std::size_t best = 0;
  for (std::size_t i = 0; i < places.size(); ++i) {
    Particle p;
    p.pose = places[i].cam_from_object;
    p.log_weight = kViewLikelihood * places[i].correlation;
    candidates.push_back(p);
    if (places[i].correlation > places[best].correlation) best = i;
  }
  if (!followed[best].empty()) texture_points = followed[best];
  out = resample(candidates, normalised_weights(candidates), count, 0.5);
  // A place that was not improved is known to a pixel of a small picture, its turn and size as coarsely.
  const double noise_px = (followed[best].empty() ? 2 : 0.5) * options.noise_px;
  for (Particle& p : out) p.pose = p.pose * exp(noise_at(p.pose, noise_px));
  return true;
}

/// Fills `particles`; false if there is nothing to start from.
bool Tracker::State::predict(const Grey& frame, bool by_views, TrackedFrame& out) {
  if (!particles.empty() && !lost) {
    move_particles();
    propose_by_looks();
    return true;
  }
  taught.compare_nearest();
  texture_points.clear();
  const StageClock clock(out.seconds.keypoints);
  std::vector<Particle> fresh;
  if (by_views || !particles_from_keypoints(frame, options.particles, fresh))
    particles_from_views(frame, options.particles, fresh);
  std::vector<Particle> all = starting_particles(fresh);
  if (all.empty()) return false;
  restart(std::move(all));
  out.initialised = true;
  return true;
}

/// A half by looks, the other from what was found and what was known; none if there is nothing of these.
std::vector<Particle> Tracker::State::starting_particles(const std::vector<Particle>& fresh) {
  const std::vector<Particle> kept = scattered_particles();
  std::vector<Pose> poses;
  for (const Particle& p : fresh) poses.push_back(p.pose);
  for (const Particle& p : kept) poses.push_back(p.pose);
  for (const TexturedView& v : taught.views()) poses.push_back(v.cam_from_object);
  const std::vector<Particle> alike =
      particles_around(taught.best_places(poses, kStarted), (options.particles + 1) / 2);
  std::vector<Particle> all = alike;
  const std::size_t rest = static_cast<std::size_t>(options.particles) - all.size();
  const std::size_t of_kept = fresh.empty() ? rest : rest / 2;
  all.insert(all.end(), kept.begin(), kept.begin() + std::ptrdiff_t(std::min(of_kept, kept.size())));
  for (std::size_t i = 0; i < fresh.size() && all.size() < static_cast<std::size_t>(options.particles); ++i)
    all.push_back(fresh[i]);
  return all;
}

/// The states when the object was last seen, the more scattered the longer that is ago.
std::vector<Particle> Tracker::State::scattered_particles() {
  if (frames_lost >= kKeptFrames) return {};
  std::vector<Particle> kept = good_particles;
  const double most_px = options.noise_px * (2 + frames_lost);
  // Most losses are short slips: some stay near.
  for (std::size_t i = 0; i < kept.size(); ++i)
    kept[i].pose =
        i == 0 ? good_estimate : kept[i].pose * exp(noise_at(kept[i].pose, most_px / double(1 << (i % 3))));
  return kept;
}

void Tracker::State::restart(std::vector<Particle> fresh) {
  particles = std::move(fresh);
  before.clear();
  for (const Particle& p : particles) before.push_back(p.pose);
  drift.setZero();
  // A start has no velocity, which is not the same as one of 0.
  for (Particle& p : particles) p.velocity.setZero();
}

/// Without the filter: IRLS from the last pose, the method that the paper compares with.
bool Tracker::State::predict_alone(const Grey& frame, TrackedFrame& out) {
  if (known && !lost) {
    Measured m;
    measure(estimate, options.search_px, kGlancedAt, m);
    refine_one(estimate, m);
    estimate_now = m.refined;
    return true;
  }
  std::vector<Particle> fresh;
  if (!particles_from_keypoints(frame, options.particles, fresh))
    return known && (estimate_now = estimate, true);
  out.initialised = true;
  estimate_now = fresh.front().pose;
  return true;
}

}  // namespace stuv::tracking
