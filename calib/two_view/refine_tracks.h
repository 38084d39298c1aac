#pragma once

#include <span>
#include <vector>

#include "calib/two_view/no_board.h"
#include "core/raster.h"

namespace stuv {

/// One set's pictures, grey 0..1 (empty: none), and the lenses that took them.
struct SetPictures {
  int set = 0;
  std::span<const ImageF> grey;
  std::span<const Camera> lenses;
};

struct RefineTracksOptions {
  int most_points = 700;  ///< a set
  double noise_grey =
      0.01;  ///< of the pictures, 0..1: windows that it would move by most_sigma_px are not used
  double most_sigma_px = 0.1, most_shift_px = 4, least_ncc = 0.92;
};

/// The lens at `states` y: parameters + root y.
Camera with_states(Camera lens, const Eigen::MatrixXd& root, const SfmSolution::LensStates& states);

/// By how much the ideal pixel of a fixed pixel q of the picture moves with y (with_states): with d the
/// direction at depth 1 and q(lens, d),
///   dd = -(dq/dd)^-1 dq/dlens root dy
LensSlope lens_slope(const Camera& lens, const Eigen::MatrixXd& root, double focal_px,
                     const Eigen::Vector2d& ideal_px);

/// The points of a solution, looked for in every picture of their set that they should appear in: a window
/// around a whole pixel of the camera amid those that saw the point, laid on a plane of its depth that faces
/// that camera, seen through both lenses, and aligned (Window). Tracks get as long as the point is visible,
/// and their places agree to a few hundredths of a pixel, where features come at their own blur and among two
/// pictures only. Points are spread evenly over all pictures.
std::vector<Track> refine_tracks(const SetPictures& pictures, const SfmProblem& problem,
                                 const SfmSolution& solution, const RefineTracksOptions& options = {});

}  // namespace stuv
