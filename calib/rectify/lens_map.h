#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "calib/rectify/common_view.h"
#include "core/camera.h"

namespace stuv {

/// Where the pixels of the common view lie in a camera's picture:
///
///   q(x, y) = project(R [(x - cx) / f, (y - cy) / f, 1]),   R: cam_from_rig's rotation
///
/// (a camera's centre stays, so depth does not matter). The lens model is evaluated every step() pixels and
/// interpolated in between by the cubic through the four nearest nodes of each axis. At the centre of every
/// cell, where that cubic errs most, the model is asked again: the step is halved until nearly no cell errs
/// by more than kMostError_px, and cells that still do (or lie where lens models fold back) are computed
/// pixel by pixel.
class LensMap {
 public:
  /// Positions are whole multiples of 1/kPhases px: an error of 0.00025 px, far below what calibration
  /// reaches.
  static constexpr int kPhaseBits = 11, kPhases = 1 << kPhaseBits;
  static constexpr std::int32_t kNowhere = std::numeric_limits<std::int32_t>::min();
  /// Blocks begin at whole multiples of it.
  static constexpr int kBlock = 32;
  static constexpr double kMostError_px = 0.002;

  LensMap(const Camera& camera, const CommonView& view);

  /// Positions of the block's pixels [1/kPhases px], row by row without gaps; kNowhere in both where q lies
  /// outside the picture or beyond the angle of view of its corners. x and y: multiples of kBlock.
  void block(int x, int y, int width, int height, std::int32_t* qx, std::int32_t* qy) const;

  int step() const { return step_; }
  /// Of the cells that see the picture, those computed pixel by pixel.
  double exact_fraction() const;

 private:
  enum class Cell : std::uint8_t { outside, smooth, exact };
  struct Node {
    Eigen::Vector2d q;
    bool good = false;
  };

  Eigen::Vector3d ray(double x, double y) const;
  void make(int step);
  void make_nodes();
  Cell kind_of(int column, int row, const Eigen::Vector2d& centre) const;
  void smooth_row(int column, int y, int columns, int width, std::int32_t* qx, std::int32_t* qy) const;
  void exact_cell(int x0, int y0, int x1, int y1, int left, int top, int stride, std::int32_t* qx,
                  std::int32_t* qy) const;

  Camera camera_;
  CommonView view_;
  /// Cosines to the optical axis: of pixels that belong to the picture, of nodes that can be interpolated.
  double pixel_limit_ = 0, node_limit_ = 0;
  int step_ = 0, columns_ = 0, rows_ = 0;  ///< cells
  std::vector<Node> nodes_;                ///< (columns + 3) x (rows + 3), the first one step outside
  std::vector<Cell> cells_;
};

}  // namespace stuv
