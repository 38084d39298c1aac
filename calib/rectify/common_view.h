#pragma once

#include <optional>

#include "core/rig.h"

namespace stuv {

/// The pinhole that all rectified views share: axes of the rig's frame, so it looks straight off the camera
/// plane.
///   x_px = cx_px + focal_px X / Z
struct CommonView {
  double focal_px = 0, cx_px = 0, cy_px = 0;
  int width = 0, height = 0;
};

struct CommonViewOptions {
  enum class Field {
    mean,    ///< as large as one camera's, in the middle of all fields of view: parts lack at some borders
    common,  ///< the largest rectangle that every camera sees: nothing lacks
    all      ///< the smallest that holds whatever any camera sees
  };
  struct Crop {
    int x = 0, y = 0, width = 0, height = 0;
  };
  Field field = Field::mean;
  double focal_px = 0;        ///< 0: the median of the cameras'
  int width = 0, height = 0;  ///< about the middle of the field; 0: all of the field
  std::optional<Crop> crop;   ///< of the view that the rest makes
};

/// The largest picture we make of a field, in pixels a side.
inline constexpr int kMostViewSize = 65500;

/// Fields of view are compared as directions, at infinite distance, up to 75 degrees off the plane's normal.
/// Throws Error naming the cameras: if none is determined, one looks away from the plane's normal by 60
/// degrees or more, fields that are asked for in common have nothing in common, or a camera sees nothing of
/// the view; or naming the crop if it does not lie within the view.
CommonView common_view(const Rig& rig, const CommonViewOptions& options = {});

}  // namespace stuv
