#include "calib/photometry/board_samples.h"

#include <algorithm>
#include <cmath>
#include <mutex>

#include "calib/photometry/stored.h"
#include "core/image_io.h"
#include "core/parallel.h"

namespace stuv {
namespace {

Eigen::Vector2d inside(const std::array<Eigen::Vector2d, 4>& quad, double u, double v) {
  return (1 - v) * ((1 - u) * quad[0] + u * quad[1]) + v * ((1 - u) * quad[3] + u * quad[2]);
}

/// Of each camera's set the samples; points are numbered by square.
std::vector<PhotometricSample> squares_of(const Image& image, const Board& board,
                                          const BoardObservation& seen, int first_point) {
  std::vector<PhotometricSample> samples;
  const double white = white_level(image);
  const auto there = [&](int k) { return seen.weights.empty() || seen.weights[k] > 0; };
  for (int r = 0; r + 1 < board.rows; ++r)
    for (int c = 0; c + 1 < board.columns; ++c) {
      const int k = r * board.columns + c, below = k + board.columns;
      if (!there(k) || !there(k + 1) || !there(below) || !there(below + 1)) continue;
      const std::array<Eigen::Vector2d, 4> quad = {seen.corners_px[k], seen.corners_px[k + 1],
                                                   seen.corners_px[below + 1], seen.corners_px[below]};
      if (const auto value = flat_value(image, white, quad))
        samples.push_back({seen.camera, first_point + k, inside(quad, 0.5, 0.5), *value});
    }
  return samples;
}

/// Sets by how many cameras saw the board in them, the earlier first.
std::vector<int> best_sets(const Observations& observations, int most) {
  std::vector<int> seen(observations.set_names.size(), 0), sets;
  for (const BoardObservation& b : observations.boards) ++seen[b.set];
  for (std::size_t s = 0; s < seen.size(); ++s)
    if (seen[s] > 1) sets.push_back(static_cast<int>(s));
  std::stable_sort(sets.begin(), sets.end(), [&](int a, int b) { return seen[a] > seen[b]; });
  if (static_cast<int>(sets.size()) > most) sets.resize(most);
  return sets;
}

}  // namespace

std::optional<std::array<double, 3>> flat_value(const Image& image, double white,
                                                const std::array<Eigen::Vector2d, 4>& quad) {
  constexpr double kInner = 0.4, kLeastSize_px = 8, kMostDeviation = 0.03;  // of stored values
  const double size = std::min({(quad[1] - quad[0]).norm(), (quad[2] - quad[1]).norm(),
                                (quad[3] - quad[2]).norm(), (quad[0] - quad[3]).norm()});
  if (!(size >= kLeastSize_px)) return std::nullopt;
  const int n = std::clamp(static_cast<int>(std::lround(kInner * size)), 3, 16);
  std::array<double, 3> sum = {0, 0, 0}, sum_sq = {0, 0, 0};
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const double u = 0.5 + kInner * ((i + 0.5) / n - 0.5), v = 0.5 + kInner * ((j + 0.5) / n - 0.5);
      const Eigen::Vector2d q = inside(quad, u, v);
      const auto x = static_cast<int>(std::lround(q.x())), y = static_cast<int>(std::lround(q.y()));
      const auto stored = stored_at(image, white, x, y);
      if (!stored) return std::nullopt;
      for (int c = 0; c < image.channels; ++c) {
        sum[c] += (*stored)[c];
        sum_sq[c] += (*stored)[c] * (*stored)[c];
      }
    }
  for (int c = 0; c < image.channels; ++c) {
    sum[c] /= n * n;
    if (sum_sq[c] / (n * n) - sum[c] * sum[c] > kMostDeviation * kMostDeviation) return std::nullopt;
  }
  return sum;
}

Photometry photometry_from_boards(const Recording& recording, const Observations& observations,
                                  const Rig& rig, const Reporter& reporter, int most_sets) {
  const std::vector<int> sets = best_sets(observations, most_sets);
  std::vector<int> first_point(observations.set_names.size(), -1);
  for (std::size_t i = 0; i < sets.size(); ++i)
    first_point[sets[i]] = static_cast<int>(i) * observations.board.corners();
  std::vector<const BoardObservation*> jobs;
  for (const BoardObservation& b : observations.boards)
    if (first_point[b.set] >= 0 && rig.cameras[b.camera].determined) jobs.push_back(&b);
  std::vector<std::vector<PhotometricSample>> found(jobs.size());
  std::vector<int> channels(jobs.size());
  std::mutex mutex;
  std::size_t done = 0;
  parallel_for(static_cast<int>(jobs.size()), [&](int i) {
    const BoardObservation& b = *jobs[i];
    const Image image = read_image(recording.sets[b.set].frames[b.camera].file);
    channels[i] = image.channels;
    found[i] = squares_of(image, observations.board, b, first_point[b.set]);
    const std::lock_guard lock(mutex);
    reporter.at("comparing brightness", ++done, jobs.size());
  });
  // Grey pictures among those in colour say nothing of the colours.
  const int most = jobs.empty() ? 1 : *std::max_element(channels.begin(), channels.end());
  std::vector<PhotometricSample> samples;
  for (std::size_t i = 0; i < jobs.size(); ++i)
    if (channels[i] == most) samples.insert(samples.end(), found[i].begin(), found[i].end());
  std::vector<Camera> cameras;
  for (const RigCamera& rc : rig.cameras) cameras.push_back(rc.camera);
  PhotometryOptions options;
  options.most_spread = 0.01;
  return estimate_photometry(samples, cameras, most, "boards", options);
}

}  // namespace stuv
