#pragma once

#include "calib/photometry/estimate_photometry.h"
#include "calib/solve/observations.h"
#include "core/progress.h"
#include "core/recording.h"
#include "core/rig.h"

namespace stuv {

/// What a picture stores in the middle of a quadrilateral (corners in order around it): the mean of its inner
/// two fifths. Nothing if that is small, not flat, masked, reaches out of the picture or has a pixel at
/// either end of the range.
std::optional<std::array<double, 3>> flat_value(const Image& image, double white,
                                                const std::array<Eigen::Vector2d, 4>& quad);

/// Photometry from the black and white squares of boards: a square in one frame set is one surface under one
/// light for all cameras, if the board is matt: where cameras still differ by more than 1 % after the best
/// fit, none is determined. Looks at no more than `most_sets` sets, those that most cameras saw. `rig`:
/// cameras in the order of the observations'. Throws Error if a picture cannot be read.
Photometry photometry_from_boards(const Recording& recording, const Observations& observations,
                                  const Rig& rig, const Reporter& reporter = {}, int most_sets = 12);

}  // namespace stuv
