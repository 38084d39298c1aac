#pragma once

#include <vector>

#include "core/camera.h"

namespace stuv::synthetic {

/// A camera's rays, tabulated every kStep pixels with the exact lens model and interpolated by the cubic
/// through the four nearest nodes of each axis. For lenses as bent as LENSMODEL_OPENCV4 describes them the
/// picture of an interpolated ray is within 1e-4 px of where it was asked for (tests/capture/render_test).
class LensGrid {
 public:
  explicit LensGrid(const Camera& camera);

  /// One row of rays at height y_px: rays(x_px) = (X / Z, Y / Z) in the camera's frame.
  class Row {
   public:
    Row(const LensGrid& grid, double y_px);
    Eigen::Vector2d operator()(double x_px) const;

   private:
    std::vector<Eigen::Vector2d> nodes_;
  };

 private:
  static constexpr int kStep = 8;
  /// Nodes begin two steps outside the picture, so that four surround every point of it.
  static constexpr int kMargin = 2;

  int columns_ = 0, rows_ = 0;
  std::vector<Eigen::Vector2d> nodes_;
};

}  // namespace stuv::synthetic
