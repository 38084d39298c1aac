#pragma once

#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "calib/solve/ghosting.h"
#include "calib/solve/joint_solve.h"
#include "calib/solve/lattice.h"
#include "calib/solve/own_lens.h"
#include "calib/solve/residual_structure.h"
#include "calib/solve/uncertainty.h"
#include "calib/solve/validation.h"
#include "core/json.h"
#include "core/progress.h"
#include "core/recording.h"
#include "core/rig.h"

namespace stuv {

struct CalibrationOptions {
  SolveOptions solve;              ///< `known` lenses by name: see calibrate
  int most_folds = 10;             ///< sets left out in turn for the cross-validation; 0: no validation
  double most_rms_px = 0.5;        ///< beyond it the verdict is not good
  double most_sigma = 0.1;         ///< of a centre in spacings: beyond it a camera is not determined
  double most_focal_sigma = 0.02;  ///< of a focal length, relative: the same
  double most_projection_px = 5;   ///< one sigma, median over the picture at the boards' distance: the same
  double most_ghosting_px = 0.5;   ///< at the depths boards were seen at; beyond it a note
  double least_coverage = 0.05;    ///< part of its picture that a camera's corners must span
};

struct CameraSummary {
  int boards = 0, inliers = 0, outliers = 0;
  double rms_px = 0;    ///< over x and y; NaN without inliers
  double coverage = 0;  ///< hull of all its corners over the picture
  Eigen::Vector2d focal_sigma_px = {0, 0};
  Eigen::MatrixXd lens_covariance;  ///< of its parameters; empty where unknown or held
  /// About s, t, w, after rigid alignment of the centres (rigidly_aligned_poses); NaN where not determined.
  Eigen::Vector3d rotation_sigma_rad = Eigen::Vector3d::Constant(std::nan(""));
  double noise_px = 0;              ///< of its corners, as the solve weighed them
  std::string undetermined;         ///< why it is not determined; empty if it is
  Coverage seen;                    ///< what of its picture the boards filled
  std::vector<ProjectionMap> maps;  ///< of determined cameras, at Calibration::map_distances_m
};

struct Calibration {
  Observations observations;  ///< in the order of corners that was solved with
  JointSolution solution;
  Lens lens = Lens::opencv4;  ///< of the solution
  bool lenses_alike = false;  ///< lens_likeness had a part in it
  Layout layout;
  LatticeSigma lattice_sigma;
  Rig rig;
  std::vector<CameraSummary> cameras;
  std::optional<double> cross_validation_px;
  std::optional<Validation> validation;
  ResidualStructure structure;
  /// Where the structure says that frames of a set were not taken together and lenses are free; else empty.
  std::vector<OwnLens> own_lenses;
  /// By what sigmas of places, turns and of what pictures show were multiplied: ResidualStructure::view_ratio
  /// where frames were not taken together and SigmaScale could not be measured.
  double place_scale = 1;
  std::vector<double> map_distances_m;
  /// Of the determined cameras, even in 1/z, from half the distance of the nearest board corner to infinity.
  std::vector<Ghosting> ghosting;
  bool good = false;
  std::vector<std::string> reasons;  ///< why it is not good
  std::vector<std::string> notes;    ///< what is worth knowing though the verdict does not hang on it
  std::vector<std::string> advice;   ///< what to record next, most useful first
};

/// The whole chain from corners to rig: camera_groups, seed_solve, joint_solve, validation, fit_layout,
/// uncertainty, verdict (judge).
///
/// Cameras that see no board, or share none with the largest group of cameras, are in the result, not
/// determined, at no place. Views with fewer than 6 corners take no part.
/// Centres' covariance is that after rigid alignment: C = s^2 P C_ref P, with P the projection off the six
/// rigid motions of the determined centres and s = JointSolution::sigma_px; turned into the rig's frame.
/// Throws Error if fewer than 6 corners of every view are there, or a wanted lens is not known.
Calibration calibrate(Observations observations, const Recording& recording,
                      const CalibrationOptions& options = {}, const Reporter& reporter = {});

/// The depths [m] between which all of `ghosting` stays within most_px, the longest such stretch in 1/z.
struct DepthRange {
  double from_m = 0, to_m = 0;  ///< to_m may be infinity
};
std::optional<DepthRange> good_range(const std::vector<Ghosting>& ghosting, double most_px);
inline constexpr double kFinePx = 0.1;  ///< ghosting that nobody sees
/// The ghosting in a sentence; empty where there is none to speak of.
std::string ghosting_text(const std::vector<Ghosting>& ghosting);

/// Covariance after rigid alignment of the centres on their true places: takes the six directions of rigid
/// motion out of both sides of `covariance` (3 n x 3 n).
Eigen::MatrixXd rigidly_aligned(const Eigen::MatrixXd& covariance,
                                const std::vector<Eigen::Vector3d>& centres);

}  // namespace stuv
