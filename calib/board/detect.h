#pragma once

#include <Eigen/Dense>
#include <vector>

#include "calib/board/board.h"
#include "core/image.h"

namespace stuv {

/// Counts up when detect_board may answer otherwise for the same picture: corners that were kept by an older
/// version are looked for again.
inline constexpr int kDetectorVersion = 6;

/// A board in one picture.
struct BoardView {
  /// Of each of Board::corners() lattice points, NaN where none was seen; empty if there is no board.
  std::vector<Eigen::Vector2d> corners_px;
  /// Of each: deviation to be expected of x and of y, NaN where none was seen.
  std::vector<double> sigma_px;

  bool empty() const { return corners_px.empty(); }
  int seen() const;  ///< corners
};

/// Finds the board's corners in one picture, or nothing. Coordinates are finite and inside the picture.
///
/// - chessboard (detect_chessboard.h): whole ones by OpenCV's findChessboardCornersSB; ones that leave the
///   picture or are partly covered as far as it is certain which part is seen.
/// - charuco, aprilgrid (detect_markers.h): by their markers, any part.
///
/// All corners are then refined by symmetry (symmetric_corner.h); sigma_px is that of its residuals and
/// kCornerFloorPx, for what lens, paper and pixel raster add. So corners that are blurred, dark, dirty or
/// seen at a slant count less. At least six corners that do not lie in a line, or none.
BoardView detect_board(const Image& picture, const Board& board);

inline constexpr double kCornerFloorPx = 0.005;
}  // namespace stuv
