#pragma once

#include <Eigen/Dense>
#include <map>
#include <optional>
#include <utility>

#include "calib/board/refine.h"

namespace stuv {

/// Corners of a chessboard by integer places (i, j) that count from anywhere.
using CornerGrid = std::map<std::pair<int, int>, Eigen::Vector2d>;

/// What a chessboard's squares look like in this picture.
struct SquareColours {
  /// Of four squares around corner (i, j): the one towards (+i, +j) is dark if i + j + dark_parity is even.
  int dark_parity = 0;
  double contrast = 0;  ///< bright minus dark, median over the corners
  double bright = 0;    ///< median of the bright squares
};

/// From the corners themselves; contrast 0 if they are no chessboard's.
SquareColours square_colours(const CornerImage& image, const CornerGrid& grid);

/// The darker bright square around a corner minus the brighter dark one, a third of a step from it; NaN if
/// one lies outside of the picture. `dark_first`: the square towards +i, +j (and -i, -j) is a dark one.
double square_contrast(const CornerImage& image, const Eigen::Vector2d& at, const Eigen::Vector2d& step_i,
                       const Eigen::Vector2d& step_j, bool dark_first);

/// Where the corner at (i, j) should be, from the corners beside it along rows and columns: 3 a - 3 b + c, or
/// 2 a - b, mean over the sides that have them. Nothing if none has.
std::optional<Eigen::Vector2d> predicted(const CornerGrid& grid, int i, int j);

/// Steps to the next corners along i and j at (i, j), from the corners near it.
bool steps_at(const CornerGrid& grid, int i, int j, Eigen::Vector2d& step_i, Eigen::Vector2d& step_j);

/// Radius of refine_corner's window: `share` of the height of a parallelogram with these sides, 2 to 10 px.
/// For a chessboard's squares, no other corner's edges are then in it.
inline constexpr double kSquareShare = 0.45;
double window_radius(const Eigen::Vector2d& step_i, const Eigen::Vector2d& step_j,
                     double share = kSquareShare);

/// Detectors may take every second row or column of corners for the grid: where the points halfway between
/// neighbours are corners too, they become part of it and places along that axis count double.
void fill_skipped(const CornerImage& image, CornerGrid& grid);

/// Adds corners outwards while there are some, up to `most` along a side.
void grow_grid(const CornerImage& image, const SquareColours& colours, int most, CornerGrid& grid);

}  // namespace stuv
