#include "calib/solve/set_weights.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/median.h"

namespace stuv {
namespace {

/// Deviation of each set's weighted residuals, robustly; NaN for sets with too few.
std::vector<double> set_noise(const Observations& in, const JointSolution& s) {
  constexpr std::size_t kLeast = 100;
  constexpr double kMadOfSigma = 0.6745;
  std::vector<std::vector<double>> sizes(in.set_names.size());
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    const BoardObservation& b = in.boards[i];
    for (std::size_t k = 0; k < s.residuals_px[i].size(); ++k) {
      const Eigen::Vector2d& r = s.residuals_px[i][k];
      const double weight = (b.weights.empty() ? 1 : b.weights[k]) * s.camera_weight[b.camera];
      if (r.allFinite())
        sizes[b.set].insert(sizes[b.set].end(), {weight * std::abs(r.x()), weight * std::abs(r.y())});
    }
  }
  std::vector<double> noise(sizes.size(), std::nan(""));
  for (std::size_t set = 0; set < sizes.size(); ++set) {
    if (sizes[set].size() < kLeast) continue;
    noise[set] = median(std::move(sizes[set])) / kMadOfSigma;
  }
  return noise;
}

}  // namespace

bool reweight_sets(const JointSolution& s, Observations& in) {
  constexpr double kWorth = 1.5, kFloorPx = 0.02;
  const std::vector<double> noise = set_noise(in, s);
  std::vector<double> sorted;
  for (const double n : noise)
    if (std::isfinite(n)) sorted.push_back(n);
  if (sorted.size() < 3) return false;
  const double usual = std::hypot(median(std::move(sorted)), kFloorPx);
  bool any = false;
  for (BoardObservation& b : in.boards) {
    const double above = std::hypot(noise[b.set], kFloorPx) / usual;
    if (!(above > kWorth)) continue;
    b.weights.resize(b.corners_px.size(), 1);
    for (double& weight : b.weights) weight /= above;
    any = true;
  }
  return any;
}

}  // namespace stuv
