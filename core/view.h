#pragma once

#include <limits>
#include <string>
#include <vector>

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

/// What `fast` may leave out. Each can be switched off alone.
struct Skips {
  bool empty_planes = true;   ///< planes on which the coarse pass finds nothing anywhere
  bool tile_planes = true;    ///< planes on which it finds nothing near a tile
  bool flat_tiles = true;     ///< tiles that look the same on every plane
  bool tile_margins = true;   ///< pixels beside a tile: windows end at its border
  bool colour_costs = true;   ///< two of three channels: costs are those of the brightness
  bool idle_cameras = true;   ///< cameras without weight
  bool second_filter = true;  ///< the wide filter, where the skipped one already rules a plane out
  bool unread_tiles = true;   ///< tiles of the database that no ray reaches
  bool previous_view = true;  ///< the coarse pass, where the picture before tells what is to be expected
};

/// The paper's parameters, with its values as defaults.
struct RenderOptions {
  int planes = 13;                   ///< N
  int window = 7;                    ///< M: the window has (2M + 1)^2 pixels
  double a01 = 1, a02 = 1, a12 = 0;  ///< a_kl of equation 5; filters are numbered normal, wide, skipped
  Filter k = Filter::normal;         ///< the filter of the picture, equation 8
  double d_min = 0, d_max = 0;       ///< disparity of the farthest and the nearest plane [px per unit of s]
  Skips skips;                       ///< of method `fast`
};

/// Work that was left out, and why.
struct Skipped {
  std::string reason;
  double fraction = 0;  ///< of the work of that kind
};

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
    /// Work that cannot be avoided, for comparison with what the machine could do at best; 0 where it is not
    /// counted: multiply-adds of the filters' differences, bytes of the views and of the result, texels
    /// fetched.
    double multiply_adds = 0, bytes = 0, texels = 0;
    /// Time of parts of the work, where they are measured.
    std::vector<std::pair<std::string, double>> stages_ms;
    /// What was not computed, per reason, as a part of what there was to do (`fast`).
    std::vector<Skipped> skipped;
  } statistics;
};

}  // namespace stuv
