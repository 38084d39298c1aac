#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calib/check/evidence.h"
#include "calib/check/resection.h"
#include "core/json.h"
#include "core/rig.h"

namespace stuv {

enum class CheckStatus {
  ok,            ///< stands where the rig says
  moved,         ///< turned or shifted
  swapped_with,  ///< its pictures are what another camera sees
  mirrored,      ///< its pictures are flipped left to right (or, with `half_turn`, top to bottom)
  upside_down,   ///< its pictures are turned by half a turn
  missing,       ///< no picture, or one that shows nothing
  undetermined   ///< not known, because
};
const char* name_of(CheckStatus status);

struct CheckOptions {
  /// A camera has moved if its change is this unlikely by chance, chi^2 of 6 degrees of freedom (1e-6), and
  /// shifts its picture by more than `least_effect_px`, rms over the points it sees.
  double most_chi2 = 38.3;
  double least_effect_px = 0.5;
  double most_effect_sigma_px = 0.5;  ///< beyond it nothing is known of a camera
  double most_pair_px = 1.0;          ///< median Sampson distance from which on a pair disagrees with the rig
  double most_point_px = 3.0;         ///< residual with which a point of the trusted cameras is used
  double most_shift_sigma = 0.1;      ///< of the rig's spacing: beyond it a shift is not observable
  int least_points = 20;
};

struct CameraCheck {
  std::string name;
  CheckStatus status = CheckStatus::undetermined;
  std::string reason;      ///< of anything but ok, one line
  std::string partner;     ///< swapped_with: whose place it takes
  bool half_turn = false;  ///< of a mirrored picture: also turned by half a turn
  /// Change against the rig (see Resection), with its uncertainty: features, points, and the rig's own; none
  /// where no pose was found. `shift_known` false: the scene is too far off to tell a shift, the camera was
  /// taken to have turned only.
  std::optional<Resection> change;
  bool shift_known = false;
  /// What to put into the rig in its place, if the pictures tell: lens and pose.
  std::optional<Camera> corrected;
  double light = 1;  ///< mean level of its picture over the median of all cameras'
};

struct SceneCheck {
  std::vector<CameraCheck> cameras;  ///< in the rig's order
  std::vector<int> trusted;          ///< cameras that agree with each other and with the rig
  bool good = false;
  std::vector<std::string> reasons;  ///< why not
  std::vector<std::string> notes;
};

/// Which cameras stand where the rig says, from one frame set.
///
///   1. pairs whose matches lie off the epipolar lines that the rig predicts disagree; cameras that disagree
///      with half of their pairs are set aside, the worst first
///   2. each of the rest is resected from points of all others; the one with the largest significant change
///   is
///      set aside, until there is none: the rest is trusted. Three cameras do not tell which of them moved
///      along their line.
///   3. cameras that were set aside are explained: by another camera's lens and pose (swapped), by a flipped
///      or turned picture, or by a new pose from the points of the trusted
///
/// A rotation's prior is what boards leave it, the camera's position sigma over the depth that they were seen
/// at; a position's is its sigma; both twice as variance, for the camera and for those it is compared with.
SceneCheck check_rig(const SceneEvidence& evidence, const Rig& rig, const CheckOptions& options = {});

/// The rig with all that is corrected put in: lenses, poses, places on the lattice, sigmas.
Rig corrected_rig(const Rig& rig, const SceneCheck& check);

/// As docs/formats.md states it.
Json to_json(const CameraCheck& check);
Json to_json(const SceneCheck& check);

}  // namespace stuv
