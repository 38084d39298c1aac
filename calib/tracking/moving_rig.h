#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "calib/solve/calibrate.h"
#include "core/progress.h"

namespace stuv::tracking {

/// One picture of a camera that moves past a still scene, with its tracked pose.
struct MovingFrame {
  std::string name;
  std::filesystem::path file;
  Pose cam_from_scene;
};

struct MovingOptions {
  double most_off_lattice = 0.35;  ///< of a chosen frame from its lattice point, in spacings
  double least_filled = 0.9;       ///< part of the lattice's points that must have a frame
  int keypoints = 700;             ///< a frame
  double prior_part = 0.05;        ///< sigma of a tracked centre, by the sweep's extent
  double most_rms_px = 1;          ///< beyond it the verdict is not good
  double most_slipped = 0.1;       ///< part of the tracked poses that may lie elsewhere than the pictures say
};

/// A rig from the frames of one moving camera.
///
/// Matches SIFT keypoints between each frame and the frames nearest to it, and adjusts poses and points
/// together (moving_adjust.h), the lens kept as it is, tracked poses as priors of `prior_part` of the sweep's
/// extent; scale and place are those of the tracked poses. Then chooses, among the frames that share a dozen
/// points with others, those that make the largest lattice (of those whose points are filled to
/// `least_filled` by frames within `most_off_lattice`; every frame, if all stand on one) and fits plane and
/// lattice (fit_layout). The rig holds the chosen frames only, with the covariance of their centres after
/// rigid alignment: of the adjustment, and of the scale. Not good, with reasons, if there are too few matches
/// or residuals are large. Throws Error with fewer than 2 frames, if a picture cannot be read, or if no
/// lattice can be chosen.
Calibration calibrate_moving(const std::vector<MovingFrame>& frames, const Camera& camera,
                             const MovingOptions& options = {}, const Reporter& reporter = {});

/// Which frames make a lattice, and where: indices into `cam_from_scene`, with row and col. Empty if fewer
/// than 2 do.
struct LatticeChoice {
  std::vector<int> frames, row, col;
  int rows = 0, cols = 0;
};
LatticeChoice choose_lattice(const std::vector<Pose>& cam_from_scene, const MovingOptions& options = {});

}  // namespace stuv::tracking
