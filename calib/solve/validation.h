#pragma once

#include <optional>
#include <vector>

#include "calib/solve/joint_solve.h"
#include "core/progress.h"

namespace stuv {

/// Boards that were left out of the solve, each fitted to it by its pose alone.
struct CrossValidation {
  int folds = 0, residuals = 0;  ///< x and y residuals; 0: no set could be left out
  double rms_px = 0;             ///< over all of them
  /// What rms_px should be by the corners' noise and the covariance of each fold's solve; NaN if unknown.
  double predicted_px = 0;
};

/// The lenses and places that either half of the sets alone gives.
struct HalfData {
  struct Camera {
    int camera = 0;
    /// rms over the picture of the two lenses' difference, but for what another pose of the camera could make
    /// up for at the boards' mean distance; and what it should be.
    double lens_px = 0, lens_predicted_px = 0;
    double centre_m = 0, centre_predicted_m = 0;  ///< after rigid alignment of the centres, the same
  };
  std::vector<Camera> cameras;  ///< that both halves solved
  /// Root mean square over cameras of difference over prediction, of those that both halves know to a pixel:
  /// 1 if the stated uncertainty is true; NaN if there is none.
  double lens_ratio = 0, centre_ratio = 0;
};

struct Validation {
  std::optional<CrossValidation> left_out;
  std::optional<HalfData> halves;
};

/// At most `most_folds` sets, evenly spread, are left out one at a time; and the even sets are solved against
/// the odd ones. All of these solves start from `solution`, without its outliers, and run in parallel.
Validation validate_solution(const Observations& observations, const JointSolution& solution,
                             const SolveOptions& options, int most_folds, const Reporter& reporter = {});

}  // namespace stuv
