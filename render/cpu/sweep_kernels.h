#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "render/pixel_store.h"

namespace stuv::kernels {

// The inner loops of the plane sweep, vectorised with Highway and dispatched at run time. Every function
// works on one rectangle of one focal plane and touches no state but its arguments. Sums are made per pixel
// in an order that does not depend on where a rectangle begins.

/// a_kl of equation 5.
struct PairWeights {
  float a01 = 1, a02 = 1, a12 = 0;
  bool operator==(const PairWeights&) const = default;
};

/// Part of one camera in the differences D_1 = I_0 - I_1 and D_2 = I_0 - I_2, seen by parallel views on the
/// camera plane: every output pixel meets the picture at one offset, so bilinear sampling and the filters'
/// weights are four constants for each difference.
struct ShiftTap {
  const StoredView* view = nullptr;
  std::ptrdiff_t offset = 0;             ///< samples from the output pixel's (x, y) to the upper left tap
  float ax = 0;                          ///< of float pixels: share of the right taps
  float w1[2] = {0, 0}, w2[2] = {0, 0};  ///< and weights of the upper and the lower row in D_1 and D_2
  /// Of integer pixels: weights in D_1 and D_2 by row, left in the lower half, right in the upper one.
  std::int32_t fixed1[2] = {0, 0}, fixed2[2] = {0, 0};
  bool two_rows = true, two_columns = true;  ///< false: the neighbour, of weight 0, may not be there
};

struct ShiftJob {
  PixelType type = PixelType::u8;
  int channels = 3;
  PairWeights a;
  std::vector<ShiftTap> taps;
  std::size_t in_second = 0;  ///< the taps before it have a part in D_2
  /// Of integer pixels: what one is in the sums of fixed1 and fixed2. The weights of each sum are 0 together.
  float unit1 = 0, unit2 = 0;
};

/// Arithmetic that a pixel needs, for the benchmark: multiply-adds, additions and comparisons, each counted
/// once. Equation 5; equations 6 and 7.
double multiply_adds(const ShiftJob& job);
double multiply_adds_of_window(int M_x, int M_y);

/// Equation 5 on output pixels [x, x + width) x [y, y + height). E0 points at (x, y); up to 64 values behind
/// the end of each row are overwritten.
void shift_difference(const ShiftJob& job, int x, int y, int width, int height, float* E0,
                      std::size_t stride);

/// Where one camera sees the rays of a block on one focal plane:
/// u = whole_x + frac_x + slope * gx, v alike; gx, gy are relative to the block's centre.
struct WarpMap {
  std::int32_t whole_x = 0, whole_y = 0;
  float frac_x = 0, frac_y = 0;
  float slope = 0;
  std::int32_t visible = 0;
};

/// Columns [begin, end) of a row of a view in which nothing is missing.
struct PresentSpan {
  std::int32_t begin = 0, end = 0;
};

/// One camera of a block of any viewpoint.
struct WarpCamera {
  const StoredView* view = nullptr;
  bool masked = false;
  const PresentSpan* spans = nullptr;  ///< of rows from `spans_y0` on, if masked
  std::int32_t spans_y0 = 0, spans_y1 = 0;
  float constant[3] = {0, 0, 0};  ///< weights by filter, where weight_stride is 0
  /// Weights by filter, one a pixel of the block; null where the camera has no part.
  const float* weight[3] = {nullptr, nullptr, nullptr};
};

struct WarpJob {
  int channels = 3;
  float scale = 1;  ///< of stored values
  PairWeights a;
  int k = 0;  ///< filter of the picture
  std::vector<WarpCamera> cameras;
  /// NaN: the ray does not look towards the scene. Of parallel views gx is one row and gy one column.
  const float *gx = nullptr, *gy = nullptr;
  bool parallel = false;
  std::size_t stride = 0;         ///< of the block's rasters
  std::size_t weight_stride = 0;  ///< of the weights; 0: the same in every row
};

/// Equation 5 on the block's pixels [x, x + width) x [y, y + height), in block coordinates; `maps` beside the
/// cameras. E0 is 0 and `defined` 0 where a filter that takes part keeps less than half its weight;
/// `candidate` is 1 where filter k has a sample. All of the block's stride.
void warp_difference(const WarpJob& job, const WarpMap* maps, int x, int y, int width, int height, float* E0,
                     float* defined, float* candidate);

/// Equation 8: colour (planar, `channels` rasters of the block's stride apart by `plane_size`) and coverage
/// of filter k at each pixel's own plane; maps[plane * cameras + camera]. plane < 0: 0.
void warp_colour(const WarpJob& job, const WarpMap* maps, const std::int32_t* plane, int width, int height,
                 float* colour, std::size_t plane_size, float* coverage);

/// Part of one camera in the picture of one plane, seen as ShiftTap.
struct ColourTap {
  const StoredView* view = nullptr;
  std::ptrdiff_t offset = 0;
  float w[4] = {0, 0, 0, 0};
  bool two_rows = true, two_columns = true;
};

struct ColourJob {
  PixelType type = PixelType::u8;
  int channels = 3;
  std::size_t cameras = 0;
  std::vector<ColourTap> taps;  ///< [plane][camera]; without view on planes that no pixel has
};

/// Equation 8 where every camera of filter k sees every pixel on its plane: colour (planar, `channels`
/// rasters `plane_size` apart) of output pixels [x, x + width) x [y, y + height), each on its own plane.
/// `plane` and `colour` point at (x, y); up to 64 values behind the end of each row are overwritten. plane <
/// 0: 0.
void shift_colour(const ColourJob& job, int x, int y, int width, int height, const std::int32_t* plane,
                  std::size_t stride, float* colour, std::size_t plane_size);

// Sums over windows of (2M + 1)^2, rows first, one by one or by doubling: adds only, so nothing cancels or
// drifts. Strides in values.

/// in(x, y) becomes the sum of in(x .. x + 2M, y), x < width; `in` has width + 2M columns, and up to 64
/// values behind the end of each row are overwritten.
void sum_rows(float* in, std::size_t stride, int width, int height, int M, std::vector<float>& scratch);
/// out(x, y) = sum of in(x, y .. y + 2M), y < height; `in` has height + 2M rows and is overwritten, up to 64
/// values behind the end of each row of both too.
void sum_columns(float* in, std::size_t in_stride, int width, int height, int M, float* out,
                 std::size_t out_stride);

/// Equation 7 as planes go by. One row of `width` pixels.
struct MinimumRow {
  float* E_min;            ///< starts at Inf
  std::int32_t* plane;     ///< starts at -1
  float *E_sum, *E_count;  ///< start at 0
};

/// Adds plane n of cost E = sum * inverse. Of costs that differ by no more than `tie` the earlier one stays.
void add_plane(const MinimumRow& best, int n, int width, const float* sum, const float* inverse, float tie);

/// Adds plane n where `candidate` is 1. E = sum / count, undefined where count is 0.
void add_part_plane(const MinimumRow& best, int n, int width, const float* sum, const float* count,
                    const float* candidate, float tie);

/// Name of the instruction set in use.
const char* target_name();

/// Multiply-adds per second that one thread reaches on numbers in registers, with that instruction set.
double measure_multiply_adds(double seconds);

}  // namespace stuv::kernels
