#include "calib/two_view/estimate.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "calib/two_view/critical_conic.h"
#include "calib/two_view/match_noise.h"
#include "calib/two_view/robust.h"
#include "calib/two_view/rotation.h"
#include "core/median.h"

namespace stuv {
namespace {

using Eigen::Matrix3d;

constexpr int kSearched = 2000;       ///< matches that the search looks at, of more an even choice
constexpr int kGoldStandard = 20000;  ///< matches from which Sampson's estimate, then as good, is final
constexpr double kCutSigmas = 3;
/// A match that several detectors or scales found is right more often: it counts as often as it is given, up
/// to this.
constexpr double kMostCounted = 4;
/// Runs of the search in all; the later ones of so many samples each, at the threshold, a half and a quarter
/// of it.
constexpr int kRivalRuns = 6, kRivalSamples = 300;
/// Noise below this part of the radius (0.01 px in a picture of 800) is taken for this much: whether matches
/// determine F must not hang on their being exact.
constexpr double kLeastNoise = 3e-5;
constexpr double kLog10FalseAlarms = -3, kLog10ParallaxFalseAlarms = -4;
/// Parallax of a point that `ok` must predict, in radii.
constexpr double kParallax = 0.1;

/// The matches that count, and what they measure.
struct Work {
  std::vector<int> index;  ///< into the matches given
  Matches all, searched;
  std::vector<double> counts, searched_counts;  ///< how often each was given, kMostCounted at most
  double radius_px = 0;                         ///< rms distance from the mean, both pictures
  double threshold_px = 0;
  /// Of picture B: the part of it within a distance of 1 px of a line across it, and of a point.
  double line_chance = 0, point_chance = 0;

  double least_noise() const { return kLeastNoise * radius_px; }
};

Work prepare(const Matches& matches, const TwoViewOptions& options) {
  Work w;
  w.index = distinct_matches(matches, &w.counts);
  for (double& count : w.counts) count = std::min(count, kMostCounted);
  for (const int i : w.index) w.all.push_back(matches[i]);
  if (w.all.empty()) return w;
  const auto [Ta, Tb] = normalisation(w.all);
  w.radius_px = std::sqrt(2 / (Ta.scale * Tb.scale));
  w.threshold_px = options.threshold_px > 0 ? options.threshold_px : 0.01 * w.radius_px;
  const std::size_t n = std::min<std::size_t>(kSearched, w.all.size());
  for (std::size_t i = 0; i < n; ++i) {
    w.searched.push_back(w.all[i * w.all.size() / n]);
    w.searched_counts.push_back(w.counts[i * w.all.size() / n]);
  }
  Eigen::AlignedBox2d box;
  for (const Match& m : w.all) box.extend(m.b);
  const double area = box.sizes().prod();
  w.line_chance = area > 0 ? 2 * box.diagonal().norm() / area : std::numeric_limits<double>::infinity();
  w.point_chance = area > 0 ? M_PI / area : std::numeric_limits<double>::infinity();
  return w;
}

std::vector<double> distances(const Matrix3d& F, const Matches& matches) {
  std::vector<double> d;
  d.reserve(matches.size());
  for (const Match& m : matches) d.push_back(std::abs(sampson_distance(F, m)));
  return d;
}

double log10_choose(double n, double k) {
  return (std::lgamma(n + 1) - std::lgamma(k + 1) - std::lgamma(n - k + 1)) / std::log(10.0);
}

/// log10 of the expected number of models, of all that samples of `sample` among n matches give, with which
/// at least `k` of the n agree where each does by chance with probability p.
double log10_false_alarms(int n, int k, int sample, int models, double p) {
  if (k <= sample) return 0;
  return std::log10(double(models) * (n - sample)) + log10_choose(n, k) + log10_choose(k, sample) +
         (k - sample) * std::log10(std::min(1.0, p));
}

struct Search {
  std::vector<Matrix3d> candidates;  ///< F's of rival agreements
  Matrix3d H = Matrix3d::Zero();
  int samples = 0;
};

std::vector<int> off_plane(const Matrix3d& H, const Matches& matches, double threshold) {
  std::vector<int> off;
  const Matrix3d H_inverse = H.inverse();
  for (std::size_t i = 0; i < matches.size(); ++i)
    if (!(transfer_distance2(H, H_inverse, matches[i]) < threshold * threshold))
      off.push_back(static_cast<int>(i));
  return off;
}

/// RANSAC, several times: few matches have rival agreements, and which one a run ends in hangs on its
/// samples. Then the dominant plane and what parallax adds to it.
Search search(const Work& w, const TwoViewOptions& options) {
  RansacOptions ransac;
  ransac.threshold_px = w.threshold_px;
  ransac.confidence = options.confidence;
  ransac.most_samples = options.most_samples;
  ransac.least_samples = std::min(options.least_samples, options.most_samples);
  ransac.seed = options.seed;
  Search s;
  const auto consider = [&](const RansacResult<Matrix3d>& r) {
    s.samples += r.samples;
    if (r.found) s.candidates.push_back(r.model);
  };
  consider(ransac_fundamental(w.searched, ransac));
  RansacOptions short_run = ransac;
  short_run.most_samples = std::min(kRivalSamples, options.most_samples);
  short_run.least_samples = short_run.most_samples;
  for (int run = 1; run < kRivalRuns; ++run) {
    short_run.threshold_px = w.threshold_px * (run % 3 == 0 ? 1 : run % 3 == 1 ? 0.5 : 0.25);
    short_run.seed = options.seed + static_cast<std::uint64_t>(run) * 0x9e3779b97f4a7c15;
    consider(ransac_fundamental(w.searched, short_run));
  }
  ransac.least_samples = 0;
  const auto plane = ransac_homography(w.searched, ransac);
  if (!plane.found) return s;
  s.H = plane.model;
  const std::vector<int> off = off_plane(s.H, w.searched, 1.5 * w.threshold_px);
  if (plane.inliers > 7 && off.size() > 2) consider(plane_and_parallax(w.searched, s.H, off, ransac));
  return s;
}

/// Inliers and noise of F, each from the other until they stand still.
struct Agreement {
  std::vector<int> inliers;
  double noise = 0, cut = 0;
};

Agreement agreement(const std::vector<double>& d, double most, double least) {
  Agreement a;
  a.cut = most;
  for (int round = 0; round < 20; ++round) {
    std::vector<double> kept;
    for (const double v : d)
      if (v < a.cut) kept.push_back(v);
    if (kept.size() < 8) break;
    a.noise = 1.4826 * median(kept) * std::sqrt(double(kept.size()) / (double(kept.size()) - 7));
    const double cut = std::clamp(kCutSigmas * a.noise, least, most);
    if (std::abs(cut - a.cut) < 1e-6 * most) break;
    a.cut = cut;
  }
  for (std::size_t i = 0; i < d.size(); ++i)
    if (d[i] < a.cut) a.inliers.push_back(static_cast<int>(i));
  return a;
}

Matches chosen(const Matches& matches, const std::vector<int>& which) {
  Matches out;
  for (const int i : which) out.push_back(matches[i]);
  return out;
}

/// F and inliers from each other until stable, all of them alike: where the fit of the noise begins.
std::optional<Matrix3d> settle(const Work& w, Matrix3d F, Agreement& a) {
  std::vector<int> before;
  for (int round = 0; round < 10; ++round) {
    a = agreement(distances(F, w.all), w.threshold_px, kCutSigmas * w.least_noise());
    if (a.inliers.size() < 8) return std::nullopt;
    if (a.inliers == before) break;
    before = a.inliers;
    const auto next = sampson_estimate(chosen(w.all, a.inliers), F);
    if (!next) return std::nullopt;
    F = next->F;
  }
  return F;
}

/// Of the candidates, settled, that of the greatest likelihood.
std::optional<NoiseFit> likeliest(const Work& w, const std::vector<Matrix3d>& candidates) {
  std::optional<NoiseFit> best;
  std::vector<std::vector<int>> seen;
  for (const Matrix3d& candidate : candidates) {
    Agreement a;
    const auto settled = settle(w, candidate, a);
    if (!settled || std::find(seen.begin(), seen.end(), a.inliers) != seen.end()) continue;
    seen.push_back(a.inliers);
    MatchNoise noise;
    noise.scale_px = std::max(a.noise, w.least_noise());
    noise.anywhere_per_px = w.line_chance / std::sqrt(2);
    NoiseFit fit =
        fit_noise_and_shape(w.searched, w.searched_counts, *settled, noise, w.least_noise(), w.threshold_px);
    if (!best || fit.log_likelihood > best->log_likelihood) best = std::move(fit);
  }
  return best;
}

/// The Gold Standard on what is likely right, with the weights of the fit.
std::optional<FundamentalMl> maximise(const Work& w, const std::vector<Matrix3d>& candidates, bool gold,
                                      Agreement& a) {
  auto fit = likeliest(w, candidates);
  if (!fit) return std::nullopt;
  if (w.searched.size() < w.all.size())
    fit = fit_noise(w.all, w.counts, fit->F, fit->noise, w.least_noise(), w.threshold_px, 5);
  a = {};
  a.noise = fit->noise.scale_px;
  a.cut = kCutSigmas * w.least_noise();
  std::vector<double> weights;
  for (int i = 0; i < static_cast<int>(w.all.size()); ++i) {
    if (!(fit->right[i] > 0.5)) continue;
    a.inliers.push_back(i);
    a.cut = std::max(a.cut, std::abs(sampson_distance(fit->F, w.all[i])));
    weights.push_back(fit->weight[i]);
  }
  if (a.inliers.size() < 8) return std::nullopt;
  const Matches inliers = chosen(w.all, a.inliers);
  auto ml = sampson_estimate(inliers, fit->F, weights);
  // Where F is free, or the matches exact, there is nothing to gain.
  const bool worth = ml && ml->condition < 1e6 && ml->noise_px > 1e-9 * w.radius_px;
  if (gold && worth && inliers.size() <= kGoldStandard) {
    const auto refined = gold_standard(inliers, fit->F, weights);
    if (refined) ml = refined;
  }
  if (ml) ml->noise_px = fit->sigma_px;
  return ml;
}

/// Of F: a Sampson distance is a root of two below the distance from the line.
double false_alarms(const Work& w, const Agreement& a) {
  return log10_false_alarms(static_cast<int>(w.all.size()), static_cast<int>(a.inliers.size()), 7, 3,
                            std::sqrt(2) * a.cut * w.line_chance);
}

/// The homography, refined on its inliers, and which matches those are.
struct Plane {
  Matrix3d H = Matrix3d::Zero();
  std::vector<double> d2;  ///< of all matches
  std::vector<int> inliers;
  bool found = false;
};

Plane refine_plane(const Work& w, const Matrix3d& H, double cut) {
  Plane plane;
  plane.H = H;
  for (int round = 0; round < 10 && plane.H.norm() > 0; ++round) {
    const Matrix3d H_inverse = plane.H.inverse();
    const std::vector<int> before = plane.inliers;
    plane.inliers.clear();
    plane.d2.clear();
    for (std::size_t i = 0; i < w.all.size(); ++i) {
      plane.d2.push_back(transfer_distance2(plane.H, H_inverse, w.all[i]));
      if (plane.d2.back() < cut * cut) plane.inliers.push_back(static_cast<int>(i));
    }
    plane.found = plane.inliers.size() >= 8;
    if (!plane.found || plane.inliers == before) break;
    plane.H = homography_of(chosen(w.all, plane.inliers)).value_or(plane.H);
  }
  return plane;
}

/// Torr's GRIC of a model of dimension d with k parameters over residuals r^2 / sigma^2.
double gric(const std::vector<double>& r2, double d, double k) {
  double sum = 0;
  for (const double v : r2) sum += std::min(v, 2 * (4 - d));
  const auto n = static_cast<double>(r2.size());
  return sum + d * n * std::log(4) + k * std::log(4 * n);
}

/// Whether a homography describes F's inliers better than F, its parameters counted.
bool plane_preferred(const Work& w, const Matrix3d& F, const Plane& plane, const std::vector<int>& inliers,
                     double noise) {
  if (!plane.found) return false;
  std::vector<double> r2_F, r2_H;
  for (const int i : inliers) {
    r2_F.push_back(std::pow(sampson_distance(F, w.all[i]) / noise, 2));
    r2_H.push_back(plane.d2[i] / (noise * noise));
  }
  return gric(r2_H, 2, 8) < gric(r2_F, 3, 7);
}

/// False alarms of the epipole: of the matches clearly off the plane, how many agree on it. What noise moves
/// off the plane agrees with every epipole, so clearly means twice the cut.
double parallax_false_alarms(const Work& w, const Plane& plane, const Agreement& a, double cut) {
  if (!plane.found) return -std::numeric_limits<double>::infinity();
  const auto clear = [&](int i) { return plane.d2[i] > 4 * cut * cut; };
  int off = 0;
  for (int i = 0; i < static_cast<int>(w.all.size()); ++i) off += clear(i) ? 1 : 0;
  const auto agree = static_cast<int>(std::count_if(a.inliers.begin(), a.inliers.end(), clear));
  return log10_false_alarms(off, agree, 2, 1, std::sqrt(2) * cut * w.line_chance);
}

/// Deviation of the line of `a` where parallax has moved its point to either side of the place on it nearest
/// to b.
double sigma_with_parallax(const FundamentalMl& ml, const Eigen::Vector2d& a, const Eigen::Vector2d& b,
                           double reach) {
  const Eigen::Vector3d l = ml.F * a.homogeneous();
  const Eigen::Vector2d along = Eigen::Vector2d(-l.y(), l.x()).normalized() * reach;
  return std::max(line_sigma(ml.F, ml.covariance, a, b + along),
                  line_sigma(ml.F, ml.covariance, a, b - along));
}

/// Median, over the inliers, of that of their own lines; what only a plane tells is not known there.
double line_sigma_at_parallax(const Work& w, const FundamentalMl& ml, const std::vector<int>& inliers) {
  std::vector<double> sigma;
  const std::size_t step = 1 + inliers.size() / 200;
  for (std::size_t i = 0; i < inliers.size(); i += step) {
    const Match& m = w.all[inliers[i]];
    sigma.push_back(sigma_with_parallax(ml, m.a, m.b, kParallax * w.radius_px));
  }
  return median(sigma);
}

void take_inliers(const Work& w, const std::vector<int>& inliers, TwoViewEstimate& e) {
  e.inliers = static_cast<int>(inliers.size());
  for (const int i : inliers) e.inlier[w.index[i]] = true;
}

/// The status that a plane leaves when the epipole is not to be had.
void settle_for_plane(const Work& w, const Plane& plane, double noise, TwoViewEstimate& e) {
  const bool turned = is_rotation(plane.H, chosen(w.all, plane.inliers), noise);
  e.status = turned ? TwoViewStatus::rotation : TwoViewStatus::planar;
  e.H = plane.H;
  take_inliers(w, plane.inliers, e);
}

}  // namespace

const char* name_of(TwoViewStatus status) {
  switch (status) {
    case TwoViewStatus::ok:
      return "ok";
    case TwoViewStatus::planar:
      return "planar";
    case TwoViewStatus::rotation:
      return "rotation";
    case TwoViewStatus::undetermined:
      break;
  }
  return "undetermined";
}

TwoViewEstimate estimate_two_view(const Matches& matches, const TwoViewOptions& options) {
  TwoViewEstimate e;
  Work w = prepare(matches, options);
  e.inlier.assign(matches.size(), false);
  e.distinct = static_cast<int>(w.all.size());
  if (e.distinct < 8) {
    e.reason = fmt::format("{} different matches; 8 are the least that can agree on an F", e.distinct);
    return e;
  }
  const Search s = search(w, options);
  e.samples = s.samples;
  Agreement a;
  auto ml = maximise(w, s.candidates, options.gold_standard, a);
  for (int doubled = 0;
       doubled < 2 && ml && options.threshold_px == 0 && kCutSigmas * a.noise >= w.threshold_px; ++doubled) {
    Work wider = w;
    wider.threshold_px *= 2;
    Agreement more;
    const auto next = maximise(wider, {ml->F}, options.gold_standard, more);
    if (!next || !(false_alarms(wider, more) < false_alarms(w, a))) break;
    w = wider;
    ml = next;
    a = more;
  }
  const double least = kLeastNoise * w.radius_px;
  const double noise = ml ? std::max(least, ml->noise_px) : w.threshold_px / kCutSigmas;
  const double cut = std::min(kCutSigmas * noise, w.threshold_px);
  const Plane plane = refine_plane(w, s.H, cut);
  const int n = e.distinct;
  const double plane_alarms =
      plane.found ? log10_false_alarms(n, int(plane.inliers.size()), 4, 1, 2 * cut * cut * w.point_chance)
                  : 0;
  bool plane_decides = !ml;
  e.on_plane = static_cast<int>(plane.inliers.size());
  if (ml) {
    e.ml = *ml;
    e.H = plane.H;
    const double alarms = false_alarms(w, a);
    e.line_sigma_px = noise * line_sigma_at_parallax(w, *ml, a.inliers);
    e.plane_preferred = plane_preferred(w, ml->F, plane, a.inliers, noise);
    const double parallax = parallax_false_alarms(w, plane, a, cut);
    plane_decides = e.plane_preferred || parallax > kLog10ParallaxFalseAlarms;
    if (alarms > kLog10FalseAlarms)
      e.reason = fmt::format("{} of {} matches agree, which as many wrong ones could", a.inliers.size(), n);
    else if (parallax > kLog10ParallaxFalseAlarms)
      e.reason = fmt::format("{} of {} matches lie on a plane, and the others do not agree on an epipole",
                             plane.inliers.size(), n);
    else if (!(e.line_sigma_px <= options.most_line_sigma * w.radius_px))
      e.reason = fmt::format("the matches leave epipolar lines uncertain by {:.2g} px", e.line_sigma_px);
    else if (on_conic_through_epipole(chosen(w.all, a.inliers), ml->F, noise))
      e.reason = "the points lie on a line, or on a conic through the epipole, which leaves F free";
    else
      e.status = TwoViewStatus::ok;
  } else {
    e.reason = "no F has the agreement of 8 matches";
  }
  if (e.status == TwoViewStatus::ok) {
    take_inliers(w, a.inliers, e);
    double sum_sq = 0;
    for (const int i : a.inliers) sum_sq += std::pow(sampson_distance(e.ml.F, w.all[i]), 2);
    e.sampson_rms_px = std::sqrt(sum_sq / e.inliers);
  } else if (plane_alarms < kLog10FalseAlarms && plane_decides) {
    settle_for_plane(w, plane, noise, e);
  }
  return e;
}

}  // namespace stuv
