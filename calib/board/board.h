#pragma once

#include <Eigen/Dense>
#include <string>
#include <vector>

namespace stuv {

/// A flat calibration board. All its corners are points of one lattice of `columns` x `rows` points,
/// `square_m` apart, which is what mrcal solves with; points that are no corner never have a weight.
///
/// Its frame: origin at the lattice's first point, x along a row, y along a column, z away from the camera
/// that sees x right and y down (the board upright). Point i is column i % columns, row i / columns.
///
/// - chessboard: the lattice is its inner corners.
/// - charuco: a chessboard of (columns + 1) x (rows + 1) squares with a marker in every white one, numbered
/// row
///   by row from the top left. The top left square is black; `legacy` is OpenCV's before 4.6, where it is
///   white if the number of rows of squares is even. `inverted`: black and white exchanged.
/// - aprilgrid: Kalibr's, tag_columns x tag_rows tags of family 36h11, numbered row by row from the BOTTOM
///   left, each tag_m wide with a border of two bits, and small black squares where the gaps cross. Tags'
///   corners lie at k (tag + gap) and k (tag + gap) + tag; with gap / tag = gap_steps / tag_steps that is a
///   lattice of square_m = tag_m / tag_steps.
struct Board {
  enum class Kind { chessboard, charuco, aprilgrid };
  Kind kind = Kind::chessboard;
  int columns = 0, rows = 0;  ///< of the lattice
  double square_m = 0;        ///< between points of the lattice
  // charuco
  double marker_m = 0;
  std::string dictionary;  ///< by OpenCV's name
  bool inverted = false, legacy = false;
  // aprilgrid
  int tag_columns = 0, tag_rows = 0;
  int tag_steps = 0, gap_steps = 0;

  int corners() const { return columns * rows; }  ///< points of the lattice
  bool has_corner(int point) const;
  int real_corners() const;
  double tag_m() const { return tag_steps * square_m; }
  /// Turned by 180 degrees the board looks the same: a chessboard with columns and rows both even or both
  /// odd.
  bool is_ambiguous() const { return kind == Kind::chessboard && columns % 2 == rows % 2; }
};

/// Reads one of
///   chessboard:COLSxROWS:SQUARE                                inner corners: chessboard:28x17:20mm
///   charuco:COLSxROWS:SQUARE:MARKER:DICT[:inverted][:legacy]   squares: charuco:5x7:40mm:30mm:DICT_4X4_50
///   aprilgrid:COLSxROWS:TAG:GAP                                tags: aprilgrid:6x6:88mm:0.3
/// or the path of a Kalibr target file (.yaml) with target_type aprilgrid or checkerboard. Lengths with their
/// unit mm, cm or m; GAP in tags (0.3, 3/10: Kalibr's tagSpacing) or a length. A GAP that is no fraction of
/// small numbers is replaced by one as near as 1e-5 tags.
///
/// Throws Error naming the text unless all is positive and fits together; a chessboard needs COLS, ROWS >= 3
/// that differ (a square one can be told neither from itself turned by 90 degrees nor mirrored rows from
/// columns), a ChArUco board a dictionary with enough markers, an AprilGrid at most 587 tags and a lattice of
/// at most kMostLatticePoints.
Board parse_board(const std::string& spec);

inline constexpr int kMostLatticePoints = 20000;

/// The text that parse_board reads; one text for one board, whatever unit it was written in.
std::string board_spec(const Board& board);

/// The lattice's points in the board's frame [m], row by row, x fastest.
std::vector<Eigen::Vector3d> board_points(const Board& board);

/// The outer squares or tags in the board's frame [m]: all that is black and white lies inside.
Eigen::AlignedBox2d board_outline(const Board& board);

}  // namespace stuv
