#pragma once

#include <string>
#include <vector>

#include "calib/two_view/match.h"
#include "core/progress.h"
#include "core/recording.h"
#include "core/rig.h"

namespace stuv {

// What the pictures of one frame set say about where the cameras stand, without asking the rig.

/// A point of the scene and where cameras see it.
struct SceneTrack {
  std::vector<int> camera;  ///< of the rig
  std::vector<Eigen::Vector2d> at_px;
};

/// Matches of two cameras that agree with some geometry of two views, whichever.
struct ScenePair {
  int a = 0, b = 0;
  Matches matches;  ///< [px]
};

struct SceneSight {
  bool present = false;   ///< a picture of the right size that shows something
  std::string problem;    ///< why not
  bool mirrored = false;  ///< matches only once its picture is flipped; its places are then those of the
                          ///< flipped picture
  int features = 0;
  double level = 0;  ///< mean of the picture as stored, 0..1
};

struct SceneEvidence {
  std::vector<SceneSight> cameras;  ///< of the rig, in its order
  std::vector<ScenePair> pairs;
  std::vector<SceneTrack> tracks;
};

struct EvidenceOptions {
  int most_features = 3000;  ///< a picture
  int neighbours = 6;        ///< every camera is matched with so many that stand nearest
  int least_matches = 20;    ///< below it a pair says nothing
  std::uint64_t seed = 1;
};

/// SIFT in every picture; neighbours by the rig are matched and verified by estimate_two_view; matches are
/// joined to tracks where no camera sees one twice. A camera that finds fewer than a third of what is usual
/// is tried again with its picture flipped, and if it finds next to nothing, with all other cameras: it may
/// have been swapped. Throws Error if a picture cannot be read.
SceneEvidence find_evidence(const Recording& recording, const FrameSet& set, const Rig& rig,
                            const EvidenceOptions& options = {}, const Reporter& reporter = {});

/// Joins the pairs' matches to tracks. Places that are equal are one feature.
std::vector<SceneTrack> tracks_of(const std::vector<ScenePair>& pairs);

}  // namespace stuv
