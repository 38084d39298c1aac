#pragma once

#include <Eigen/Dense>
#include <vector>

#include "core/pose.h"
#include "core/rig.h"

namespace stuv {

/// A camera as the lattice fit sees it.
struct PlacedCamera {
  Pose cam_from_ref;
  int row = 0, col = 0;    ///< as the user laid the grid out
  bool determined = true;  ///< others are placed on the result but have no part in it
};

/// The camera plane with its lattice (core/rig.h states the frame).
struct Layout {
  bool converged = false;
  Pose rig_from_ref;
  int rows = 0, cols = 0;
  std::vector<int> row, col;  ///< of each camera: col grows with s, row with t
  bool as_recorded = true;    ///< false: the recorded grid does not fit the centres, which were counted anew
  Eigen::Vector2d origin_m = Eigen::Vector2d::Zero();
  Eigen::Vector2d s_step_m = Eigen::Vector2d::Zero(), t_step_m = Eigen::Vector2d::Zero();
  std::vector<Eigen::Vector3d> off_lattice_m;  ///< of each camera, in the rig's frame
  double rms_off_plane_m = 0;                  ///< over the determined cameras
};

/// Fits plane and lattice to the cameras' centres c_i.
///
///   minimise sum_i rho(|R (c_i - mean c) - (o + col_i s + row_i t, 0)|^2),   s = (s_x, 0), o, t in the plane
///
/// R: rig_from_ref, rho: Huber's, at a tenth of the spacing, so a camera that was pushed does not turn the
/// lattice. By Ceres, from an affine fit. A single row leaves a turn about itself free: there the mean of the
/// cameras' directions has no t component (a single column: no s component). z points where the cameras look,
/// s to their right: rows and columns recorded against that are counted from the other end. One camera gives
/// its own frame. Not converged if no camera is determined.
///
/// The recorded rows and columns are kept where they fit: every determined camera within half a spacing of
/// its lattice point, s within 45 degrees of the cameras' right. Where they do not, rows and columns are
/// counted along the centres (places_on_lattice), if those then fit with every camera on a place of its own.
Layout fit_layout(const std::vector<PlacedCamera>& cameras, int rows, int cols);

/// The rig's rows, columns, origin, steps and distance from the plane are the layout's.
void set_lattice(const Layout& layout, Rig& rig);

}  // namespace stuv
