#pragma once

#include <Eigen/Dense>
#include <filesystem>
#include <limits>
#include <string>
#include <vector>

#include "core/camera.h"
#include "core/json.h"

namespace stuv {

// A rig is a folder: rig.json, cameras/NAME.cameramodel (mrcal's format), report.json, report.html.
//
// Its frame is the camera plane's: origin at the mean of the camera centres, x (= s) along the rows to the
// right, y (= t) down, z into the scene, all as the cameras look at it. A centre is therefore (s, t, w), w
// the remainder off the plane.

struct RigCamera {
  Camera camera;
  int row = 0, col = 0;  ///< on the lattice: col grows with s, row with t
  bool determined = true;
  /// Centre minus its lattice point (s, t) and minus the plane (w) [m].
  Eigen::Vector3d off_lattice_m = Eigen::Vector3d::Zero();
  /// NaN where it is not known.
  Eigen::Vector3d position_sigma_m = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
};

struct Rig {
  std::vector<RigCamera> cameras;
  int rows = 0, cols = 0;
  /// Lattice: point (row, col) lies at origin + col * s_step + row * t_step, in the plane [m]; a single row
  /// has t_step 0, a single column s_step 0.
  Eigen::Vector2d lattice_origin_m = Eigen::Vector2d::Zero();
  Eigen::Vector2d s_step_m = Eigen::Vector2d::Zero(), t_step_m = Eigen::Vector2d::Zero();
  double rms_off_plane_m = 0;
  /// Distance of the nearest and farthest board corner from the plane [m]: the depths the calibration has
  /// seen.
  double nearest_seen_m = 0, farthest_seen_m = 0;
  /// Covariance of all centres, (3 n) x (3 n), s t w of each determined camera in order [m^2]; empty if
  /// unknown.
  Eigen::MatrixXd centre_covariance_m2;
  Json produced_by;  ///< inputs, settings and versions

  int camera_index(const std::string& name) const;  ///< -1 if there is none
};

Rig read_rig(const std::filesystem::path& folder);
/// Writes rig.json and the camera models into an existing folder.
void write_rig(const std::filesystem::path& folder, const Rig& rig);

}  // namespace stuv
