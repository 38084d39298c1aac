#pragma once

#include <vector>

#include "calib/solve/joint_solve.h"

namespace stuv {

/// What is in the residuals beside noise. Each `.._px` is the rms of a mean over cells, views or sets with
/// the part that noise alone would make taken out; each `.._ratio` is the root mean square of that mean over
/// the deviation that noise would give it: about 1 where there is only noise.
struct ResidualStructure {
  /// By position in the picture, 12 x 8 cells of each camera: the lens model does not fit.
  struct ByCamera {
    double position_px = 0, position_ratio = 0;
    double noise_px = 0;  ///< what is left within the views, see below
  };
  std::vector<ByCamera> cameras;
  double position_px = 0, position_ratio = 0;
  /// Means of views: frames of one set that were not taken together see a moving board at different places.
  double view_px = 0, view_ratio = 0;
  /// Slopes of views' residuals along the rows, times half the view's height: a rolling shutter shears and
  /// stretches a moving board.
  double row_px = 0, row_ratio = 0;
  struct BySet {
    int set = 0;
    double rms_px = 0, view_px = 0;  ///< view_px: rms of its views' means
  };
  std::vector<BySet> sets;

  static constexpr double kWorthPx = 0.1, kClear = 3;  ///< what is worth a word, and no chance
  /// Views of one set show the board at places that differ by more than noise.
  bool frames_apart() const { return view_px > kWorthPx && view_ratio > kClear; }
  /// Boards are sheared or stretched along the rows.
  bool rows_apart() const { return row_px > kWorthPx && row_ratio > kClear; }
};

/// Noise is what an affine function of the position leaves of each view's residuals.
ResidualStructure residual_structure(const Observations& observations, const JointSolution& solution);

/// What a camera has seen of the boards.
struct Coverage {
  int boards = 0, inliers = 0, outliers = 0;
  double rms_px = 0;                   ///< over x and y; NaN without inliers
  double hull = 0;                     ///< hull of all its corners over the picture
  double cells = 0;                    ///< part of 8 x 6 cells of the picture with a corner
  double tilt_rad = 0;                 ///< the largest angle between two of its boards' normals
  Eigen::Vector2d empty = {0.5, 0.5};  ///< middle of the emptiest ninth of its picture, 0 to 1
  bool has_empty = false;              ///< a ninth without any corner
};
Coverage coverage_of(const Observations& observations, const JointSolution& solution, int camera);

}  // namespace stuv
