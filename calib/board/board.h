#pragma once

#include <Eigen/Dense>
#include <string>
#include <vector>

namespace stuv {

/// A chessboard. Its frame: origin at the first inner corner, x along a row of corners, y along a column, z
/// away from the camera that sees x right and y down.
struct Board {
  int columns = 0, rows = 0;  ///< inner corners
  double square_m = 0;

  int corners() const { return columns * rows; }
  /// Turned by 180 degrees the board looks the same when columns and rows are both even or both odd.
  bool is_ambiguous() const { return columns % 2 == rows % 2; }
};

/// Reads "chessboard:COLSxROWS:SIZE", inner corners, SIZE with its unit mm, cm or m: chessboard:28x17:20mm.
/// Throws Error naming the text unless COLS, ROWS >= 3 differ and SIZE > 0: a square board can be told
/// neither from itself turned by 90 degrees nor mirrored rows from columns.
Board parse_board(const std::string& spec);

/// The text that parse_board reads; one text for one board, whatever unit it was written in.
std::string board_spec(const Board& board);

/// Inner corners in the board's frame [m], row by row, x fastest.
std::vector<Eigen::Vector3d> board_points(const Board& board);

}  // namespace stuv
