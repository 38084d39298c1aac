#pragma once

#include <Eigen/Dense>
#include <vector>

#include "calib/board/board.h"

namespace stuv {

/// A marker's black square in the board's frame [m], by its number; a chessboard has none.
std::vector<Eigen::AlignedBox2d> marker_boxes(const Board& board);

/// All that is black, as rectangles in the board's frame [m] that do not overlap; of an inverted board all
/// that is white. Tags are turned as Kalibr prints them, OpenCV's markers as OpenCV does.
std::vector<Eigen::AlignedBox2d> dark_areas(const Board& board);

/// Whether the square (or tag, or small square) that lies towards +x, +y of a corner is black, before
/// inversion. The one towards -x, -y is as it is, and the two others are not.
bool dark_towards_origin_and_away(const Board& board, int point);

/// How far around a corner there is nothing but its two edges [m].
double corner_clearance_m(const Board& board);

}  // namespace stuv
