#pragma once

#include "calib/solve/joint_solve.h"
#include "calib/solve/observations.h"

namespace stuv {

/// Boards that were blurred, overexposed or moving are noisier than their corners' own sigmas know. With
/// sigma the robust deviation (median / 0.6745) of a set's weighted residuals in `solution`, usual the median
/// over the sets and f = 0.02 px, errors that sharp sets have in common and that weighing them more does not
/// average out:
///
///   w <- w hypot(usual, f) / hypot(sigma, f)   for sets where that is less than 1 / 1.5
///
/// Whether there is such a set; none of fewer than three with 50 corners each.
bool reweight_sets(const JointSolution& solution, Observations& observations);

}  // namespace stuv
