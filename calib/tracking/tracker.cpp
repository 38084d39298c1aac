#include "calib/tracking/tracker.h"

#include <fmt/format.h>

#include <tbb/parallel_invoke.h>
#include <tbb/task_arena.h>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <random>
#include <set>

#include "calib/tracking/surface_view.h"
#include "calib/tracking/texture.h"
#include "calib/tracking/view_search.h"
#include "core/error.h"
#include "core/parallel.h"

namespace stuv::tracking {
namespace {

using Clock = std::chrono::steady_clock;

/// Hidden-line removal: how far behind a face a point must lie, in radii of the object.
constexpr double kSlack = 2e-3;
/// Particles that are less likely than the best by this factor are not worth refining.
constexpr double kNegligibleLog = -12;
/// Residuals along one edge go wrong together, so this many count as much as one coordinate of a point.
constexpr double kPointWeight = 10;
/// Least error of a model's edge in a picture, whatever the residuals say.
constexpr double kModelError_px = 0.6;
/// Texture: corners looked for, and how many must be found to trust their pose.
constexpr int kMostCorners = 60, kLeastCorners = 6;
/// Places that look like a taught view, where keypoints do not say where the object is: how many are tried,
/// and how much more likely a better correlation makes one.
constexpr int kViewPlaces = 8;
constexpr double kViewLikelihood = 20;
/// Keypoint poses drawn for each particle that starts from one: minimal sets often hold a wrong match.
constexpr int kHypothesesPerParticle = 6;
/// A frame's keypoints are drawn from again where the pose that comes out is no good.
constexpr int kStarts = 3;
/// A pose that moves the outline by this many search ranges between two frames is a slip, not a motion.
constexpr double kMostJump = 5;
/// Cosine between viewing directions up to which a taught view must look like the frame (25 degrees).
constexpr double kComparable = 0.906;
/// A start is believed where the taught view's corners are found and the correlation is this, or, of objects
/// without corners, where it is higher and this part of the edge samples matches.
constexpr double kAlike = 0.45, kVeryAlike = 0.95, kSurePart = 0.5;
/// Points of a taught view for direct alignment, and those that suffice to weigh a particle.
constexpr int kSurfacePoints = 1200, kFewPoints = 160;
/// How far alignment may lead from where it starts, as movement of the outline (standard deviation).
constexpr double kSpread_px = 30;
/// Places that are aligned while tracking, and at a start; places this near are the same.
constexpr int kFollowed = 3, kStarted = 12;
constexpr double kSamePlace_px = 5;
/// Cosine between viewing directions up to which a second view is compared with (50 degrees).
constexpr double kSecondView = 0.64;
/// Independent pixels that brightness counts as in the likelihood of a particle, before and after refinement,
/// and the part of the variance that is never explained.
constexpr double kGlancedAt = 6, kLookedAt = 40, kLeastMisfit = 0.05;
/// Particles nearer than this are of one mode. Neighbouring samples of an edge of which one goes wrong alike.
constexpr double kOneMode_px = 6, kSamplesAlike = 4;
/// Without print, a pose is not determined where rivals have more of the weight, or where its place is not
/// known to this part of the distance or its turn to 5 degrees; and what starts must be seen for some frames
/// to be believed.
constexpr double kMostRivals = 0.3, kMostSigma = 0.05, kMostTurn_rad = 0.09, kSymmetry_rad = 1;
constexpr double kPlainPart = 0.45;
constexpr int kConfirmations = 3;
/// An object that is this much less alike up to its rim than inside is not where its outline is taken to be.
constexpr double kOtherRim = 0.2;
/// Differences of likeness that say nothing.
constexpr double kNoDifference = 0.02;
/// A refinement that makes the object this much less like its view is not taken.
constexpr double kWorse = 0.04;
/// Likeness from which alignment's answer is used.
constexpr double kLikeEnough = 0.6;
/// Brightness that the taught views explain less of is not the object's.
constexpr double kLeastFit = 0.6, kPlainFit = 0.9;
/// Print that is this like the taught one is the object; this unlike, it is not.
constexpr double kSamePrint = 0.9, kOtherPrint = 0.3;
/// How far the distance of a start may be from the taught one, as a factor.
constexpr double kMostScale = 1.6;
/// Frames after a loss during which the old states are kept among the particles.
constexpr int kKeptFrames = 15;

class StageClock {
 public:
  explicit StageClock(double& seconds) : seconds_(seconds), begin_(Clock::now()) {}
  ~StageClock() { seconds_ += std::chrono::duration<double>(Clock::now() - begin_).count(); }
  StageClock(const StageClock&) = delete;
  StageClock& operator=(const StageClock&) = delete;

 private:
  double& seconds_;
  Clock::time_point begin_;
};

/// Between the object's own frame and one with its middle at the origin and its radius as the unit, in which
/// the filter works: a twist's rotation then turns the object about itself, and no size is special.
struct Normalisation {
  Eigen::Vector3d centre;
  double radius;

  Eigen::Vector3d point(const Eigen::Vector3d& x) const { return (x - centre) / radius; }
  Pose into(const Pose& p) const { return {p.R, (p.R * centre + p.t) / radius}; }
  Pose back(const Pose& p) const { return {p.R, radius * p.t - p.R * centre}; }
  Matrix6 covariance_back(const Matrix6& c) const {
    // x + w x (x - centre) + radius v': v = radius v' + centre x w
    Matrix6 M = Matrix6::Identity();
    M.topLeftCorner<3, 3>() *= radius;
    M.topRightCorner<3, 3>() = cross_matrix(centre);
    return M * c * M.transpose();
  }
};

ObjectModel normalised(ObjectModel model, const Normalisation& n) {
  for (Eigen::Vector3d& v : model.vertices) v = n.point(v);
  for (Eigen::Vector3d& v : model.face_points) v = n.point(v);
  return model;
}

/// Standard deviations of a twist in the camera's axes that move the object's outline by one pixel: across
/// the view by z / f, along it by z^2 / f, rotations by z / f (the object's radius is 1).
Twist one_pixel(double z, double focal_px) {
  Twist s;
  const double side = z / focal_px;
  s << side, side, side * std::max(1.0, z), side, side, side;
  return s;
}

/// A twist given in the camera's axes, in the object's.
Twist in_object(const Pose& cam_from_object, const Twist& cam) {
  Twist t;
  t << cam_from_object.R.transpose() * cam.head<3>(), cam_from_object.R.transpose() * cam.tail<3>();
  return t;
}

/// The difference of two poses in pixels of the outline, largest component.
double distance_px(const Pose& a, const Pose& b, double focal_px) {
  const Twist d = log(a.inverse() * b);
  Twist cam;
  cam << a.R * d.head<3>(), a.R * d.tail<3>();
  return cam.cwiseQuotient(one_pixel(a.t.z(), focal_px)).cwiseAbs().maxCoeff();
}

struct Measured {
  std::vector<EdgeSample> samples;
  double log_weight = 0, looks = 0;
  Pose refined;
};

}  // namespace

struct Tracker::State {
  State(const ObjectModel& object, const Camera& camera, const std::vector<Keyframe>& taught,
        const TrackerOptions& o)
      : options(o),
        norm{object.centre(), object.radius()},
        model(normalised(object, norm)),
        lens(camera),
        keyframes(normalised_keyframes(taught)),
        matcher(keyframes),
        arena(o.threads > 0 ? o.threads : tbb::task_arena::automatic) {
    options.texture = options.texture && options.polish;
    if (!options.texture || keyframes.empty()) return;
    rays = rays_of(camera);
    for (const Keyframe& k : keyframes) {
      views.push_back(
          {k.picture, k.cam_from_object, render_depth(model, lens, rays, k.cam_from_object, kSlack)});
      surfaces.push_back(surface_view(views.back(), model, rays, kSurfacePoints));
    }
    if (std::all_of(surfaces.begin(), surfaces.end(), is_plain))
      for (SurfaceView& s : surfaces) add_unseen_faces(model, s);
  }

  std::vector<Keyframe> normalised_keyframes(std::vector<Keyframe> taught) const {
    for (Keyframe& k : taught) {
      k.cam_from_object = norm.into(k.cam_from_object);
      for (Eigen::Vector3d& x : k.points) x = norm.point(x);
    }
    return taught;
  }

  // --- states -------------------------------------------------------------------------------------------

  double gaussian() { return std::normal_distribution<double>()(random); }

  Twist noise_at(const Pose& pose, double noise_px) {
    Twist n = one_pixel(pose.t.z(), lens.focal_px()) * noise_px;
    for (int i = 0; i < 6; ++i) n[i] *= gaussian();
    return in_object(pose, n);
  }

  /// The states of the frame before, moved by equation 3. `before` keeps X_{t-1} for equation 4.
  void move_particles() {
    before.clear();
    for (Particle& p : particles) {
      before.push_back(p.pose);
      p.pose = propagate(p, noise_at(p.pose, options.noise_px));
    }
  }

  /// Particles from keypoint matches, drawn by their weights (equation 6); false without enough matches.
  bool particles_from_keypoints(const Grey& frame, int count, std::vector<Particle>& out) {
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
  void follow_keypoints(const std::vector<Hypothesis>& drawn) {
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
  bool particles_from_views(const Grey& frame, int count, std::vector<Particle>& out) {
    std::vector<ViewMatch> places = search_views(views, frame, rays, kViewPlaces);
    if (places.empty()) return false;
    std::vector<std::vector<PointMatch>> followed(places.size());
    parallel_for(static_cast<int>(places.size()), [&](int i) {
      ViewMatch& m = places[i];
      if (const auto better = texture_pose(frame, m.cam_from_object, followed[i])) {
        const double correlation = correlation_at(frame, *better);
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

  // --- likelihood and refinement ------------------------------------------------------------------------

  /// Likelihood of a fit of brightness (surface_view.h): residuals of `count` independent pixels whose
  /// unknown variance is that of the residuals, -count / 2 log(1 - fit).
  static double log_looks(double fit, double count) {
    return -0.5 * count * std::log(kLeastMisfit + 1 - std::clamp(fit, 0.0, 1.0));
  }

  void measure(const GradientPicture& gradient, const Pose& pose, double range, double pixels,
               Measured& out) const {
    out.samples = sample_edges(model, lens, pose, options.spacing_px, kSlack);
    match_edges(gradient, range, options.least_cosine, out.samples);
    out.looks = looks(pose, 0);
    out.log_weight = log_likelihood(summarise(out.samples), range, options.likelihood) +
                     texture_likelihood(pose) + log_looks(out.looks, pixels);
  }

  /// Equation 5 for the texture's points: -lambda_c (c - c_i) / c.
  double texture_likelihood(const Pose& pose) const {
    if (texture_points.empty()) return 0;
    int inliers = 0;
    for (const PointMatch& m : texture_points) {
      Eigen::Vector2d q;
      inliers += lens.project(pose * m.x, q) && (q - m.q).norm() < HypothesisOptions{}.inlier_px ? 1 : 0;
    }
    return -HypothesisOptions{}.lambda_c * (1 - inliers / static_cast<double>(texture_points.size()));
  }

  void refine_one(const GradientPicture& gradient, const Pose& pose, Measured& m) const {
    RefineOptions how;
    how.iterations = options.refine_iterations;
    const auto refine_from = [&](const Pose& from) {
      m.refined = refine(m.samples, texture_points, lens, from, how).cam_from_object;
    };
    const double near_px = std::max(3.0, options.search_px / 4), weight = m.log_weight, looked = m.looks;
    refine_from(pose);
    measure(gradient, m.refined, near_px, kLookedAt, m);
    refine_from(m.refined);
    if (!options.reweigh) return void(m.log_weight = weight);
    measure(gradient, m.refined, near_px, kLookedAt, m);
    // Clutter's edges may lead away from a place that looks right: then only near ones, or none.
    if (m.looks >= looked - kWorse) return;
    measure(gradient, pose, near_px, kLookedAt, m);
    const Measured unmoved = m;
    refine_from(pose);
    measure(gradient, m.refined, near_px, kLookedAt, m);
    if (m.log_weight >= unmoved.log_weight) return;
    m = unmoved;
    m.refined = pose;
  }

  /// Weights (7, 8), refinement (9, 10) of the particles that matter, weights again.
  void weigh_particles(const GradientPicture& gradient) {
    std::vector<Measured> measured(particles.size());
    const int count = static_cast<int>(particles.size());
    parallel_for(count, [&](int i) {
      measure(gradient, particles[i].pose, options.search_px, kGlancedAt, measured[i]);
    });
    double best = -std::numeric_limits<double>::infinity();
    for (const Measured& m : measured) best = std::max(best, m.log_weight);
    parallel_for(count, [&](int i) {
      Measured& m = measured[i];
      m.refined = particles[i].pose;
      if (options.refine_iterations <= 0) return;
      if (m.log_weight < best + kNegligibleLog)
        m.log_weight = -std::numeric_limits<double>::infinity();
      else
        refine_one(gradient, particles[i].pose, m);
    });
    for (int i = 0; i < count; ++i) {
      particles[i].pose = measured[i].refined;
      particles[i].log_weight = measured[i].log_weight;
    }
  }

  /// The mean of the particles around the most likely one (a mean over several modes lies in none).
  Pose mean_pose(const std::vector<double>& weights) const {
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
  double rival_weight() const {
    const auto& best =
        *std::max_element(particles.begin(), particles.end(),
                          [](const auto& a, const auto& b) { return a.log_weight < b.log_weight; });
    double all = 0, elsewhere = 0;
    for (const Particle& p : particles) {
      const double w = std::exp((p.log_weight - best.log_weight) / kSamplesAlike);
      all += w;
      if (!is_same_mode(best.pose, p.pose)) elsewhere += w;
    }
    return elsewhere / all;
  }

  bool is_same_mode(const Pose& a, const Pose& b) const {
    return distance_px(a, b, lens.focal_px()) <= kOneMode_px;
  }

  int wanted_particles(const std::vector<double>& weights) const {
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

  // --- texture -------------------------------------------------------------------------------------------

  /// The taught view whose direction is nearest to the pose's.
  const TexturedView* nearest_view(const Pose& pose) const {
    const TexturedView* best = nullptr;
    double most = 0.3;  // beyond about 70 degrees there is nothing to compare
    for (const TexturedView& view : views) {
      const double cosine = view.cam_from_object.centre().normalized().dot(pose.centre().normalized());
      if (cosine > most) most = cosine, best = &view;
    }
    return best;
  }

  std::vector<PointMatch> texture_matches(const Grey& frame, const Pose& pose) const {
    const TexturedView* view = nearest_view(pose);
    if (view == nullptr || !(pose.t.z() > 1)) return {};
    const WarpedView warped = warp_view(*view, model, lens, rays, pose, kSlack);
    if (warped.picture.empty()) return {};
    return follow_texture(warped, frame, rays, pose, kMostCorners);
  }

  /// Correlation of the frame with the nearest taught view; NaN if there is none near enough: from far beside
  /// it light and hidden detail change too much to judge by.
  double correlation_at(const Grey& frame, const Pose& pose) const {
    const TexturedView* view = nearest_view(pose);
    const bool comparable =
        view != nullptr && pose.t.z() > 1 &&
        view->cam_from_object.centre().normalized().dot(pose.centre().normalized()) > kComparable;
    if (!comparable) return std::numeric_limits<double>::quiet_NaN();
    // Every second row and column of a large object say as much.
    const int stride = lens.focal_px() > 60 * pose.t.z() ? 2 : 1;
    return correlation(warp_view(*view, model, lens, rays, pose, kSlack, stride), frame);
  }

  /// A pose from texture alone, from a pose near it, and the points followed, none if they are too few.
  std::optional<Pose> texture_pose(const Grey& frame, const Pose& predicted,
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
    const Refined r = refine({}, points, lens, predicted, how);
    if (r.deviation_px > 2) return {};
    return r.cam_from_object;
  }

  // --- looks ----------------------------------------------------------------------------------------------

  /// The taught views to compare with at a pose: the nearest two.
  std::vector<const SurfaceView*> surfaces_near(const Pose& pose) const {
    const TexturedView* nearest = nearest_view(pose);
    if (nearest == nullptr) return {};
    std::vector<const SurfaceView*> near = {&surfaces[nearest - views.data()]};
    const SurfaceView* second = nullptr;
    double most = kSecondView;
    for (const SurfaceView& s : surfaces) {
      const double cosine = s.cam_from_object.centre().normalized().dot(pose.centre().normalized());
      if (&s != near[0] && cosine > most) most = cosine, second = &s;
    }
    if (second != nullptr) near.push_back(second);
    return near;
  }

  std::vector<const SurfaceView*> surfaces_for(const Pose& pose) const {
    return surfaces_now.empty() ? surfaces_near(pose) : surfaces_now;
  }

  /// Mean over the views that can be compared; NaN: none can.
  Likeness likeness_at(const Pose& pose, int level, int points) const {
    Likeness sum;
    int fits = 0, wholes = 0, prints = 0;
    const std::vector<const SurfaceView*> near = surfaces_for(pose);
    for (const SurfaceView* s : near) {
      const Likeness l = likeness(*s, pyramid, level, lens, pose, points / static_cast<int>(near.size()));
      if (!std::isnan(l.fit)) sum.fit += l.fit, ++fits;
      if (!std::isnan(l.whole)) sum.whole += l.whole, ++wholes;
      if (!std::isnan(l.print)) sum.print += l.print, ++prints;
    }
    return {sum.fit / fits, sum.whole / wholes, sum.print / prints};
  }

  /// Likeness to the taught views by a few points, 0 where it is not known.
  double looks(const Pose& pose, int level) const {
    if (surfaces.empty()) return 0;
    const double fit = likeness_at(pose, level, kFewPoints).fit;
    return std::isnan(fit) ? 0 : fit;
  }

  Alignment aligned(const Pose& pose, int from) const {
    const std::vector<const SurfaceView*> near = surfaces_for(pose);
    if (near.empty()) return {};
    return align(near, pyramid, from, lens, pose, one_pixel(pose.t.z(), lens.focal_px()) * kSpread_px);
  }

  struct Place {
    Pose pose;
    double looks = 0;
  };

  /// The places that look most like a taught view, aligned with it, most alike first.
  std::vector<Place> best_places(const std::vector<Pose>& poses, int most) const {
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
            return distance_px(c.pose, p.pose, lens.focal_px()) < kSamePlace_px;
          }))
        chosen.push_back(p);
    }
    parallel_for(static_cast<int>(chosen.size()), [&](int i) {
      Place& place = chosen[i];
      place.looks = looks(place.pose, 1);
      const Alignment better = aligned(place.pose, 2);
      const double looks_then = better.converged ? looks(better.cam_from_object, 1) : 0;
      if (looks_then > place.looks + kNoDifference) place = {better.cam_from_object, looks_then};
    });
    std::stable_sort(chosen.begin(), chosen.end(), more_alike);
    return chosen;
  }

  /// Particles around places, as many of each as they are alike.
  std::vector<Particle> particles_around(const std::vector<Place>& places, int count) {
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

  // --- the estimate ----------------------------------------------------------------------------------------

  /// What brightness says of the pose.
  PosePrior prior_by_looks(const Pose& pose, const MatchSummary& edges) const {
    const Alignment better = aligned(pose, 1);
    // Plain faces pull the pose inwards, away from the background, and nothing pulls it out.
    if (!better.converged || !(likeness_at(better.cam_from_object, 1, kSurfacePoints).print > kLikeEnough))
      return {};
    // Brightness counts in full however many edges are found, as those found may be a grid's; and for more
    // where few are.
    const double missing = double(edges.visible - edges.matched) / std::max(1, edges.matched);
    const double trust = std::clamp(missing, 1.0, 2.0);
    return {better.cam_from_object,
            trust * kPointWeight * kModelError_px * kModelError_px * better.information};
  }

  Refined polish(const GradientPicture& gradient, const Grey& frame, Pose pose, TrackedFrame& out) const {
    RefineOptions how;
    how.weights = RefineOptions::Weights::tukey;
    how.iterations = 5;
    if (!options.polish) how.iterations = 0;
    Refined r;
    std::vector<PointMatch> points;
    PosePrior by_looks;
    double looked = looks(pose, 0);
    for (const double range : {6.0, 3.0, 3.0}) {
      std::vector<EdgeSample> samples = sample_edges(model, lens, pose, options.spacing_px / 2, kSlack);
      match_edges(gradient, range, options.least_cosine, samples);
      // Matches stay true as the pose moves on: they are places in the picture and on the object.
      if (options.texture && range < 6 && points.empty()) points = texture_matches(frame, pose);
      if (options.texture && range == 6) by_looks = prior_by_looks(pose, summarise(samples));
      for (PointMatch& p : points) p.weight = kPointWeight;
      how.c_px = range / 2;
      r = refine(samples, points, lens, pose, how, by_looks);
      // Clutter's edges may lead away from a place that looks right.
      const double looks_now = looks(r.cam_from_object, 0);
      if (looks_now < looked - kWorse) r.cam_from_object = pose;
      looked = std::max(looked, looks_now);
      pose = r.cam_from_object;
    }
    out.texture_points = static_cast<int>(points.size());
    out.correlation = correlation_at(frame, pose);
    if (!surfaces.empty()) {
      const Likeness l = likeness_at(pose, 0, kSurfacePoints);
      out.print = l.print;
      out.fit = l.fit;
      out.likeness = l.whole;
    }
    std::vector<EdgeSample> samples = sample_edges(model, lens, pose, options.spacing_px / 2, kSlack);
    match_edges(gradient, options.lost_px, options.least_cosine, samples);
    out.edges = summarise(samples);
    return r;
  }

  /// Noise times the inverse of the information, with a prior of an object's size and of pi, so that what the
  /// picture does not say is reported as not known.
  Matrix6 covariance_of(const Refined& r) const {
    const double noise = std::max(kModelError_px, r.deviation_px), pi = std::numbers::pi;
    Twist prior;
    prior << 1, 1, 1, 1 / (pi * pi), 1 / (pi * pi), 1 / (pi * pi);
    Matrix6 information = r.information / (kPointWeight * noise * noise);
    information += prior.asDiagonal();
    return information.inverse();
  }

  /// A plain object that looks alike much nearer or farther than it was taught is something else more often.
  bool has_taught_size(const Pose& pose) const {
    const TexturedView* view = nearest_view(pose);
    if (view == nullptr) return true;
    const double part = pose.t.norm() / view->cam_from_object.t.norm();
    return part > 1 / kMostScale && part < kMostScale;
  }

  bool is_lost(const TrackedFrame& f) const {
    if (f.edges.visible < 6) return true;
    if (f.print - f.correlation > kOtherRim) return true;
    if (f.print > kSamePrint) return false;
    if (f.print < kOtherPrint) return true;
    // Plain faces are told by little else than that the background's pattern is not on them.
    const bool is_plain = std::isnan(f.print);
    if (is_plain && !surfaces.empty() && !has_taught_size(estimate)) return true;
    if (f.fit < (is_plain ? kPlainFit : kLeastFit)) return true;
    // A start comes from a taught view, which must then be there to compare with; but not far from where it
    // was last seen a plain face that fits is the same object still.
    const bool goes_on = is_plain && f.fit > kPlainFit && is_near_last();
    const bool must_compare = f.initialised && !views.empty() && !goes_on;
    const double alike = std::isnan(f.likeness) ? f.correlation : f.likeness;
    if (alike < options.lost_correlation || (must_compare && std::isnan(alike))) return true;
    if (must_compare && !has_taught_size(estimate)) return true;
    // An object that looks as taught may have edges that are faint or hidden.
    const double matched = static_cast<double>(f.edges.matched) / f.edges.visible;
    const bool looks_right = (alike > kAlike && f.texture_points >= kLeastCorners) ||
                             (alike > kVeryAlike && (!must_compare || matched >= kSurePart));
    if (must_compare && !looks_right) return true;
    if (looks_right) return matched < 0.5 * options.lost_part;
    // One plain face, without contrast to compare.
    const bool fits = is_plain && f.fit > kVeryAlike && !(alike < kPlainFit);
    return matched < (fits ? (f.initialised ? kSurePart : 0.75 * options.lost_part) : options.lost_part);
  }

  bool is_near_last() const {
    return !good_particles.empty() && frames_lost < kKeptFrames &&
           distance_px(good_estimate, estimate, lens.focal_px()) < options.search_px * (1 + frames_lost);
  }

  // --- one frame -------------------------------------------------------------------------------------------

  /// Texture, from where the motion so far leads.
  void follow_motion(const Grey& frame) {
    texture_points.clear();
    texture_found.reset();
    if (particles.empty() || lost || !options.filter || !options.texture || views.empty()) return;
    texture_found = texture_pose(frame, estimate * exp(drift), texture_points);
  }

  /// Fills `particles`; false if there is nothing to start from.
  bool predict(const Grey& frame, bool by_views, TrackedFrame& out) {
    if (!particles.empty() && !lost) {
      move_particles();
      propose_by_looks();
      return true;
    }
    surfaces_now.clear();
    texture_points.clear();
    const StageClock clock(out.seconds.keypoints);
    std::vector<Particle> fresh;
    if (by_views || !particles_from_keypoints(frame, options.particles, fresh))
      particles_from_views(frame, options.particles, fresh);
    const std::vector<Particle> kept = scattered_particles();
    std::vector<Pose> poses;
    for (const Particle& p : fresh) poses.push_back(p.pose);
    for (const Particle& p : kept) poses.push_back(p.pose);
    for (const TexturedView& v : views) poses.push_back(v.cam_from_object);
    const std::vector<Particle> alike =
        particles_around(best_places(poses, kStarted), (options.particles + 1) / 2);
    if (alike.empty() && fresh.empty() && kept.empty()) return false;
    // A half by looks, the other from what was found and what was known.
    std::vector<Particle> all = alike;
    const std::size_t rest = static_cast<std::size_t>(options.particles) - all.size();
    const std::size_t of_kept = fresh.empty() ? rest : rest / 2;
    all.insert(all.end(), kept.begin(), kept.begin() + std::ptrdiff_t(std::min(of_kept, kept.size())));
    for (std::size_t i = 0; i < fresh.size() && all.size() < static_cast<std::size_t>(options.particles); ++i)
      all.push_back(fresh[i]);
    restart(std::move(all));
    out.initialised = true;
    return true;
  }

  /// The states when the object was last seen, the more scattered the longer that is ago.
  std::vector<Particle> scattered_particles() {
    if (frames_lost >= kKeptFrames) return {};
    std::vector<Particle> kept = good_particles;
    const double most_px = options.noise_px * (2 + frames_lost);
    // Most losses are short slips: some stay near.
    for (std::size_t i = 0; i < kept.size(); ++i)
      kept[i].pose =
          i == 0 ? good_estimate : kept[i].pose * exp(noise_at(kept[i].pose, most_px / double(1 << (i % 3))));
    return kept;
  }

  void restart(std::vector<Particle> fresh) {
    particles = std::move(fresh);
    before.clear();
    for (const Particle& p : particles) before.push_back(p.pose);
    drift.setZero();
    // A start has no velocity, which is not the same as one of 0.
    for (Particle& p : particles) p.velocity.setZero();
  }

  /// A tenth of the particles come from the poses that look most like a taught view near the predicted ones.
  void propose_by_looks() {
    const Pose predicted = estimate * exp(drift);
    surfaces_now = surfaces_near(predicted);
    std::vector<Particle> proposed;
    if (!surfaces_now.empty()) {
      std::vector<Pose> poses = {predicted, estimate};
      if (texture_found) poses.push_back(*texture_found);
      for (const Particle& p : particles) poses.push_back(p.pose);
      proposed = particles_around(best_places(poses, kFollowed),
                                  std::max(1, static_cast<int>(particles.size() / 10)));
    }
    if (texture_found) proposed.push_back({*texture_found, Twist::Zero(), 0});
    if (!proposed.empty()) proposed.push_back({predicted, Twist::Zero(), 0});
    for (std::size_t i = 0; i < std::min(proposed.size(), particles.size()); ++i)
      particles[i].pose = proposed[i].pose;
  }

  /// Few particles may have all the weight because one of them is right.
  bool is_sure(const std::vector<double>& weights) const {
    if (surfaces.empty()) return false;
    const auto best = std::max_element(weights.begin(), weights.end()) - weights.begin();
    const Likeness l = likeness_at(particles[best].pose, 1, kSurfacePoints);
    return (std::isnan(l.print) ? l.fit : l.print) > kSamePrint;
  }

  void run_filter(const GradientPicture& gradient, const Grey& frame, TrackedFrame& out) {
    weigh_particles(gradient);
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
        surfaces_now.clear();
        weigh_particles(gradient);
        weights = normalised_weights(particles);
        out.initialised = true;
      }
    }
    estimate_now = mean_pose(weights);
    out.rivals = rival_weight();
    for (std::size_t i = 0; i < particles.size(); ++i)
      particles[i].velocity = out.initialised
                                  ? Twist(Twist::Zero())
                                  : velocity(options.autoregression, before[i], particles[i].pose);
    const int wanted = wanted_particles(weights);
    out.particles = static_cast<int>(particles.size());
    particles = resample(particles, weights, wanted, std::uniform_real_distribution<double>()(random));
  }

  TrackedFrame track(const Grey& frame) {
    TrackedFrame out;
    ++frame_number;
    random.seed(options.seed * 7919 + frame_number);
    GradientPicture gradient;
    // The two need nothing of each other.
    tbb::parallel_invoke(
        [&] {
          const StageClock clock(out.seconds.gradient);
          gradient = gradient_of(frame, 1.0, options.contrast);
        },
        [&] {
          const StageClock clock(out.seconds.texture);
          if (!surfaces.empty()) pyramid = smooth_pyramid(frame);
          follow_motion(frame);
        });
    for (int start = 0; start < kStarts; ++start) {
      // The last try is by looks, should keypoints mislead.
      if (options.filter ? !predict(frame, start + 1 == kStarts, out) : !predict_alone(gradient, frame, out))
        return out;
      estimate_pose(gradient, frame, out);
      if (!lost || !out.initialised) break;
    }
    if (options.filter && !out.initialised && !lost && is_doubtful(out))
      out = second_opinion(gradient, frame, out);
    if (!lost)
      usual_deviation =
          usual_deviation > 0 ? 0.9 * usual_deviation + 0.1 * out.deviation_px : out.deviation_px;
    out.lost = lost || !is_certain(out);
    if (!out.lost) good_particles = particles, good_estimate = estimate;
    frames_lost = out.lost ? frames_lost + 1 : 0;
    return out;
  }

  /// Whether the estimate's standard deviations are small enough for a pose. A turn that is not known at all
  /// is an object's symmetry, not an error.
  bool determines(const Matrix6& covariance) const {
    const double place = std::sqrt(covariance.topLeftCorner<3, 3>().trace());
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> turns(covariance.bottomRightCorner<3, 3>(),
                                                               Eigen::EigenvaluesOnly);
    const Eigen::Array3d turn = turns.eigenvalues().array().max(0).sqrt();
    return place <= kMostSigma * estimate.t.norm() && (turn <= kMostTurn_rad || turn > kSymmetry_rad).all();
  }

  /// Whether a pose that is followed is also to be relied on. An object without print is told from its
  /// surroundings by its edges only, so there must be enough of them and nothing else that fits; and its
  /// start is believed after some frames, as wrong ones seldom last.
  bool is_certain(const TrackedFrame& f) {
    frames_seen = lost || f.initialised ? 0 : frames_seen + 1;
    if (surfaces.empty() || !std::isnan(f.print)) return true;
    return frames_seen >= kConfirmations && f.rivals <= kMostRivals && is_determined &&
           f.edges.matched >= kPlainPart * f.edges.visible;
  }

  /// The residuals are much larger than they have been: perhaps a local minimum that looks nearly right.
  bool is_doubtful(const TrackedFrame& f) const {
    return usual_deviation > 0 && f.deviation_px > std::max(0.5, 3 * usual_deviation);
  }

  /// The frame again, from its keypoints; the answer with the smaller residuals stands.
  TrackedFrame second_opinion(const GradientPicture& gradient, const Grey& frame, const TrackedFrame& first) {
    const std::vector<Particle> first_particles = particles;
    const Pose first_estimate = estimate;
    const Twist first_drift = drift;
    TrackedFrame second;
    second.seconds = first.seconds;
    std::vector<Particle> fresh;
    bool found = false;
    texture_points.clear();
    {
      const StageClock clock(second.seconds.keypoints);
      found = particles_from_keypoints(frame, options.particles, fresh);
    }
    if (found) {
      restart(std::move(fresh));
      second.initialised = true;
      estimate_pose(gradient, frame, second);
      if (!lost && second.deviation_px < 0.7 * first.deviation_px) return second;
    }
    particles = first_particles;
    estimate = first_estimate;
    drift = first_drift;
    lost = false;
    TrackedFrame kept = first;
    kept.seconds = second.seconds;
    return kept;
  }

  void estimate_pose(const GradientPicture& gradient, const Grey& frame, TrackedFrame& out) {
    if (options.filter) {
      const StageClock clock(out.seconds.filter);
      run_filter(gradient, frame, out);
    }
    const StageClock clock(out.seconds.estimate);
    const Pose last = estimate;
    const bool was_tracked = known && !lost && !out.initialised;
    const Refined r = polish(gradient, frame, estimate_now, out);
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

  /// Without the filter: IRLS from the last pose, the method that the paper compares with.
  bool predict_alone(const GradientPicture& gradient, const Grey& frame, TrackedFrame& out) {
    if (known && !lost) {
      Measured m;
      measure(gradient, estimate, options.search_px, kGlancedAt, m);
      refine_one(gradient, estimate, m);
      estimate_now = m.refined;
      return true;
    }
    std::vector<Particle> fresh;
    if (!particles_from_keypoints(frame, options.particles, fresh))
      return known && (estimate_now = estimate, true);
    out.initialised = true;
    std::vector<Pose> poses;
    for (const Particle& p : fresh) poses.push_back(p.pose);
    estimate_now = poses.front();
    return true;
  }

  TrackerOptions options;
  Normalisation norm;
  ObjectModel model;
  Lens lens;
  std::vector<Keyframe> keyframes;
  KeypointMatcher matcher;
  tbb::task_arena arena;
  ImageF rays;
  std::vector<TexturedView> views;
  std::vector<SurfaceView> surfaces;             ///< of the views, in their order
  std::vector<const SurfaceView*> surfaces_now;  ///< what all particles are compared with; null: the nearest
  SmoothPyramid pyramid;                         ///< of this frame

  std::mt19937_64 random;
  std::vector<Particle> particles;
  std::vector<Particle> good_particles;  ///< when the object was last seen
  std::vector<Pose> before;
  std::vector<KeypointMatch> matches;      ///< keypoints of frame number `matches_frame`
  std::vector<PointMatch> texture_points;  ///< of this frame, where the motion so far led
  std::optional<Pose> texture_found;       ///< and the pose that they tell
  std::uint64_t matches_frame = 0;
  Pose estimate, estimate_now, good_estimate;
  Twist drift = Twist::Zero();
  bool known = false, lost = false;
  double usual_deviation = 0;            ///< running mean of deviation_px; 0: none yet
  bool is_determined = false;            ///< the estimate, by its own covariance
  int frames_lost = 0, frames_seen = 0;  ///< since it was last believed; since it started
  std::uint64_t frame_number = 0;
};

Tracker::Tracker(const ObjectModel& model, const Camera& camera, const std::vector<Keyframe>& keyframes,
                 const TrackerOptions& options)
    : state_(std::make_unique<State>(model, camera, keyframes, options)) {}

Tracker::~Tracker() = default;

void Tracker::start(const Pose& cam_from_object) {
  Particle p;
  p.pose = state_->norm.into(cam_from_object);
  state_->restart(std::vector<Particle>(static_cast<std::size_t>(state_->options.particles), p));
  state_->estimate = p.pose;
  state_->known = true;
  state_->lost = false;
  state_->frames_seen = kConfirmations;
}

TrackedFrame Tracker::track(const Grey& frame) {
  if (frame.width != state_->lens.width() || frame.height != state_->lens.height())
    throw Error(state_->lens.camera().name,
                fmt::format("is a camera of {}x{}, the frame is {}x{}", state_->lens.width(),
                            state_->lens.height(), frame.width, frame.height),
                "give the camera that took the frames, at their size");
  TrackedFrame out;
  double seconds = 0;
  {
    const StageClock clock(seconds);
    state_->arena.execute([&] { out = state_->track(frame); });
  }
  out.seconds.total = seconds;
  return out;
}

}  // namespace stuv::tracking
