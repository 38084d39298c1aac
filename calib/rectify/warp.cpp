#include "calib/rectify/warp.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/parallel.h"

namespace stuv {
namespace {

constexpr int kRadius = 3, kTaps = 2 * kRadius;
/// Positions are rounded to 1/2048 px: an error of 0.00025 px, far below what calibration reaches.
constexpr int kPhases = 2048;
using Weights = std::array<float, kTaps>;

double lanczos(double d) {
  if (d == 0) return 1;
  if (std::abs(d) >= kRadius) return 0;
  const double a = std::numbers::pi * d;
  return kRadius * std::sin(a) * std::sin(a / kRadius) / (a * a);
}

/// Weights of the taps floor(q) - 2 .. floor(q) + 3 for the fraction phase / kPhases; each sums to 1.
const std::vector<Weights>& lanczos_table() {
  static const std::vector<Weights> table = [] {
    std::vector<Weights> weights(kPhases + 1);
    for (int phase = 0; phase <= kPhases; ++phase) {
      std::array<double, kTaps> exact{};
      double sum = 0;
      for (int k = 0; k < kTaps; ++k)
        sum += exact[k] = lanczos(static_cast<double>(phase) / kPhases - (k - kRadius + 1));
      for (int k = 0; k < kTaps; ++k) weights[phase][k] = static_cast<float>(exact[k] / sum);
    }
    return weights;
  }();
  return table;
}

/// The smallest cosine between the optical axis and a ray that belongs to the picture. Lens models are
/// polynomials: beyond some angle their projection turns back towards the middle, and would show the picture
/// a second time.
double cos_of_field(const Camera& camera) {
  constexpr int kAzimuths = 72, kSteps = 720;
  const Eigen::Vector2d middle(camera.intrinsics[2], camera.intrinsics[3]);
  const auto inside = [&](const Eigen::Vector2d& q) {
    return q.x() >= 0 && q.y() >= 0 && q.x() <= camera.width - 1 && q.y() <= camera.height - 1;
  };
  double leaves = 0, turns = 0.5 * std::numbers::pi;
  for (int a = 0; a < kAzimuths; ++a) {
    const double azimuth = 2 * std::numbers::pi * a / kAzimuths;
    std::vector<Eigen::Vector3d> rays;
    for (int i = 0; i < kSteps; ++i) {
      const double angle = 0.5 * std::numbers::pi * i / kSteps;
      rays.emplace_back(std::sin(angle) * std::cos(azimuth), std::sin(angle) * std::sin(azimuth),
                        std::cos(angle));
    }
    const std::vector<Eigen::Vector2d> q = project(camera, rays);
    int i = 1;
    while (i < kSteps && inside(q[i]) && (q[i] - middle).norm() > (q[i - 1] - middle).norm()) ++i;
    const double angle = 0.5 * std::numbers::pi * i / kSteps;
    if (i < kSteps && inside(q[i]))
      turns = std::min(turns, angle);
    else
      leaves = std::max(leaves, angle);
  }
  // The corners lie between two azimuths: allow a degree more. A fold leaves no such room.
  return std::cos(std::min(leaves + 0.02, turns));
}

/// The picture as float, and 1 where its pixels are there: neither masked nor, in float pictures, NaN or Inf.
/// `there` is empty if all are. Missing pixels are 0.
struct Source {
  ImageF pixels, there;
};

Source source_of(const Image& image) {
  Source in{to_float(image), {}};
  const std::size_t n = static_cast<std::size_t>(image.width) * image.height;
  for (std::size_t i = 0; i < n; ++i) {
    float* pixel = in.pixels.data.data() + i * image.channels;
    const bool good = (image.mask.empty() || image.mask.data[i] != 0) &&
                      std::all_of(pixel, pixel + image.channels, [](float v) { return std::isfinite(v); });
    if (good) continue;
    if (in.there.empty()) in.there = ImageF(image.width, image.height, 1, 1.0F);
    in.there.data[i] = 0;
    std::fill_n(pixel, image.channels, 0.0F);
  }
  return in;
}

/// All four pixels around a position are there.
bool surrounded(const ImageF& there, int x, int y) {
  for (int j = y; j <= std::min(y + 1, there.height - 1); ++j)
    for (int i = x; i <= std::min(x + 1, there.width - 1); ++i)
      if (there.at(i, j) == 0) return false;
  return true;
}

struct Taps {
  Weights wx, wy;
  std::array<int, kTaps> x, y;
};

Taps taps_at(const ImageF& in, const Eigen::Vector2d& q, int x0, int y0) {
  const auto& table = lanczos_table();
  Taps taps{table[static_cast<std::size_t>(std::lround((q.x() - x0) * kPhases))],
            table[static_cast<std::size_t>(std::lround((q.y() - y0) * kPhases))],
            {},
            {}};
  for (int k = 0; k < kTaps; ++k) {
    taps.x[k] = std::clamp(x0 + k - kRadius + 1, 0, in.width - 1);
    taps.y[k] = std::clamp(y0 + k - kRadius + 1, 0, in.height - 1);
  }
  return taps;
}

void interpolate(const ImageF& in, const Taps& taps, float* out) {
  for (int c = 0; c < in.channels; ++c) {
    float sum = 0;
    for (int j = 0; j < kTaps; ++j) {
      const float* row = in.row(taps.y[j]) + c;
      float line = 0;
      for (int k = 0; k < kTaps; ++k) line += taps.wx[k] * row[taps.x[k] * in.channels];
      sum += taps.wy[j] * line;
    }
    out[c] = sum;
  }
}

}  // namespace

Image warp_to_common_view(const Image& image, const Camera& camera, const CommonView& view) {
  const Source in = source_of(image);
  ImageF out(view.width, view.height, image.channels);
  Mask mask(view.width, view.height, 1);
  const double cos_limit = cos_of_field(camera);
  const Eigen::Vector2d last(image.width - 1, image.height - 1);
  parallel_for(view.height, [&](int y) {
    std::vector<Eigen::Vector3d> rays(view.width);
    for (int x = 0; x < view.width; ++x)
      rays[x] =
          camera.cam_from_rig.R *
          Eigen::Vector3d((x - view.cx_px) / view.focal_px, (y - view.cy_px) / view.focal_px, 1).normalized();
    const std::vector<Eigen::Vector2d> pixels = project(camera, rays);
    for (int x = 0; x < view.width; ++x) {
      if (rays[x].z() < cos_limit) continue;
      const Eigen::Vector2d q = pixels[x].cwiseMax(0).cwiseMin(last);
      // Rounding must not take a border away from a camera that is the common view itself.
      if (!((q - pixels[x]).norm() < 1e-6)) continue;
      const int x0 = static_cast<int>(q.x()), y0 = static_cast<int>(q.y());
      if (!in.there.empty() && !surrounded(in.there, x0, y0)) continue;
      const Taps taps = taps_at(in.pixels, q, x0, y0);
      float* pixel = out.row(y) + static_cast<std::size_t>(x) * out.channels;
      interpolate(in.pixels, taps, pixel);
      if (!in.there.empty()) {
        // Missing pixels added 0: the weight of the others is made 1 again.
        float weight = 0;
        interpolate(in.there, taps, &weight);
        for (int c = 0; c < out.channels; ++c) pixel[c] /= weight;
      }
      mask.at(x, y) = 255;
    }
  });
  Image result = from_float(out, image.type);
  if (std::find(mask.data.begin(), mask.data.end(), 0) != mask.data.end()) result.mask = std::move(mask);
  return result;
}

}  // namespace stuv
