#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "core/pose.h"

namespace stuv {

/// One camera: a lens model of mrcal's by name, its parameters, picture size and pose.
struct Camera {
  std::string name;
  /// "LENSMODEL_PINHOLE", "LENSMODEL_OPENCV4", "LENSMODEL_OPENCV8", "LENSMODEL_SPLINED_STEREOGRAPHIC_..."
  std::string lens_model = "LENSMODEL_PINHOLE";
  /// fx, fy, cx, cy [px], then the model's distortion parameters.
  std::vector<double> intrinsics;
  int width = 0, height = 0;
  Pose cam_from_rig;
};

/// Points in the camera's frame [m] to pixels (mrcal's lens models).
std::vector<Eigen::Vector2d> project(const Camera& camera, const std::vector<Eigen::Vector3d>& points_cam);
/// Pixels to directions in the camera's frame, of unit length.
std::vector<Eigen::Vector3d> unproject(const Camera& camera, const std::vector<Eigen::Vector2d>& pixels);

/// Throws Error (naming `subject`) unless the model is known to mrcal, has its number of parameters, all
/// finite, and the size is positive.
void validate(const Camera& camera, const std::string& subject);

/// mrcal's .cameramodel text: lens model, intrinsics, size, pose (rotation vector and translation from the
/// reference frame, here the rig's).
Camera read_cameramodel(const std::filesystem::path& file);
void write_cameramodel(const std::filesystem::path& file, const Camera& camera);

}  // namespace stuv
