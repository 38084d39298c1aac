#pragma once

#include <optional>
#include <vector>

#include "calib/solve/joint_solve.h"
#include "calib/solve/solve_difference.h"
#include "core/progress.h"

namespace stuv {

/// Boards that were left out of the solve, each fitted to it by its pose alone.
struct CrossValidation {
  int folds = 0, residuals = 0;  ///< x and y residuals; 0: no set could be left out
  double rms_px = 0;             ///< over all of them
  /// What rms_px should be by the corners' noise and the stated uncertainty (SigmaScale::scale times the
  /// covariance) of each fold's solve; NaN if unknown.
  double predicted_px = 0;
};

/// The lenses and places that either half of the sets alone gives.
struct HalfData {
  using Camera = SolveDifference::Camera;
  std::vector<Camera> cameras;  ///< that both halves solved
  /// Root mean square over cameras of difference over prediction, of those that both halves know to a pixel:
  /// 1 if corners' errors are independent; NaN if there is none.
  double lens_ratio = 0, centre_ratio = 0;
};

struct Validation {
  std::optional<CrossValidation> left_out;
  std::optional<HalfData> halves;
  SigmaScale sigma;
  /// Of each camera, the least relative sigma of its focal length in any solve without some of the sets,
  /// errors taken as independent; infinite where none solved it.
  std::vector<double> focal_sigma_without;
};

/// At most `most_folds` sets, evenly spread, are left out one at a time; and the even sets are solved against
/// the odd ones. All of these solves start from `solution`, without its outliers, and run in parallel.
Validation validate_solution(const Observations& observations, const JointSolution& solution,
                             const SolveOptions& options, int most_folds, const Reporter& reporter = {});

}  // namespace stuv
