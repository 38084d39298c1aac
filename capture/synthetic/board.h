#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "core/camera.h"
#include "core/raster.h"

namespace stuv::synthetic {

/// What is drawn on a board that is no chessboard, in its frame [m]. (The room does not know calibration
/// boards: the program fills this from calib/board/pattern.h.)
struct BoardPattern {
  std::vector<Eigen::AlignedBox2d> dark;  ///< that do not overlap
  Eigen::AlignedBox2d outline;            ///< of squares or tags
  bool inverted = false;                  ///< black and white exchanged
};

/// A chessboard, or what `pattern` says. Its frame: origin at the first inner corner, x along a row of
/// corners, y along a column, z away from the camera that sees x right and y down.
struct BoardOptions {
  /// Text of --board for a board that is no chessboard: then corners, size and pattern are those of that
  /// board.
  std::string spec;
  std::shared_ptr<const BoardPattern> pattern;
  int columns = 10, rows = 7;  ///< inner corners; of a pattern, its lattice
  double square_m = 0.04;
  double margin_squares = 0.5;  ///< white around the squares
  /// Bend: z = bend_x (1 - x_r^2) + bend_y (1 - y_r^2), where x_r, y_r run from -1 to 1 over the corners.
  std::array<double, 2> bend_m = {0, 0};
};

/// "" if the options can be used, else the value and the constraint it breaks.
std::string problem_of(const BoardOptions& board);

/// Inner corners in the board's frame [m], row by row, x fastest.
std::vector<Eigen::Vector3d> board_corners(const BoardOptions& board);

/// Exact pixels of the inner corners, in the order of board_corners; none are left out, so a corner may lie
/// outside the picture. NaN for corners that do not lie in front of the camera.
std::vector<Eigen::Vector2d> board_pixels(const BoardOptions& board, const Camera& camera,
                                          const Pose& rig_from_board);

/// Poses from which calibration is well conditioned: tilted to all sides, near and far, wandering over the
/// views, and each seen whole by at least four fifths of the cameras where the rig allows it.
std::vector<Pose> board_poses(const BoardOptions& board, const std::vector<Camera>& cameras, int count,
                              std::uint64_t seed);

/// The board in front of a plain backdrop, linear light, one channel.
///
/// Four samples a pixel, each the exact average over a box of its footprint's size aligned with the board, so
/// edges lie where they are to a few thousandths of a pixel and corners keep their symmetry.
ImageF render_board(const BoardOptions& board, const Camera& camera, const Pose& rig_from_board);

}  // namespace stuv::synthetic
