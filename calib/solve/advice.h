#pragma once

#include <string>
#include <vector>

#include "calib/solve/calibrate.h"

namespace stuv {

/// Where to hold the board next, in words, most useful first; empty where nothing is worth recording.
///
/// Candidates: boards in front of the rig at the nearest and the farthest depth seen, over a 3 x 3 grid of
/// the middle camera's picture, facing the rig or tilted by 35 degrees about either axis. Each one's worth is
/// by how much the mean variance of the cameras' pictures would fall (projection_map's, over a 3 x 3 grid at
/// the boards' middle distance), were it seen by those cameras whose picture holds it whole:
///
///   S' = S - S J^T (s^2 I + J S J^T)^-1 J S,   J: its corners by lenses and poses, its own pose projected
///   out
///
/// Then what cameras lack by themselves: single boards, parallel boards, empty parts of pictures.
std::vector<std::string> advice_for(const Calibration& calibration);

}  // namespace stuv
