#pragma once

#include <vector>

#include "calib/solve/observations.h"
#include "core/pose.h"

namespace stuv {

/// Where the joint solve starts.
struct Seed {
  std::vector<double> focal_px;      ///< of each camera
  std::vector<Pose> cam_from_ref;    ///< of each camera; ref is camera 0
  std::vector<Pose> ref_from_board;  ///< of each set; those without a board stay the identity
};

/// First guesses from boards alone: focal lengths in closed form from the boards' homographies (pooled over
/// cameras with pictures of one size, principal point in the middle), board poses by solvePnP, camera poses
/// along the tree of those pairs that share most boards.
///
/// With w = 1/f^2, centred pixels and H = [h1 h2 h3]: h1^T W h2 = 0, h1^T W h1 = h2^T W h2, W = diag(w, w, 1)
/// (Zhang, PAMI 2000, with the principal point known): two linear equations in w a view, least squares.
///
/// A relative pose is the one of its boards' that agrees best with the others. Where the board is ambiguous,
/// both orders of its corners are candidates, and corners in `observations` are brought into one order a set.
/// Throws Error naming the cameras if a camera sees no board, or if cameras fall into groups that share none;
/// std::invalid_argument if indices or counts of corners do not fit.
Seed seed_solve(Observations& observations);

}  // namespace stuv
