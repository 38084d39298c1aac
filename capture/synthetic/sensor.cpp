#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "capture/synthetic/random.h"
#include "capture/synthetic/render.h"
#include "core/parallel.h"

namespace stuv::synthetic {
namespace {

/// 8-bit stored value of light 0..1 in steps of 1/65535: pow() for every pixel would cost as much as the
/// rest.
std::vector<std::uint8_t> encoding_table(double gamma, double offset) {
  std::vector<std::uint8_t> table(65536);
  for (std::size_t i = 0; i < table.size(); ++i) {
    const double stored = std::pow(static_cast<double>(i) / 65535, 1 / gamma) + offset;
    table[i] = static_cast<std::uint8_t>(std::lround(255 * std::clamp(stored, 0.0, 1.0)));
  }
  return table;
}

/// Light after gain and vignetting, with noise: variance light / full_well + (read_noise / full_well)^2.
struct NoiseModel {
  float per_light = 0, constant = 0;
  explicit NoiseModel(const SensorOptions& sensor) {
    if (sensor.full_well_e <= 0) return;
    per_light = static_cast<float>(1 / sensor.full_well_e);
    constant = static_cast<float>(std::pow(sensor.read_noise_e / sensor.full_well_e, 2));
  }
  float operator()(float light, std::uint64_t h) const {
    return light + std::sqrt(std::max(light, 0.0F) * per_light + constant) * rough_gaussian(h);
  }
};

}  // namespace

std::string problem_of(const SensorOptions& options) {
  if (!(options.gamma >= 0.2 && options.gamma <= 5))
    return fmt::format("gamma is {}, but must lie in 0.2..5", options.gamma);
  if (!(options.full_well_e >= 0 && std::isfinite(options.full_well_e)))
    return fmt::format("full_well_e is {}, but must be 0 or more", options.full_well_e);
  if (!(options.read_noise_e >= 0 && std::isfinite(options.read_noise_e)))
    return fmt::format("read_noise_e is {}, but must be 0 or more", options.read_noise_e);
  return "";
}

ImageF encode(const ImageF& light, const SensorOptions& sensor) {
  ImageF stored = light;
  const auto exponent = static_cast<float>(1 / sensor.gamma);
  for (float& value : stored.data) value = std::pow(std::clamp(value, 0.0F, 1.0F), exponent);
  return stored;
}

Image expose(const ImageF& light, int channels, const SensorOptions& sensor, const Exposure& exposure) {
  const std::vector<std::uint8_t> table = encoding_table(sensor.gamma, exposure.offset);
  const NoiseModel noisy(sensor);
  Image image{light.width, light.height, channels, PixelType::u8, {}, {}};
  image.bytes.resize(static_cast<std::size_t>(light.width) * light.height * channels);
  const double cx = 0.5 * (light.width - 1), cy = 0.5 * (light.height - 1), corner = cx * cx + cy * cy;
  parallel_for(light.height, [&](int y) {
    const float* from = light.row(y);
    std::size_t to = static_cast<std::size_t>(y) * light.width * channels;
    for (int x = 0; x < light.width; ++x) {
      const double r2 = ((x - cx) * (x - cx) + (y - cy) * (y - cy)) / corner;
      const double common = exposure.gain * (1 - exposure.vignetting * r2);
      for (int c = 0; c < channels; ++c, ++to) {
        const auto factor = static_cast<float>(common * exposure.colour_gain[static_cast<std::size_t>(c)]);
        const float ideal = factor * from[x * light.channels + std::min(c, light.channels - 1)];
        const float value = noisy(ideal, mix(exposure.seed ^ mix(to)));
        image.bytes[to] = static_cast<std::byte>(
            table[value > 0 ? static_cast<std::size_t>(std::lrint(std::min(value, 1.0F) * 65535.0F)) : 0]);
      }
    }
  });
  return image;
}

}  // namespace stuv::synthetic
