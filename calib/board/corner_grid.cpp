#include "calib/board/corner_grid.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "core/median.h"

namespace stuv {
namespace {

using Place = std::pair<int, int>;

const Eigen::Vector2d* find(const CornerGrid& grid, int i, int j) {
  const auto it = grid.find({i, j});
  return it == grid.end() ? nullptr : &it->second;
}

/// Mean over 3 x 3 pixels; NaN outside of the picture.
double brightness(const CornerImage& image, const Eigen::Vector2d& at) {
  const int x = static_cast<int>(std::lround(at.x())), y = static_cast<int>(std::lround(at.y()));
  if (x < 1 || y < 1 || x + 1 >= image.luma.cols || y + 1 >= image.luma.rows) return std::nan("");
  return cv::mean(image.luma(cv::Rect(x - 1, y - 1, 3, 3)))[0];
}

/// The four squares around a corner, a third of a square from it: (+i, +j), (-i, -j), (+i, -j), (-i, +j).
struct Squares {
  double same[2], other[2];
};

Squares squares_around(const CornerImage& image, const Eigen::Vector2d& at, const Eigen::Vector2d& step_i,
                       const Eigen::Vector2d& step_j) {
  const Eigen::Vector2d a = (step_i + step_j) / 3, b = (step_i - step_j) / 3;
  return {{brightness(image, at + a), brightness(image, at - a)},
          {brightness(image, at + b), brightness(image, at - b)}};
}

/// Step along (di, dj) near (i, j), from corners up to two places away.
const Eigen::Vector2d* step_along(const CornerGrid& grid, int i, int j, int di, int dj,
                                  Eigen::Vector2d& step) {
  for (const int k : {0, -1, 1, -2})
    for (const int side : {0, -1, 1}) {
      const int ii = i + k * di + side * dj, jj = j + k * dj + side * di;
      const Eigen::Vector2d *a = find(grid, ii, jj), *b = find(grid, ii + di, jj + dj);
      if (a == nullptr || b == nullptr) continue;
      step = *b - *a;
      return &step;
    }
  return nullptr;
}

}  // namespace

bool steps_at(const CornerGrid& grid, int i, int j, Eigen::Vector2d& step_i, Eigen::Vector2d& step_j) {
  return step_along(grid, i, j, 1, 0, step_i) != nullptr && step_along(grid, i, j, 0, 1, step_j) != nullptr;
}

SquareColours square_colours(const CornerImage& image, const CornerGrid& grid) {
  std::vector<double> signed_contrast, bright;
  for (const auto& [place, at] : grid) {
    Eigen::Vector2d step_i, step_j;
    if (!steps_at(grid, place.first, place.second, step_i, step_j)) continue;
    const Squares s = squares_around(image, at, step_i, step_j);
    const double difference = 0.5 * (s.other[0] + s.other[1] - s.same[0] - s.same[1]);
    if (!std::isfinite(difference)) continue;
    signed_contrast.push_back((place.first + place.second) % 2 == 0 ? difference : -difference);
    bright.push_back(std::max(s.other[0] + s.other[1], s.same[0] + s.same[1]) / 2);
  }
  if (bright.empty()) return {1, 0, 0};
  const double contrast = median(signed_contrast);
  return {contrast > 0 ? 0 : 1, std::abs(contrast), median(bright)};
}

double square_contrast(const CornerImage& image, const Eigen::Vector2d& at, const Eigen::Vector2d& step_i,
                       const Eigen::Vector2d& step_j, bool dark_first) {
  const Squares s = squares_around(image, at, step_i, step_j);
  const double *dark = dark_first ? s.same : s.other, *bright = dark_first ? s.other : s.same;
  if (!std::isfinite(dark[0] + dark[1] + bright[0] + bright[1]))
    return std::numeric_limits<double>::quiet_NaN();
  return std::min(bright[0], bright[1]) - std::max(dark[0], dark[1]);
}

std::optional<Eigen::Vector2d> predicted(const CornerGrid& grid, int i, int j) {
  constexpr int kSides[4][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}};
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  int count = 0;
  for (const auto& side : kSides) {
    const auto* a = find(grid, i + side[0], j + side[1]);
    const auto* b = find(grid, i + 2 * side[0], j + 2 * side[1]);
    const auto* c = find(grid, i + 3 * side[0], j + 3 * side[1]);
    if (a == nullptr || b == nullptr) continue;
    sum += c != nullptr ? (3 * (*a - *b) + *c).eval() : (2 * *a - *b).eval();
    ++count;
  }
  if (count == 0) return std::nullopt;
  return sum / count;
}

double window_radius(const Eigen::Vector2d& step_i, const Eigen::Vector2d& step_j, double share) {
  constexpr double kLeastPx = 2, kMostPx = 10;
  const double area = std::abs(step_i.x() * step_j.y() - step_i.y() * step_j.x());
  const double height = area / std::max({step_i.norm(), step_j.norm(), 1e-9});
  return std::clamp(share * height, kLeastPx, kMostPx);
}

void fill_skipped(const CornerImage& image, CornerGrid& grid) {
  for (int axis = 0; axis < 2; ++axis) {
    CornerGrid doubled, halfway;
    int pairs = 0;
    for (const auto& [place, at] : grid) {
      const auto [i, j] = place;
      const Place here = axis == 0 ? Place(2 * i, j) : Place(i, 2 * j);
      doubled[here] = at;
      const Eigen::Vector2d* next = axis == 0 ? find(grid, i + 1, j) : find(grid, i, j + 1);
      Eigen::Vector2d step[2];
      if (next == nullptr || !steps_at(grid, i, j, step[0], step[1])) continue;
      ++pairs;
      step[axis] *= 0.5;
      const double radius = window_radius(step[0], step[1]);
      const auto corner = refine_corner(image, 0.5 * (at + *next), radius, 0.5 * radius);
      if (!corner) continue;
      const double contrast = std::max(square_contrast(image, *corner, step[0], step[1], true),
                                       square_contrast(image, *corner, step[0], step[1], false));
      constexpr double kLeastContrast = 10;
      if (contrast > kLeastContrast)
        halfway[axis == 0 ? Place(here.first + 1, j) : Place(i, here.second + 1)] = *corner;
    }
    if (2 * static_cast<int>(halfway.size()) <= pairs) continue;
    doubled.merge(halfway);
    grid = std::move(doubled);
  }
}

void grow_grid(const CornerImage& image, const SquareColours& colours, int most, CornerGrid& grid) {
  constexpr int kSides[4][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}};
  const double least_contrast = colours.contrast / 3;
  std::vector<Place> border;
  for (const auto& [place, at] : grid) border.push_back(place);
  while (!border.empty()) {
    CornerGrid added;
    for (const auto& [i0, j0] : border)
      for (const auto& side : kSides) {
        const int i = i0 + side[0], j = j0 + side[1];
        Eigen::Vector2d step_i, step_j;
        if (grid.contains({i, j}) || added.contains({i, j}) || std::abs(i) > most || std::abs(j) > most)
          continue;
        const std::optional<Eigen::Vector2d> start = predicted(grid, i, j);
        if (!start || !steps_at(grid, i, j, step_i, step_j)) continue;
        const double radius = window_radius(step_i, step_j);
        const auto corner =
            refine_corner(image, *start, radius, 0.3 * std::min(step_i.norm(), step_j.norm()));
        const bool dark_first = (i + j + colours.dark_parity) % 2 == 0;
        if (corner && square_contrast(image, *corner, step_i, step_j, dark_first) > least_contrast)
          added[{i, j}] = *corner;
      }
    border.clear();
    for (const auto& [place, at] : added) border.push_back(place);
    grid.merge(added);
  }
}

}  // namespace stuv
