#include "calib/lattice_places.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/median.h"

namespace stuv {
namespace {

/// From each point to the one nearest to it.
std::vector<Eigen::Vector2d> to_nearest(const std::vector<Eigen::Vector2d>& points) {
  std::vector<Eigen::Vector2d> nearest;
  for (std::size_t i = 0; i < points.size(); ++i) {
    Eigen::Vector2d best = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
    for (std::size_t j = 0; j < points.size(); ++j)
      if (i != j && (points[j] - points[i]).squaredNorm() < best.squaredNorm()) best = points[j] - points[i];
    nearest.push_back(best);
  }
  return nearest;
}

double median_length(const std::vector<Eigen::Vector2d>& steps) {
  std::vector<double> lengths;
  for (const Eigen::Vector2d& step : steps) lengths.push_back(step.norm());
  return median(std::move(lengths));
}

/// Rank of each value's cluster, where sorted neighbours further apart than `gap` part clusters.
std::vector<int> cluster_ranks(const std::vector<double>& values, double gap, int& count) {
  std::vector<std::size_t> order(values.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return values[a] < values[b]; });
  std::vector<int> ranks(values.size(), 0);
  int rank = 0;
  for (std::size_t k = 1; k < order.size(); ++k) {
    if (values[order[k]] - values[order[k - 1]] > gap) ++rank;
    ranks[order[k]] = rank;
  }
  count = rank + 1;
  return ranks;
}

}  // namespace

LatticePlaces places_on_lattice(const std::vector<Eigen::Vector2d>& points) {
  std::vector<double> x, y;
  for (const Eigen::Vector2d& p : points) x.push_back(p.x()), y.push_back(p.y());
  const double gap = points.size() > 1 ? 0.5 * median_length(to_nearest(points)) : 1.0;
  LatticePlaces places;
  places.col = cluster_ranks(x, gap, places.cols);
  places.row = cluster_ranks(y, gap, places.rows);
  return places;
}

double lattice_angle(const std::vector<Eigen::Vector2d>& points) {
  if (points.size() < 2) return 0;
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& step : to_nearest(points)) {
    const double angle = 4 * std::atan2(step.y(), step.x());
    sum += Eigen::Vector2d(std::cos(angle), std::sin(angle));
  }
  return std::atan2(sum.y(), sum.x()) / 4;
}

}  // namespace stuv
