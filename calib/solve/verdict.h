#pragma once

#include "calib/solve/calibrate.h"
#include "calib/solve/groups.h"

namespace stuv {

/// Says of each camera why it is not determined, if it is not (CameraSummary::undetermined): it was not in
/// the solve; its lens hangs on one board, or on a whole and a cut one, or no solve without one of the sets
/// confirms it; focal length, or the pictures of points at the boards' distance, or its place among the
/// others are known too badly. Noise is taken as at least 0.02 px, however exact the corners happen to be.
/// The least determined place is taken out until the rest are: one loose camera makes the alignment, and so
/// all others, look loose.
void note_undetermined(Calibration& calibration, const CameraGroups& groups,
                       const CalibrationOptions& options);

/// Fills in good, reasons, notes and advice from all that is known.
void judge(Calibration& calibration, const Recording& recording, const CalibrationOptions& options);

}  // namespace stuv
