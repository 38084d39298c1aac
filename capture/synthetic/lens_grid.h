#pragma once

#include <algorithm>
#include <array>
#include <cmath>
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
    Eigen::Vector2d operator()(double x_px) const {
      const double x = x_px / kStep + kMargin;
      const int first =
          std::clamp(static_cast<int>(std::floor(x)) - 1, 0, static_cast<int>(nodes_.size()) - 4);
      const std::array<double, 4> w = cubic_weights(x - first - 1);
      const Eigen::Vector2d* n = &nodes_[static_cast<std::size_t>(first)];
      return w[0] * n[0] + w[1] * n[1] + w[2] * n[2] + w[3] * n[3];
    }

   private:
    std::vector<Eigen::Vector2d> nodes_;
  };

 private:
  static constexpr int kStep = 8;
  /// Nodes begin two steps outside the picture, so that four surround every point of it.
  static constexpr int kMargin = 2;

  /// Weights of the cubic through the values at -1, 0, 1 and 2 (Lagrange), at x in 0..1.
  static std::array<double, 4> cubic_weights(double x) {
    return {-x * (x - 1) * (x - 2) / 6, (x + 1) * (x - 1) * (x - 2) / 2, -(x + 1) * x * (x - 2) / 2,
            (x + 1) * x * (x - 1) / 6};
  }

  int columns_ = 0, rows_ = 0;
  std::vector<Eigen::Vector2d> nodes_;
};

}  // namespace stuv::synthetic
