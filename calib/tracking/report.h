#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calib/tracking/sequence.h"
#include "calib/tracking/tracker.h"
#include "core/json.h"

namespace stuv::tracking {

/// A tracked sequence, for reports.
struct Track {
  std::vector<SequenceFrame> frames;
  std::vector<TrackedFrame> tracked;       ///< of each frame
  std::vector<std::optional<Pose>> truth;  ///< of each frame; empty if there is no truth
};

/// How far a pose is from the truth: |t - t_true| [m] and the angle of R R_true^T [rad].
struct PoseError {
  double translation_m = 0, rotation_rad = 0;
};
PoseError pose_error(const Pose& pose, const Pose& truth);

/// The contents of --json: options, counts, time of each stage, one object a frame.
Json track_json(const Track& track);

/// One page that needs nothing else: components of the pose, residuals (against the truth where there is
/// one), effective number of particles and matched edges over the frames; lost frames are shaded.
std::string track_page(const Track& track);

}  // namespace stuv::tracking
