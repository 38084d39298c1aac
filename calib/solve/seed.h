#pragma once

#include <vector>

#include "calib/solve/observations.h"
#include "core/camera.h"
#include "core/pose.h"

namespace stuv {

/// What a seed takes lenses for.
enum class SeedLens {
  pinhole,       ///< r = f tan(theta)
  stereographic  ///< r = 2 f tan(theta / 2): fisheyes, up to 180 degrees and more
};

/// Where the joint solve starts.
struct Seed {
  SeedLens lens = SeedLens::pinhole;
  std::vector<double> focal_px;      ///< of each camera
  std::vector<Pose> cam_from_ref;    ///< of each camera; ref is camera 0
  std::vector<Pose> ref_from_board;  ///< of each set; those without a board stay the identity
  /// [observation][corner]: too far from the homography that most of its board's corners agree on.
  std::vector<std::vector<bool>> suspect;
};

/// First guesses from boards alone: focal lengths, board poses by solvePnP, camera poses along the tree of
/// those pairs that share most boards.
///
/// Gross outliers are left out first (least median of squares of the homography, in directions). Focal
/// lengths, pooled over cameras with pictures of one size, principal point in the middle. Pinhole, in closed
/// form: with w = 1/f^2, centred pixels and H = [h1 h2 h3]: h1^T W h2 = 0, h1^T W h1 = h2^T W h2,
/// W = diag(w, w, 1) (Zhang, PAMI 2000, with the principal point known): two linear equations in w a view,
/// least squares. Stereographic: the one under which boards are flattest, by search. `known` lenses, one a
/// camera or none, are taken as they are.
///
/// A relative pose is the one of its boards' that agrees best with the others. Where the board is ambiguous,
/// both orders of its corners are candidates, and corners in `observations` are brought into one order a set.
/// Throws Error naming a view with fewer than 6 finite corners; std::invalid_argument if indices or counts of
/// corners do not fit, or the cameras do not hang together (camera_groups).
Seed seed_solve(Observations& observations, SeedLens lens = SeedLens::pinhole,
                const std::vector<Camera>& known = {});

}  // namespace stuv
