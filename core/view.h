#pragma once

#include <limits>
#include <string>

#include "core/pose.h"
#include "core/raster.h"

namespace stuv {

/// The virtual camera, in the light field's frame: a pinhole
///   x_px = cx_px + focal_px * X / Z in its own axes.
struct Viewpoint {
  double s = 0, t = 0, z = 0;  ///< centre, in the scene's unit; z > 0 is towards the scene
  Eigen::Matrix3d view_from_scene = Eigen::Matrix3d::Identity();
  double focal_px = 0, cx_px = 0, cy_px = 0;
  int width = 0, height = 0;
};

/// The reconstruction filters of the paper's figure 7.
enum class Filter { normal = 0, wide = 1, skipped = 2 };

struct RenderedView {
  ImageF colour;
  /// Per pixel, of the chosen plane: its disparity [px per unit of s] and its number (0 is the farthest); -1:
  /// none.
  ImageF disparity;
  Raster<int> plane;
  /// 0..1; 0 outside the hull of the cameras and where no camera sees the point.
  ImageF confidence;

  struct Statistics {
    double milliseconds = 0;
    /// (pixel, plane) costs computed over pixels x N.
    double evaluated_fraction = 1;
  } statistics;
};

}  // namespace stuv
