#pragma once

#include <Eigen/Dense>
#include <vector>

#include "calib/board/board.h"
#include "calib/board/refine.h"

namespace stuv {

/// Corners of a ChArUco board or an AprilGrid, by the markers that OpenCV's aruco module finds; points of the
/// lattice row by row, NaN where none was seen; empty if there is no board.
///
/// Every marker is a guess at the homography around it. A corner is predicted by its nearest marker, refined
/// (refine_corner, with a window inside of all other edges) and kept if the colours of its four squares are
/// right. How markers are turned in their squares plays no part, so tags may be printed as Kalibr or as
/// OpenCV turns them.
/// If more than a tenth of the markers are not where the others say, it is another board, and none.
std::vector<Eigen::Vector2d> detect_markers(const CornerImage& image, const Board& board);

}  // namespace stuv
