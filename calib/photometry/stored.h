#pragma once

#include <array>
#include <cmath>
#include <optional>

#include "core/image.h"

namespace stuv {

inline double stored_sample(const Image& image, std::size_t sample) {
  switch (image.type) {
    case PixelType::u8:
      return static_cast<double>(image.bytes[sample]) / 255;
    case PixelType::u16:
      return reinterpret_cast<const std::uint16_t*>(image.bytes.data())[sample] / 65535.0;
    case PixelType::f16:
      return static_cast<double>(reinterpret_cast<const Eigen::half*>(image.bytes.data())[sample]);
    case PixelType::f32:
      return reinterpret_cast<const float*>(image.bytes.data())[sample];
  }
  return 0;
}

/// The channels of a pixel, 0..1; nothing where it is outside, masked, not finite, or so near to an end of
/// the range that noise may have been cut off. Float pictures have no ends (`white` is infinite).
inline std::optional<std::array<double, 3>> stored_at(const Image& image, double white, int x, int y) {
  constexpr double kEnd = 1.5 / 255;
  if (x < 0 || y < 0 || x >= image.width || y >= image.height) return std::nullopt;
  if (!image.mask.empty() && image.mask.at(x, y) == 0) return std::nullopt;
  std::array<double, 3> result = {0, 0, 0};
  const std::size_t first = (static_cast<std::size_t>(y) * image.width + x) * image.channels;
  for (int c = 0; c < image.channels; ++c) {
    result[c] = stored_sample(image, first + c);
    if (!std::isfinite(result[c]) || result[c] >= white - kEnd || (std::isfinite(white) && result[c] <= kEnd))
      return std::nullopt;
  }
  return result;
}

}  // namespace stuv
