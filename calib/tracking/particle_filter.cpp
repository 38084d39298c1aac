#include "calib/tracking/particle_filter.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace stuv::tracking {

std::vector<double> normalised_weights(const std::vector<Particle>& particles) {
  double most = -std::numeric_limits<double>::infinity();
  for (const Particle& p : particles)
    if (std::isfinite(p.log_weight)) most = std::max(most, p.log_weight);
  std::vector<double> weights(particles.size(),
                              particles.empty() ? 0.0 : 1.0 / static_cast<double>(particles.size()));
  if (!std::isfinite(most)) return weights;
  double sum = 0;
  for (std::size_t i = 0; i < particles.size(); ++i) {
    const double l = particles[i].log_weight;
    weights[i] = std::isfinite(l) ? std::exp(l - most) : 0;
    sum += weights[i];
  }
  for (double& w : weights) w /= sum;
  return weights;
}

double effective_number(const std::vector<double>& weights) {
  double sum_sq = 0;
  for (const double w : weights) sum_sq += w * w;
  return sum_sq > 0 ? 1 / sum_sq : 0;
}

std::vector<Particle> resample(const std::vector<Particle>& particles, const std::vector<double>& weights,
                               int count, double offset) {
  std::vector<Particle> drawn;
  drawn.reserve(count);
  std::size_t i = 0;
  double sum = weights.empty() ? 0 : weights[0];
  for (int k = 0; k < count && !particles.empty(); ++k) {
    const double at = (k + offset) / count;
    while (sum <= at && i + 1 < particles.size()) sum += weights[++i];
    drawn.push_back(particles[i]);
    drawn.back().log_weight = 0;
  }
  return drawn;
}

double particles_for(int bins) {
  if (bins <= 1) return 1;
  const double k = bins - 1, z99 = 2.326, a = 2 / (9 * k), root = 1 - a + std::sqrt(a) * z99;
  return k / (2 * 0.05) * root * root * root;
}

}  // namespace stuv::tracking
