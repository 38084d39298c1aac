#include "render/cpu/tile_colour.h"

#include <algorithm>
#include <cmath>

namespace stuv {
namespace {

/// Brightness that varies less than this says nothing: slopes of noise.
constexpr double kLeastBrightness = 1.0 / 255;

/// Sums of a variable: of itself, its square, and its product with brightness.
struct Moments {
  double sum = 0, square = 0, with_brightness = 0;
};

}  // namespace

double colour_beside_brightness(const Expectation& expected, const PixelRect& cells) {
  Moments channel[3];
  double count = 0, sum = 0, square = 0;
  for (int y = cells.y0; y < cells.y1; ++y) {
    for (int x = cells.x0; x < cells.x1; ++x) {
      if (expected.plane.at(x, y) < 0) continue;
      const float* rgb = &expected.colour.at(x, y);
      const double Y = brightness(rgb);
      ++count;
      sum += Y;
      square += Y * Y;
      for (int c = 0; c < 3; ++c) {
        channel[c].sum += rgb[c];
        channel[c].square += static_cast<double>(rgb[c]) * rgb[c];
        channel[c].with_brightness += Y * rgb[c];
      }
    }
  }
  if (count == 0) return 0;
  const double var_Y = square / count - (sum / count) * (sum / count);
  double rest = 0;
  for (const Moments& m : channel) {
    const double mean = m.sum / count;
    const double var = m.square / count - mean * mean, cov = m.with_brightness / count - mean * sum / count;
    const double slope = cov / (var_Y + kLeastBrightness * kLeastBrightness);
    rest += var - 2 * slope * cov + slope * slope * var_Y;
  }
  return std::sqrt(std::max(rest, 0.0) / 3);
}

}  // namespace stuv
