#pragma once

#include <Eigen/Dense>
#include <optional>

#include "core/raster.h"

namespace stuv {

/// Where a window of one picture lies in another: (x, y) + d goes to centre_px + A d.
struct WindowPlace {
  Eigen::Vector2d centre_px = Eigen::Vector2d::Zero();
  Eigen::Matrix2d A = Eigen::Matrix2d::Identity();
};

struct AlignOptions {
  double most_shift_px = 4;    ///< from the start
  double least_ncc = 0.9;      ///< normalised cross-correlation in the end
  double most_sigma_px = 0.1;  ///< of the place, from what is left of the difference
  int most_steps = 20;
};

struct AlignedWindow {
  WindowPlace place;
  double ncc = 0, sigma_px = 0;
};

/// The 17 x 17 window around a pixel of a picture, ready to be found in others.
///
///   minimise sum over d of (I(c + A d) - g T(d) - b)^2   over c, A, gain g, offset b
///
/// by Gauss and Newton with the window's own gradients, whose normal matrix is made once (inverse
/// compositional: Baker, Matthews, IJCV 2004). Pictures are grey; sampled bicubically (Keys, a = -1/2).
class Window {
 public:
  static constexpr int kRadius = 8;
  /// Nothing where the window leaves the picture, or has so little texture that noise of `noise` grey levels
  /// (of 0..1) would move it by more than `most_sigma_px` in some direction.
  static std::optional<Window> at(const ImageF& picture, int x, int y, double noise, double most_sigma_px);

  /// Texture: what noise of one unit would move the place by, in its worst direction [px].
  double sigma_per_noise() const { return sigma_per_noise_; }
  /// Nothing if it leaves the picture or the start too far, does not settle, or looks different there.
  std::optional<AlignedWindow> find(const ImageF& picture, const WindowPlace& start,
                                    const AlignOptions& options) const;

 private:
  static constexpr int kSide = 2 * kRadius + 1, kPixels = kSide * kSide, kUnknowns = 8;
  using Column = Eigen::Matrix<float, kPixels, 1>;

  Eigen::Matrix<float, kPixels, kUnknowns>
      jacobian_;  ///< T_x, T_y; T_x dx, T_x dy, T_y dx, T_y dy; T less its mean, 1
  Eigen::Matrix<double, kUnknowns, kUnknowns> inverse_;
  double sigma_per_noise_ = 0;
};

}  // namespace stuv
