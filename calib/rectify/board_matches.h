#pragma once

#include "calib/rectify/common_view.h"
#include "calib/rectify/neighbour_matches.h"
#include "core/recording.h"
#include "core/rig.h"

namespace stuv {

/// Board corners that `calibrate` kept with the recording (REC/corners), as matches of neighbouring views:
/// the exact positions that the lens model gives them, so no picture is looked at. Empty if none were kept
/// for this set.
std::vector<ViewMatch> board_matches(const Recording& recording, const FrameSet& set, const Rig& rig,
                                     const CommonView& common, const LightField& lf);

}  // namespace stuv
