#pragma once

#include <cstdint>

namespace stuv::warp_kernels {

// The inner loops of the warp, compiled for several instruction sets (Highway) and chosen at run time.

/// Lanczos of radius 3: six taps, kept as eight with two that weigh nothing.
constexpr int kRadius = 3, kTaps = 2 * kRadius, kPadded = 8;
using Weights = float[kPadded];

/// Positions along a row of a cell as cubics in t = i / step, relative to a whole pixel.
struct CubicRow {
  float x[4], y[4];
  std::int32_t base_x, base_y;
};

/// Positions of the first `count` pixels of a cell [1/2048 px]; kNowhere for both outside the picture.
void positions(const CubicRow& row, int step, int count, int width, int height, std::int32_t* qx,
               std::int32_t* qy);

/// out[i] = sum_jk w_j(qy) w_k(qx) box[(Y + j) stride + X + k], where X, Y are the whole parts of the
/// positions, which must lie such that all of 6 rows and 8 columns are in the box; `table`: by phase.
void interpolate(const float* box, int stride, const Weights* table, const std::int32_t* qx,
                 const std::int32_t* qy, int count, float* out);

/// Integers to float without scaling, channels taken apart into planes that lie `pitch` floats apart.
void load(const std::uint8_t* from, int channels, int count, float* to, std::size_t pitch);
void load(const std::uint16_t* from, int channels, int count, float* to, std::size_t pitch);
/// The way back, clamped and rounded to nearest.
void store(const float* from, std::size_t pitch, int channels, int count, std::uint8_t* to);
void store(const float* from, std::size_t pitch, int channels, int count, std::uint16_t* to);

/// Stored values of one camera to the rig's: (v - offset) factor / V, V = 1 + rho (v1 + rho (v2 + rho v3)),
/// rho = ((x - cx)^2 + dy2) inv_r2, x = first, first + 1, ... Values at or beyond what the camera can store
/// tell nothing but that: they become `black` and `white` again.
struct Correction {
  float offset, factor, v1, v2, v3, cx, inv_r2, black, white;
};
void correct(const Correction& c, int first, float dy2, int count, float* values);

/// The instruction set in use.
const char* target_name();

}  // namespace stuv::warp_kernels
