#pragma once

#include <memory>

#include "capture/source.h"
#include "capture/synthetic/board.h"
#include "capture/synthetic/render.h"
#include "capture/synthetic/rig.h"
#include "capture/synthetic/scene.h"

namespace stuv::synthetic {

struct SyntheticOptions {
  RigOptions rig;
  SensorOptions sensor;
  BoardOptions board;
  SceneOptions scene;
  int board_sets = 10;  ///< named board00, board01, ...
  int scene_sets = 1;   ///< named scene00, ...; come after the boards
  std::int64_t set_interval_ns = 33'333'333;
};

/// "" if the options can be used, else the setting ("rig.rows ...") and the constraint it breaks.
std::string problem_of(const SyntheticOptions& options);

/// Poses of the boards of all board sets, as the source takes them.
std::vector<Pose> board_poses(const SyntheticOptions& options);

/// The synthetic rig as a source. A camera's time is the set's (its number times the interval) plus its skew;
/// time counts from the first scene set for the ball, and boards stand still.
///
/// Beside the frames it writes REC/truth/: rig.json and cameras/NAME.cameramodel (a rig folder, in the frame
/// of the nominal lattice), boards.json (board, its pose and exact corner pixels per set and camera),
/// exposures.json (gains, offset, vignetting, time skew), depth/SET/NAME.pfm (Z along each camera's axis
/// [m]). Throws std::invalid_argument if problem_of() has one.
std::unique_ptr<Source> open_synthetic(const SyntheticOptions& options);

}  // namespace stuv::synthetic
