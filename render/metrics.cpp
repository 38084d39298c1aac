#include "render/metrics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace stuv {
namespace {

double to_8bit(float value) {
  return std::isnan(value) ? 0.0 : std::floor(255.0 * std::clamp(static_cast<double>(value), 0.0, 1.0) + 0.5);
}

double luma(const ImageF& image, int x, int y) {
  if (image.channels == 1) return to_8bit(image.at(x, y));
  return 0.299 * to_8bit(image.at(x, y, 0)) + 0.587 * to_8bit(image.at(x, y, 1)) +
         0.114 * to_8bit(image.at(x, y, 2));
}

void require_same_size(const ImageF& a, const ImageF& b) {
  if (a.width != b.width || a.height != b.height || a.channels != b.channels)
    throw std::invalid_argument("pictures to compare have different sizes");
}

constexpr int kRadius = 5;

std::array<double, 2 * kRadius + 1> gaussian() {
  std::array<double, 2 * kRadius + 1> w{};
  double sum = 0;
  for (int i = -kRadius; i <= kRadius; ++i) sum += w[i + kRadius] = std::exp(-i * i / (2 * 1.5 * 1.5));
  for (double& value : w) value /= sum;
  return w;
}

}  // namespace

double psnr_db(const ImageF& a, const ImageF& b, int border) {
  require_same_size(a, b);
  double sum = 0;
  long long count = 0;
  for (int y = border; y < a.height - border; ++y)
    for (int x = border; x < a.width - border; ++x)
      for (int c = 0; c < a.channels; ++c, ++count) {
        const double d = to_8bit(a.at(x, y, c)) - to_8bit(b.at(x, y, c));
        sum += d * d;
      }
  if (count == 0) return std::numeric_limits<double>::quiet_NaN();
  return 10 * std::log10(255.0 * 255.0 * static_cast<double>(count) / sum);
}

double ssim(const ImageF& a, const ImageF& b, int border) {
  require_same_size(a, b);
  constexpr double c1 = 0.01 * 255 * 0.01 * 255, c2 = 0.03 * 255 * 0.03 * 255;
  const auto w = gaussian();
  double sum = 0;
  long long count = 0;
  // One row of vertically weighted moments at a time, then the horizontal sum.
  std::vector<std::array<double, 5>> column(a.width);
  for (int y = border + kRadius; y < a.height - border - kRadius; ++y) {
    for (int x = border; x < a.width - border; ++x) {
      column[x] = {};
      for (int j = -kRadius; j <= kRadius; ++j) {
        const double p = luma(a, x, y + j), q = luma(b, x, y + j), g = w[j + kRadius];
        const std::array<double, 5> moments = {p, q, p * p, q * q, p * q};
        for (int m = 0; m < 5; ++m) column[x][m] += g * moments[m];
      }
    }
    for (int x = border + kRadius; x < a.width - border - kRadius; ++x, ++count) {
      std::array<double, 5> e{};
      for (int i = -kRadius; i <= kRadius; ++i)
        for (int m = 0; m < 5; ++m) e[m] += w[i + kRadius] * column[x + i][m];
      const double va = e[2] - e[0] * e[0], vb = e[3] - e[1] * e[1], cov = e[4] - e[0] * e[1];
      sum += (2 * e[0] * e[1] + c1) * (2 * cov + c2) / ((e[0] * e[0] + e[1] * e[1] + c1) * (va + vb + c2));
    }
  }
  return count == 0 ? std::numeric_limits<double>::quiet_NaN() : sum / static_cast<double>(count);
}

}  // namespace stuv
