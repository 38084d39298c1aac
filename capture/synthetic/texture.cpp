#include "capture/synthetic/texture.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "capture/synthetic/random.h"

namespace stuv::synthetic {
namespace {

float smooth(double low, double high, double x) {
  const double t = std::clamp((x - low) / (high - low), 0.0, 1.0);
  return static_cast<float>(t * t * (3 - 2 * t));
}

Colour blend(const Colour& a, const Colour& b, float share) { return a + (b - a) * share; }

std::uint32_t lattice_hash(int x, int y, int z) {
  std::uint32_t h = static_cast<std::uint32_t>(x) * 0x8DA6B343U ^
                    static_cast<std::uint32_t>(y) * 0xD8163841U ^ static_cast<std::uint32_t>(z) * 0xCB1AB31FU;
  h ^= h >> 15;
  h *= 0x2C1B3C6DU;
  h ^= h >> 12;
  h *= 0x297A2D39U;
  return h ^ (h >> 15);
}

double lattice_value(int x, int y, int z) { return lattice_hash(x, y, z) * 0x1p-31 - 1; }

/// Value noise in -1..1 with features about one unit in size.
double value_noise(const Eigen::Vector3d& p) {
  const Eigen::Vector3d cell = p.array().floor();
  const Eigen::Vector3d f = p - cell;
  const Eigen::Vector3d w = f.array().square() * (3 - 2 * f.array());
  const int x = static_cast<int>(cell.x()), y = static_cast<int>(cell.y()), z = static_cast<int>(cell.z());
  const auto along_x = [&](int j, int k) {
    const double a = lattice_value(x, y + j, z + k), b = lattice_value(x + 1, y + j, z + k);
    return a + (b - a) * w.x();
  };
  const auto along_y = [&](int k) {
    const double a = along_x(0, k), b = along_x(1, k);
    return a + (b - a) * w.y();
  };
  const double a = along_y(0), b = along_y(1);
  return a + (b - a) * w.z();
}

/// Octaves of noise from wavelength `size` down, each half as strong, fading where samples are too far apart.
float noise(const Eigen::Vector3d& p, double size, double step, int octaves = 4) {
  double sum = 0, strength = 0.5;
  for (int i = 0; i < octaves; ++i, size *= 0.5, strength *= 0.5) {
    const double keep = std::clamp(size / (2 * step) - 1, 0.0, 1.0);
    if (keep <= 0) break;
    sum += strength * keep * value_noise(p / size + Eigen::Vector3d::Constant(17.3 * i));
  }
  return static_cast<float>(sum);
}

float noise(double x, double y, double size, double step, int octaves = 4) {
  return noise(Eigen::Vector3d(x, y, 0.37), size, step, octaves);
}

/// 1 within `half` of the lines at whole multiples of `period`, with an edge as soft as the samples need.
float lines(double x, double period, double half, double step) {
  const double distance = std::abs(x - period * std::round(x / period));
  return 1 - smooth(half - 0.5 * step, half + 0.5 * step + 1e-9, distance);
}

/// A number in -1..1 for a brick, a plank, ...
float shade_of(int a, int b) { return static_cast<float>(lattice_value(a, b, 91)); }

}  // namespace

Colour bricks(double x, double y, double step) {
  constexpr double width = 0.24, height = 0.08, joint = 0.006;
  const int row = static_cast<int>(std::floor(y / height));
  const double shifted = x + ((row & 1) != 0 ? 0.5 * width : 0);
  const int column = static_cast<int>(std::floor(shifted / width));
  const float shade = shade_of(row, column), grain = noise(x, y, 0.03, step);
  const Colour brick = Colour(0.42F, 0.17F, 0.11F) * (1 + 0.35F * shade + 0.5F * grain) +
                       Colour(0.05F, 0.06F, 0.04F) * shade_of(column, row + 50);
  const Colour mortar = Colour(0.46F, 0.43F, 0.39F) * (1 + 0.25F * grain);
  return blend(brick, mortar, std::max(lines(y, height, joint, step), lines(shifted, width, joint, step)));
}

Colour plaster(double x, double y, double step) {
  return Colour(0.62F, 0.60F, 0.52F) * (1 + 0.04F * noise(x, y, 0.6, step, 2));
}

Colour planks(double x, double z, double step) {
  constexpr double width = 0.14, length = 1.3;
  const int plank = static_cast<int>(std::floor(x / width));
  const double along = z + 0.4 * plank + 0.37 * length * shade_of(plank, 3);
  const int piece = static_cast<int>(std::floor(along / length));
  const float grain = noise(Eigen::Vector3d(x * 9, along * 0.7, plank + 0.5), 0.25, step * 4);
  const Colour wood = Colour(0.40F, 0.24F, 0.12F) * (1 + 0.30F * shade_of(plank, piece) + 0.55F * grain);
  const float joint = std::max(lines(x, width, 0.003, step), lines(along, length, 0.003, step));
  return blend(wood, Colour(0.07F, 0.04F, 0.02F), joint);
}

Colour painting(double x, double y, double step) {
  // A sun with fine rays over hills and a lake.
  const Eigen::Vector2d to_sun(x - 0.62, (y - 0.40) * 0.7);
  const double radius = to_sun.norm(), angle = std::atan2(to_sun.y(), to_sun.x());
  Colour c = blend(Colour(0.10F, 0.22F, 0.55F), Colour(0.95F, 0.55F, 0.18F), smooth(0.0, 0.62, y));
  const double ray_size = radius * 2 * 3.14159265 / 36;
  const float sharp = static_cast<float>(std::clamp(ray_size / (4 * step) - 0.5, 0.0, 1.0));
  c *= 1 + 0.18F * sharp * static_cast<float>(std::sin(36 * angle)) * smooth(0.1, 0.2, radius);
  c = blend(Colour(1.0F, 0.85F, 0.35F), c, smooth(0.095, 0.095 + step + 0.004, radius));
  const auto hill = [&](double level, const Colour& colour, double size) {
    const double top = level + 0.5 * size * noise(x, level, size, 0.001, 5);
    c = blend(c, colour * (1 + 0.5F * noise(x, y, 0.05, step)), smooth(top, top + step + 0.003, y));
  };
  hill(0.55, {0.25F, 0.20F, 0.33F}, 0.3);
  hill(0.68, {0.10F, 0.22F, 0.16F}, 0.25);
  hill(0.80, {0.06F, 0.12F, 0.06F}, 0.2);
  return c;
}

Colour crate(double x, double y, const Eigen::Vector3d& p, double step) {
  constexpr double board = 0.1, frame = 0.19;
  const float grain = noise(Eigen::Vector3d(p.x() * 1.5, p.y() * 12, p.z() * 1.5), 0.12, step * 4);
  const float rim = std::max(smooth(frame - step, frame + step, std::abs(x)),
                             smooth(frame - step, frame + step, std::abs(y)));
  const float shade = shade_of(static_cast<int>(std::floor(y / board)), 7);
  const Colour inner = Colour(0.50F, 0.34F, 0.16F) * (1 + 0.25F * shade + 0.6F * grain);
  const Colour outer = Colour(0.62F, 0.45F, 0.24F) * (1 + 0.5F * grain);
  const Colour c = blend(inner, outer, rim);
  return blend(c, Colour(0.08F, 0.05F, 0.03F), lines(y, board, 0.004, step) * (1 - rim));
}

Colour marble(const Eigen::Vector3d& p, double step) {
  const double turbulence = noise(p, 0.12, step, 5);
  const double vein = std::abs(std::sin(22 * (p.x() + 0.6 * p.y()) + 7 * turbulence));
  return blend(Colour(0.10F, 0.20F, 0.22F), Colour(0.72F, 0.76F, 0.70F), smooth(0.0, 0.45, vein));
}

Colour fabric(double along, double around, double step) {
  const float thread = 0.5F * lines(along, 0.012, 0.003, step) + 0.5F * lines(around, 0.012, 0.003, step);
  const Colour base =
      blend(Colour(0.10F, 0.26F, 0.42F), Colour(0.70F, 0.62F, 0.40F), lines(along, 0.16, 0.025, step));
  return base * (0.75F + 0.5F * thread);
}

Colour striped_ball(const Eigen::Vector3d& unit, double step) {
  const double longitude = std::atan2(unit.z(), unit.x()) / (2 * 3.14159265);
  const double across = std::hypot(unit.x(), unit.z());
  const float stripe = lines(longitude, 1.0 / 6, 1.0 / 24, step / std::max(across, 0.05));
  const Colour c = blend(Colour(0.85F, 0.62F, 0.05F), Colour(0.08F, 0.14F, 0.55F), stripe);
  return blend(c, Colour(0.80F, 0.80F, 0.78F), smooth(0.86, 0.86 + step + 0.01, std::abs(unit.y())));
}

}  // namespace stuv::synthetic
