#include "calib/photometry/view_samples.h"

#include <cmath>

#include "calib/photometry/stored.h"

namespace stuv {

std::optional<std::array<double, 3>> stored_around(const Image& image, double white,
                                                   const Eigen::Vector2d& pixel) {
  constexpr int kHalf = 7;
  constexpr double kSigma_px = 3;
  const auto x0 = static_cast<int>(std::lround(pixel.x())), y0 = static_cast<int>(std::lround(pixel.y()));
  std::array<double, 3> sum = {0, 0, 0};
  double weights = 0;
  for (int y = y0 - kHalf; y <= y0 + kHalf; ++y)
    for (int x = x0 - kHalf; x <= x0 + kHalf; ++x) {
      const auto stored = stored_at(image, white, x, y);
      if (!stored) return std::nullopt;
      // The Gaussian stands at the place itself, between the pixels.
      const double w = std::exp(-(Eigen::Vector2d(x, y) - pixel).squaredNorm() / (2 * kSigma_px * kSigma_px));
      for (int c = 0; c < image.channels; ++c) sum[c] += w * (*stored)[c];
      weights += w;
    }
  for (double& value : sum) value /= weights;
  return sum;
}

}  // namespace stuv
