#pragma once

#include <Eigen/Dense>
#include <vector>

#include "calib/board/board.h"
#include "core/image.h"

namespace stuv {

/// Counts up when detect_board may answer otherwise for the same picture: corners that were kept by an older
/// version are looked for again.
inline constexpr int kDetectorVersion = 1;

/// Finds the board's inner corners in one picture [px], row by row, or nothing.
///
/// OpenCV's findChessboardCornersSB (Duda, Frese, "Accurate Detection and Localization of Checkerboard
/// Corners for Calibration", BMVC 2018), exhaustive. It finds whole boards only. Where the colours tell the
/// board's two orders apart, the first inner square (between corners 0, 1 of rows 0, 1) is a dark one; else
/// (Board::is_ambiguous) the order is one of two. Corners run right-handed: never mirrored. Coordinates are
/// finite and inside the picture.
std::vector<Eigen::Vector2d> detect_board(const Image& picture, const Board& board);

}  // namespace stuv
