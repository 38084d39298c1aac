#pragma once

#include <Eigen/Dense>
#include <vector>

#include "calib/board/detect.h"
#include "core/progress.h"
#include "core/recording.h"

namespace stuv {

struct FoundCorners {
  std::vector<std::vector<BoardView>> views;  ///< [set][camera], in the recording's orders
  std::vector<Eigen::Vector2i> size_px;       ///< of each camera's pictures; 0 if it has none
  int pictures = 0;                           ///< that were looked at or remembered
  int boards = 0;                             ///< of them with a board
  int remembered = 0;                         ///< answered from REC/corners
};

/// Finds the board in all good frames of a recording, frames in parallel (detect_board).
///
/// What was found, or that nothing was, is kept in REC/corners/BOARD/SET/CAMERA.json with the picture's size
/// on disk and time of change; while these and kDetectorVersion stay the same the picture is not opened
/// again. A recording that cannot be written to is used without, with one warning. Throws Error naming the
/// file if a picture cannot be read, or the camera if the size of its pictures changes.
FoundCorners find_corners(const Recording& recording, const Board& board, const Reporter& reporter = {});

/// Weights of a view's corners for the solve: hypot(sigma_ref, f) / hypot(sigma, f), 0 where none was seen,
/// with sigma_ref the median over all views, so that a usual corner weighs 1 and the noise of the solve is
/// that of such a one; f = kSolveFloorPx for what lens model and board add to any corner.
inline constexpr double kSolveFloorPx = 0.05;  ///< plain rms of array20's residuals
std::vector<double> corner_weights(const BoardView& view, double sigma_ref_px);
double median_sigma_px(const FoundCorners& found);

}  // namespace stuv
