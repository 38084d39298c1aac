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

bool masked_out(const Image& image, int x, int y) {
  if (image.mask.empty()) return false;
  for (int j = y; j <= std::min(y + 1, image.height - 1); ++j)
    for (int i = x; i <= std::min(x + 1, image.width - 1); ++i)
      if (image.mask.at(i, j) == 0) return true;
  return false;
}

void interpolate(const ImageF& in, const Eigen::Vector2d& q, int x0, int y0, float* out) {
  const auto& table = lanczos_table();
  const Weights& wx = table[static_cast<std::size_t>(std::lround((q.x() - x0) * kPhases))];
  const Weights& wy = table[static_cast<std::size_t>(std::lround((q.y() - y0) * kPhases))];
  std::array<std::size_t, kTaps> columns;
  for (int k = 0; k < kTaps; ++k)
    columns[k] = static_cast<std::size_t>(std::clamp(x0 + k - kRadius + 1, 0, in.width - 1)) * in.channels;
  for (int c = 0; c < in.channels; ++c) {
    float sum = 0;
    for (int j = 0; j < kTaps; ++j) {
      const float* row = in.row(std::clamp(y0 + j - kRadius + 1, 0, in.height - 1)) + c;
      float line = 0;
      for (int k = 0; k < kTaps; ++k) line += wx[k] * row[columns[k]];
      sum += wy[j] * line;
    }
    out[c] = sum;
  }
}

}  // namespace

Image warp_to_common_view(const Image& image, const Camera& camera, const CommonView& view) {
  const ImageF in = to_float(image);
  ImageF out(view.width, view.height, image.channels);
  Mask mask(view.width, view.height, 1);
  const double cos_limit = cos_of_field(camera);
  const Eigen::Vector2d last(in.width - 1, in.height - 1);
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
      if (masked_out(image, x0, y0)) continue;
      interpolate(in, q, x0, y0, out.row(y) + static_cast<std::size_t>(x) * out.channels);
      mask.at(x, y) = 255;
    }
  });
  Image result = from_float(out, image.type);
  if (std::find(mask.data.begin(), mask.data.end(), 0) != mask.data.end()) result.mask = std::move(mask);
  return result;
}

}  // namespace stuv
