#pragma once

#include <Eigen/Dense>
#include <vector>

#include "calib/board/board.h"
#include "calib/board/refine.h"

namespace stuv {

/// A chessboard's inner corners row by row, to about a pixel: NaN where none was seen, empty if there is
/// none.
///
/// Whole boards: OpenCV's findChessboardCornersSB (Duda, Frese, "Accurate Detection and Localization of
/// Checkerboard Corners for Calibration", BMVC 2018), plain, then exhaustive. Else, a part of the board: SB's
/// largest grid, grown corner by corner where a crossing of the right colours lies within reach of what its
/// neighbours predict. Which part of the board it is must be certain, or there is no board: along each axis
/// it spans the whole board, or exactly one of its ends is hidden, which it is where the next row of corners
/// would lie outside the picture.
///
/// Where the colours tell the board's two orders apart, the first inner square (between corners 0, 1 of rows
/// 0, 1) is a dark one; else (Board::is_ambiguous) the order is one of two. Corners run right-handed: never
/// mirrored.
std::vector<Eigen::Vector2d> detect_chessboard(const CornerImage& image, const Board& board);

}  // namespace stuv
