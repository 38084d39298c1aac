#include "calib/two_view/match_noise.h"

#include <algorithm>
#include <cmath>

#include "calib/two_view/fundamental.h"
#include "calib/two_view/maximum_likelihood.h"

namespace stuv {
namespace {

constexpr double kHeavyTails = 2;      ///< nu of the second shape
constexpr double kLogOddsOfHeavy = 2;  ///< by which its likelihood must be greater
constexpr double kStill = 1e-4;        ///< change of the log likelihood that ends the rounds

/// log t_nu(r / s) / s without what only depends on nu and s, and that.
struct Density {
  double freedom, inverse2, constant;
  explicit Density(const MatchNoise& noise)
      : freedom(noise.freedom), inverse2(1 / (noise.scale_px * noise.scale_px)) {
    const double nu = freedom;
    constant = std::isinf(nu) ? -0.5 * std::log(2 * M_PI)
                              : std::lgamma((nu + 1) / 2) - std::lgamma(nu / 2) - 0.5 * std::log(nu * M_PI);
    constant -= std::log(noise.scale_px);
  }
  double operator()(double r) const {
    const double u2 = r * r * inverse2;
    return std::exp(constant -
                    (std::isinf(freedom) ? 0.5 * u2 : 0.5 * (freedom + 1) * std::log1p(u2 / freedom)));
  }
  /// psi(r) / r and psi', s^2 times: 1 for a Gaussian.
  double weight(double r) const {
    return std::isinf(freedom) ? 1 : (freedom + 1) / (freedom + r * r * inverse2);
  }
  double slope(double r) const {
    if (std::isinf(freedom)) return 1;
    const double u2 = r * r * inverse2;
    return (freedom + 1) * (freedom - u2) / ((freedom + u2) * (freedom + u2));
  }
};

/// Matches in coordinates of about 1, both pictures at one scale.
struct Unit {
  Similarity2 Ta, Tb;
  Matches matches;
  explicit Unit(std::span<const Match> in) {
    std::tie(Ta, Tb) = normalisation(in);
    Ta.scale = Tb.scale = std::sqrt(Ta.scale * Tb.scale);
    for (const Match& m : in) matches.push_back({Ta * m.a, Tb * m.b});
  }
  Eigen::Matrix3d from_px(const Eigen::Matrix3d& F) const {
    return closest_rank2(Tb.matrix().transpose().inverse() * F * Ta.matrix().inverse());
  }
  Eigen::Matrix3d to_px(const Eigen::Matrix3d& F) const {
    return unit_scale(Tb.matrix().transpose() * F * Ta.matrix());
  }
};

/// The expectation, and the noise's maximisation for the residuals r [px].
void expect(const std::vector<double>& r, std::span<const double> counts, double most_px, NoiseFit& fit) {
  const Density density(fit.noise);
  double log_likelihood = 0;
  for (std::size_t i = 0; i < r.size(); ++i) {
    const double in = std::abs(r[i]) < most_px ? fit.noise.right * density(r[i]) : 0;
    const double all = in + (1 - fit.noise.right) * fit.noise.anywhere_per_px;
    fit.right[i] = all > 0 ? in / all : 0;
    fit.weight[i] = counts[i] * fit.right[i] * density.weight(r[i]);
    log_likelihood += counts[i] * std::log(std::max(all, 1e-300));
  }
  fit.log_likelihood = log_likelihood;
}

void maximise_noise(const std::vector<double>& r, std::span<const double> counts, double least_px,
                    NoiseFit& fit) {
  double total = 0, right = 0, sum_sq = 0;
  for (std::size_t i = 0; i < r.size(); ++i) {
    total += counts[i];
    right += counts[i] * fit.right[i];
    sum_sq += fit.weight[i] * r[i] * r[i];
  }
  fit.noise.scale_px = std::max(least_px, std::sqrt(sum_sq / std::max(1.0, right - 7)));
  fit.noise.right = std::min(0.999, (right + 1) / (total + 2));
}

void state_sigma(const std::vector<double>& r, std::span<const double> counts, NoiseFit& fit) {
  const Density density(fit.noise);
  double n = 0, psi2 = 0, slope = 0;
  for (std::size_t i = 0; i < r.size(); ++i) {
    if (!(fit.right[i] > 0.5)) continue;
    ++n;
    psi2 += std::pow(fit.weight[i] * r[i], 2);
    slope += counts[i] * fit.right[i] * density.slope(r[i]);
  }
  fit.sigma_px =
      n > 7 && slope > 0 ? std::sqrt(psi2 / (n - 7)) / (slope / n) : std::numeric_limits<double>::quiet_NaN();
}

}  // namespace

NoiseFit fit_noise(std::span<const Match> matches, std::span<const double> counts, const Eigen::Matrix3d& F,
                   const MatchNoise& start, double least_px, double most_px, int rounds) {
  NoiseFit fit;
  fit.noise = start;
  fit.right.resize(matches.size());
  fit.weight.resize(matches.size());
  const Unit unit(matches);
  Eigen::Matrix3d N = unit.from_px(F);
  std::vector<double> r(matches.size());
  double before = -std::numeric_limits<double>::infinity();
  for (int round = 0;; ++round) {
    for (std::size_t i = 0; i < r.size(); ++i) r[i] = sampson_distance(N, unit.matches[i]) / unit.Ta.scale;
    expect(r, counts, most_px, fit);
    if (round >= rounds || (round > 3 && std::abs(fit.log_likelihood - before) < kStill)) break;
    before = fit.log_likelihood;
    maximise_noise(r, counts, least_px, fit);
    N = refine_sampson(unit.matches, fit.weight, N, 2);
  }
  state_sigma(r, counts, fit);
  fit.F = unit.to_px(N);
  return fit;
}

NoiseFit fit_noise_and_shape(std::span<const Match> matches, std::span<const double> counts,
                             const Eigen::Matrix3d& F, const MatchNoise& start, double least_px,
                             double most_px, int rounds) {
  MatchNoise gaussian = start, heavy = start;
  gaussian.freedom = std::numeric_limits<double>::infinity();
  heavy.freedom = kHeavyTails;
  NoiseFit a = fit_noise(matches, counts, F, gaussian, least_px, most_px, rounds);
  NoiseFit b = fit_noise(matches, counts, F, heavy, least_px, most_px, rounds);
  b.log_likelihood -= kLogOddsOfHeavy;
  return b.log_likelihood > a.log_likelihood ? b : a;
}

}  // namespace stuv
