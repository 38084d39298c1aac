#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

namespace stuv {

struct RansacOptions {
  double threshold_px = 3;  ///< residuals from here on count as outliers
  double confidence = 0.99;
  int least_samples = 0, most_samples = 2000;
  std::uint64_t seed = 1;
  bool local_optimisation = true;
};

template <class Model>
struct RansacResult {
  Model model;
  bool found = false;
  /// Sum over all matches of (1 - v)^2, v = min(1, (residual / threshold)^2): inliers, the exact ones
  /// counting most.
  double support = 0;
  int inliers = 0;  ///< residuals below the threshold
  int samples = 0;  ///< how many were drawn
};

/// Samples of `size` that it takes to meet one of inliers only with probability `confidence`:
/// log(1 - confidence) / log(1 - w^size), rounded up. At most `most`.
inline int samples_needed(double w, int size, double confidence, int most = std::numeric_limits<int>::max()) {
  const double good = std::pow(w, size);
  if (good >= 1) return 1;
  const double n = std::ceil(std::log1p(-confidence) / std::log1p(-good));
  return n < most ? std::max(1, static_cast<int>(n)) : most;
}

/// Small, fast, the same on every machine (std's distributions are not): SplitMix64, Steele and others,
/// OOPSLA 2014.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}
  std::uint64_t operator()() {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
    z = (z ^ (z >> 27)) * 0x94d049bb133111eb;
    return z ^ (z >> 31);
  }
  /// 0 .. n - 1
  int below(int n) { return static_cast<int>(((*this)() >> 32) * static_cast<std::uint64_t>(n) >> 32); }
  /// `N` different numbers below n >= N.
  template <std::size_t N>
  void sample(int n, std::array<int, N>& out) {
    for (std::size_t i = 0; i < N;) {
      out[i] = below(n);
      if (std::find(out.begin(), out.begin() + i, out[i]) == out.begin() + i) ++i;
    }
  }

 private:
  std::uint64_t state_;
};

/// RANSAC (Fischler, Bolles 1981) with a smooth truncated cost, local optimisation of every new best (Chum,
/// Matas, Kittler 2003) and adaptive stopping by samples_needed. Same seed, same result. `Problem` has
///
///   Model; kSampleSize; kMostModels
///   int size()                                                number of matches
///   int solve(const array<int, kSampleSize>&, array<Model, kMostModels>&)   models through a sample
///   double cost(const Model&, double bail)                    sum of 1 - (1 - v)^2; may stop above `bail`
///   int inliers(const Model&)
///   Model refine(const Model&)                                local optimisation
template <class Problem>
RansacResult<typename Problem::Model> ransac(const Problem& problem, const RansacOptions& options) {
  RansacResult<typename Problem::Model> best;
  const int n = problem.size();
  if (n < Problem::kSampleSize) return best;
  Random random(options.seed);
  double best_cost = n;
  const auto consider = [&](const typename Problem::Model& model) {
    const double cost = problem.cost(model, best_cost);
    if (!(cost < best_cost)) return false;
    best_cost = cost;
    best.model = model;
    return best.found = true;
  };
  std::array<int, Problem::kSampleSize> sample{};
  std::array<typename Problem::Model, Problem::kMostModels> models;
  int needed = options.most_samples;
  for (; best.samples < needed; ++best.samples) {
    random.sample(n, sample);
    const int count = problem.solve(sample, models);
    bool better = false;
    for (int k = 0; k < count; ++k) better = consider(models[k]) || better;
    if (!better) continue;
    if (options.local_optimisation)
      while (consider(problem.refine(best.model)))
        if (best_cost < 1e-9 * n) break;
    best.inliers = problem.inliers(best.model);
    needed = std::max(options.least_samples, samples_needed(double(best.inliers) / n, Problem::kSampleSize,
                                                            options.confidence, options.most_samples));
  }
  best.support = n - best_cost;
  return best;
}

}  // namespace stuv
