#pragma once

#include <Eigen/Dense>
#include <optional>
#include <string>
#include <vector>

#include "calib/solve/calibrate.h"
#include "core/progress.h"
#include "core/recording.h"

namespace stuv {

/// What is known beforehand of an array that no board was shown to.
struct NoBoardOptions {
  /// Lenses, one a camera of the recording; empty: pinholes with one shared focal length, which is solved
  /// for, and the principal point in the middle.
  std::vector<Camera> lenses;
  /// Of each lens's parameters; empty, or of more than kMostLensStates: the lens is taken as exact.
  std::vector<Eigen::MatrixXd> lens_covariance;
  /// Scale: the distance of two cameras by name, or the spacing of the lattice [m].
  struct Distance {
    std::string a, b;
    double m = 0;
  };
  std::optional<Distance> distance;
  double spacing_m = 0;
  int most_features = 3000;  ///< a picture
  int reach = 2;             ///< pairs of cameras whose rows and columns differ by so much in sum are matched
  int most_points = 700;     ///< a set, of those that are followed through all pictures
  std::uint64_t seed = 1;
};

inline constexpr int kMostLensStates = 12;  ///< opencv8
/// What an ideal pixel moves by with a lens's uncertain directions, see SfmProblem::lens_root; padded with 0.
using LensSlope = Eigen::Matrix<double, 2, kMostLensStates>;

/// A point of the scene as the cameras see it, in ideal pixels: focal length `focal_px` for all, principal
/// point 0.
struct Track {
  std::vector<int> camera;
  std::vector<Eigen::Vector2d> at_px;
  std::vector<LensSlope> by_lens;  ///< of each at_px; empty: lenses are exact
  int set = 0;                     ///< of the recording
};

struct SfmProblem {
  int cameras = 0;
  double focal_px = 0;
  bool focal_known = true;
  std::vector<Track> tracks;
  /// Lenses that are known with a covariance: parameters = given ones + root y with y ~ N(0, I), one a
  /// camera. Empty: all exact; 0 columns: this one is.
  std::vector<Eigen::MatrixXd> lens_root;
  /// Poses to begin with, one a camera, and which of them are known; empty: none.
  std::vector<Pose> start;
  std::vector<bool> started;
};

/// Cameras and points up to a similarity; camera 0 of those placed is the reference.
struct SfmSolution {
  bool converged = false;
  std::vector<Pose> cam_from_ref;
  std::vector<bool> placed;
  std::vector<Eigen::Vector3d> points;    ///< NaN: not placed
  std::vector<std::vector<bool>> inlier;  ///< [track][observation]
  double focal_px = 0, focal_sigma_px = 0;
  using LensStates = Eigen::Matrix<double, kMostLensStates, 1>;
  std::vector<LensStates> lens;                  ///< y of each camera; 0 where lenses are exact
  std::vector<Eigen::MatrixXd> lens_covariance;  ///< of y; empty where lenses are exact
  int inliers = 0, outliers = 0;
  double rms_px = 0, worst_px = 0, noise_px = 0;
  std::vector<double> camera_rms_px;
  std::vector<int> camera_inliers;
  /// Of all centres, (3 n) x (3 n), in the reference frame; 0 for what is held.
  Eigen::MatrixXd centre_covariance;
};

/// From pairs to all cameras to one bundle adjustment:
///   1. where no start is given, the pair with the widest parallax among those with many tracks: F, E, pose;
///   points by
///      triangulation
///   2. camera after camera by its points (solvePnPRansac), new points, a bundle adjustment every time
///   3. minimise sum rho(|f pi(R_i (X_j - c_i)) - x_ij|^2) by Ceres, Huber first; then outliers beyond four
///      deviations out, and least squares; there x_ij is x_ij + by_lens_ij y_i where lenses are known with a
///      covariance, and noise^2 sum |y_i|^2 is added; the gauge held by camera 0 and the longest component of
///      one other centre
/// Covariance: of the centres from the last Jacobian, points eliminated, each track's errors taken as one
/// (sandwich).
SfmSolution solve_sfm(const SfmProblem& problem, std::uint64_t seed, const Reporter& reporter = {});

/// Tracks through all pictures of a recording: SIFT in every picture, pairs of neighbours matched and
/// verified by estimate_two_view (planar pairs count, by their homography), matches joined where no camera
/// sees a track twice; from these a first solution; from this every point sought in every picture
/// (refine_tracks), and once more from the solution that those give. All sets count, as pictures of one rig.
SfmProblem find_tracks(const Recording& recording, const NoBoardOptions& options,
                       const Reporter& reporter = {});

/// The whole chain to a rig, as `calibrate` does it from boards: layout, scale, covariance after a
/// similarity's alignment, verdict. Throws Error if neither scale is given or a name is unknown.
Calibration calibrate_without_board(const SfmProblem& problem, const Recording& recording,
                                    const NoBoardOptions& options, const Reporter& reporter = {});

}  // namespace stuv
