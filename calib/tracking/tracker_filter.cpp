#include "calib/tracking/tracker_state.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <set>

#include "core/parallel.h"

namespace stuv::tracking {
namespace {

/// Places that are aligned while tracking.
constexpr int kFollowed = 3;
/// Particles that are less likely than the best by this factor are not worth refining.
constexpr double kNegligibleLog = -12;
/// Particles nearer than this are of one mode. Neighbouring samples of an edge of which one goes wrong alike.
constexpr double kOneMode_px = 6, kSamplesAlike = 4;

}  // namespace

double Tracker::State::gaussian() { return std::normal_distribution<double>()(random); }

Twist Tracker::State::noise_at(const Pose& pose, double noise_px) {
  Twist n = one_pixel(pose.t.z(), lens.focal_px()) * noise_px;
  for (int i = 0; i < 6; ++i) n[i] *= gaussian();
  return in_object(pose, n);
}

/// The states of the frame before, moved by equation 3. `before` keeps X_{t-1} for equation 4.
void Tracker::State::move_particles() {
  before.clear();
  for (Particle& p : particles) {
    before.push_back(p.pose);
    p.pose = propagate(p, noise_at(p.pose, options.noise_px));
  }
}

/// Texture, from where the motion so far leads.
void Tracker::State::follow_motion(const Grey& frame) {
  texture_points.clear();
  texture_found.reset();
  if (particles.empty() || lost || !options.filter || !options.texture || taught.empty()) return;
  texture_found = taught.texture_pose(frame, estimate * exp(drift), texture_points);
}

/// A tenth of the particles come from the poses that look most like a taught view near the predicted ones.
void Tracker::State::propose_by_looks() {
  const Pose predicted = estimate * exp(drift);
  taught.compare_near(predicted);
  std::vector<Particle> proposed;
  if (taught.compares()) {
    std::vector<Pose> poses = {predicted, estimate};
    if (texture_found) poses.push_back(*texture_found);
    for (const Particle& p : particles) poses.push_back(p.pose);
    proposed = particles_around(taught.best_places(poses, kFollowed),
                                std::max(1, static_cast<int>(particles.size() / 10)));
  }
  if (texture_found) proposed.push_back({*texture_found, Twist::Zero(), 0});
  if (!proposed.empty()) proposed.push_back({predicted, Twist::Zero(), 0});
  for (std::size_t i = 0; i < std::min(proposed.size(), particles.size()); ++i)
    particles[i].pose = proposed[i].pose;
}

/// Particles around places, as many of each as they are alike.
std::vector<Particle> Tracker::State::particles_around(const std::vector<Place>& places, int count) {
  std::vector<Particle> candidates;
  for (const Place& place : places) {
    Particle p;
    p.pose = place.pose;
    p.log_weight = log_looks(place.looks, kLookedAt);
    candidates.push_back(p);
  }
  std::vector<Particle> out = resample(candidates, normalised_weights(candidates), count, 0.5);
  for (std::size_t i = 0; i < out.size(); ++i)
    if (i > 0 && distance_px(out[i].pose, out[i - 1].pose, lens.focal_px()) < 1e-3)
      out[i].pose = out[i].pose * exp(noise_at(out[i].pose, 1));
  return out;
}

/// The visible edges at a pose, and what the picture has within `range` pixels of them.
std::vector<EdgeSample> Tracker::State::edges_at(const Pose& pose, double spacing_px, double range) const {
  std::vector<EdgeSample> samples = sample_edges(model, lens, pose, spacing_px, kSlack);
  match_edges(gradient, range, options.least_cosine, samples);
  return samples;
}

void Tracker::State::measure(const Pose& pose, double range, double pixels, Measured& out) const {
  out.samples = edges_at(pose, options.spacing_px, range);
  out.looks = taught.looks(pose, 0);
  out.log_weight = log_likelihood(summarise(out.samples), range, options.likelihood) +
                   texture_likelihood(pose) + log_looks(out.looks, pixels);
}

/// Equation 5 for the texture's points: -lambda_c (c - c_i) / c.
double Tracker::State::texture_likelihood(const Pose& pose) const {
  if (texture_points.empty()) return 0;
  int inliers = 0;
  for (const PointMatch& m : texture_points) {
    Eigen::Vector2d q;
    inliers += lens.project(pose * m.x, q) && (q - m.q).norm() < HypothesisOptions{}.inlier_px ? 1 : 0;
  }
  return -HypothesisOptions{}.lambda_c * (1 - inliers / static_cast<double>(texture_points.size()));
}

void Tracker::State::refine_one(const Pose& pose, Measured& m) const {
  RefineOptions how;
  how.iterations = options.refine_iterations;
  const auto refine_from = [&](const Pose& from) {
    m.refined = refine(m.samples, texture_points, lens, from, how).cam_from_object;
  };
  const double near_px = std::max(3.0, options.search_px / 4), weight = m.log_weight, looked = m.looks;
  refine_from(pose);
  m.samples = edges_at(m.refined, options.spacing_px, near_px);
  refine_from(m.refined);
  if (!options.reweigh) return void(m.log_weight = weight);
  measure(m.refined, near_px, kLookedAt, m);
  // Clutter's edges may lead away from a place that looks right: then only near ones, or none.
  if (m.looks >= looked - kWorse) return;
  measure(pose, near_px, kLookedAt, m);
  const Measured unmoved = m;
  refine_from(pose);
  measure(m.refined, near_px, kLookedAt, m);
  if (m.log_weight >= unmoved.log_weight) return;
  m = unmoved;
  m.refined = pose;
}

/// Weights (7, 8), refinement (9, 10) of the particles that matter, weights again.
void Tracker::State::weigh_particles() {
  std::vector<Measured> measured(particles.size());
  const int count = static_cast<int>(particles.size());
  parallel_for(count, [&](int i) { measure(particles[i].pose, options.search_px, kGlancedAt, measured[i]); });
  double best = -std::numeric_limits<double>::infinity();
  for (const Measured& m : measured) best = std::max(best, m.log_weight);
  parallel_for(count, [&](int i) {
    Measured& m = measured[i];
    m.refined = particles[i].pose;
    if (options.refine_iterations <= 0) return;
    if (m.log_weight < best + kNegligibleLog)
      m.log_weight = -std::numeric_limits<double>::infinity();
    else
      refine_one(particles[i].pose, m);
  });
  for (int i = 0; i < count; ++i) {
    particles[i].pose = measured[i].refined;
    particles[i].log_weight = measured[i].log_weight;
  }
}

bool Tracker::State::is_same_mode(const Pose& a, const Pose& b) const {
  return distance_px(a, b, lens.focal_px()) <= kOneMode_px;
}

/// The mean of the particles around the most likely one (a mean over several modes lies in none).
Pose Tracker::State::mean_pose(const std::vector<double>& weights) const {
  const std::size_t best = std::max_element(weights.begin(), weights.end()) - weights.begin();
  std::vector<Pose> poses;
  std::vector<double> w;
  for (std::size_t i = 0; i < particles.size(); ++i) {
    if (weights[i] <= 0 || !is_same_mode(particles[best].pose, particles[i].pose)) continue;
    poses.push_back(particles[i].pose);
    w.push_back(weights[i]);
  }
  return mean(poses, w);
}

/// Part of the weight that is not around the most likely particle, if one judges less sharply: the weights
/// take neighbouring samples for independent, which in clutter they are not.
double Tracker::State::rival_weight() const {
  const auto& best = *std::max_element(particles.begin(), particles.end(), [](const auto& a, const auto& b) {
    return a.log_weight < b.log_weight;
  });
  double all = 0, elsewhere = 0;
  for (const Particle& p : particles) {
    const double w = std::exp((p.log_weight - best.log_weight) / kSamplesAlike);
    all += w;
    if (!is_same_mode(best.pose, p.pose)) elsewhere += w;
  }
  return elsewhere / all;
}

int Tracker::State::wanted_particles(const std::vector<double>& weights) const {
  if (!options.adaptive) return options.particles;
  const std::size_t best = std::max_element(weights.begin(), weights.end()) - weights.begin();
  const Pose origin = particles[best].pose;
  const Twist cell = 2 * one_pixel(origin.t.z(), lens.focal_px());
  std::set<std::array<int, 6>> bins;
  for (std::size_t i = 0; i < particles.size(); ++i) {
    if (weights[i] * static_cast<double>(particles.size()) < 0.1) continue;
    const Twist d = log(origin.inverse() * particles[i].pose);
    Twist cam;
    cam << origin.R * d.head<3>(), origin.R * d.tail<3>();
    std::array<int, 6> bin;
    for (int k = 0; k < 6; ++k)
      bin[k] = static_cast<int>(std::lround(std::clamp(cam[k] / cell[k], -1e6, 1e6)));
    bins.insert(bin);
  }
  return static_cast<int>(std::clamp(particles_for(static_cast<int>(bins.size())), options.particles / 4.0,
                                     double(options.particles)));
}

/// Few particles may have all the weight because one of them is right.
bool Tracker::State::is_sure(const std::vector<double>& weights) const {
  if (taught.empty()) return false;
  const auto best = std::max_element(weights.begin(), weights.end()) - weights.begin();
  const Likeness l = taught.likeness_at(particles[best].pose, 1, kSurfacePoints);
  return (std::isnan(l.print) ? l.fit : l.print) > kSamePrint;
}

void Tracker::State::run_filter(const Grey& frame, TrackedFrame& out) {
  weigh_particles();
  std::vector<double> weights = normalised_weights(particles);
  out.n_eff = effective_number(weights);
  std::vector<Particle> fresh;
  if (!out.initialised && out.n_eff < options.effective_part * static_cast<double>(particles.size()) &&
      !is_sure(weights)) {
    const StageClock clock(out.seconds.keypoints);
    if (particles_from_keypoints(frame, options.particles / 2, fresh)) {
      const Particle best = particles[std::max_element(weights.begin(), weights.end()) - weights.begin()];
      fresh.push_back(best);
      restart(std::move(fresh));
      taught.compare_nearest();
      weigh_particles();
      weights = normalised_weights(particles);
      out.initialised = true;
    }
  }
  estimate_now = mean_pose(weights);
  out.rivals = rival_weight();
  for (std::size_t i = 0; i < particles.size(); ++i)
    particles[i].velocity = out.initialised ? Twist(Twist::Zero())
                                            : velocity(options.autoregression, before[i], particles[i].pose);
  const int wanted = wanted_particles(weights);
  out.particles = static_cast<int>(particles.size());
  particles = resample(particles, weights, wanted, std::uniform_real_distribution<double>()(random));
}

}  // namespace stuv::tracking
