#pragma once

#include <Eigen/Dense>
#include <string>
#include <vector>

#include "calib/board/board.h"

namespace stuv {

/// One camera's view of the board in one frame set.
struct BoardObservation {
  int camera = 0, set = 0;
  std::vector<Eigen::Vector2d> corners_px;  ///< Board::corners() of them, row by row
  /// One per corner, 0 for a corner that is not there; empty means that all weigh 1.
  std::vector<double> weights;
};

/// All that a calibration is solved from.
struct Observations {
  Board board;
  std::vector<std::string> camera_names;
  std::vector<Eigen::Vector2i> size_px;  ///< of each camera's pictures
  std::vector<std::string> set_names;
  std::vector<BoardObservation> boards;
};

}  // namespace stuv
