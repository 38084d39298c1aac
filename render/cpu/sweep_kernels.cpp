#include "render/cpu/sweep_kernels.h"

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <type_traits>
#include <vector>

#include "render/focal_plane.h"

// Vectors are kept in arrays, which the sizeless types of SVE and RVV do not allow.
#define HWY_WANT_AVX3_DL
#define HWY_DISABLED_TARGETS \
  (HWY_SSSE3 | HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV | HWY_WASM | HWY_WASM_EMU256)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "render/cpu/sweep_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
// Highway 1.0 asks the processor for VNNI, but not the compiler.
#if HWY_TARGET == HWY_AVX3_DL
HWY_PUSH_ATTRIBUTES("avx512vnni")
#endif
namespace stuv::kernels::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using D = hn::ScalableTag<float>;
using DI = hn::RebindToSigned<D>;
using V = hn::Vec<D>;
using VI = hn::Vec<DI>;
using M = hn::Mask<D>;

constexpr D d;
constexpr DI di;

/// As many samples as a vector has lanes, as float.
template <class T>
HWY_INLINE V load(const T* p) {
  if constexpr (std::is_same_v<T, float>)
    return hn::LoadU(d, p);
  else
    return hn::ConvertTo(d, hn::PromoteTo(di, hn::LoadU(hn::Rebind<T, DI>(), p)));
}

/// Output rows at a time, of float pixels: as many as the registers hold.
constexpr bool kManyRegisters = HWY_TARGET == HWY_AVX3 || HWY_TARGET == HWY_AVX3_DL;
constexpr int kRows = kManyRegisters || HWY_TARGET == HWY_NEON ? 8 : 4;

/// Adds R output rows of one tap of float pixels: row r of the picture is the upper row of output r and the
/// lower one of r - 1.
template <int R, bool second, bool two_rows, bool two_columns>
HWY_INLINE void add_tap(const float* HWY_RESTRICT p, std::size_t stride, const ShiftTap& tap, V* a1, V* a2) {
  const V upper1 = hn::Set(d, tap.w1[0]), lower1 = hn::Set(d, tap.w1[1]);
  const V upper2 = hn::Set(d, tap.w2[0]), lower2 = hn::Set(d, tap.w2[1]);
  const V left = hn::Set(d, 1 - tap.ax), right = hn::Set(d, tap.ax);
#pragma GCC unroll 16
  for (int r = 0; r < R + (two_rows ? 1 : 0); ++r) {
    const float* from = p + r * stride;
    V row = load(from);
    if constexpr (two_columns) row = hn::MulAdd(right, load(from + 1), hn::Mul(left, row));
    if (r < R) {
      a1[r] = hn::MulAdd(upper1, row, a1[r]);
      if constexpr (second) a2[r] = hn::MulAdd(upper2, row, a2[r]);
    }
    if (two_rows && r > 0) {
      a1[r - 1] = hn::MulAdd(lower1, row, a1[r - 1]);
      if constexpr (second) a2[r - 1] = hn::MulAdd(lower2, row, a2[r - 1]);
    }
  }
}

template <int R, bool second>
HWY_INLINE void add_tap_of(const ShiftTap& tap, const float* p, std::size_t stride, V* a1, V* a2) {
  if (tap.two_rows && tap.two_columns)
    add_tap<R, second, true, true>(p, stride, tap, a1, a2);
  else if (tap.two_rows)
    add_tap<R, second, true, false>(p, stride, tap, a1, a2);
  else if (tap.two_columns)
    add_tap<R, second, false, true>(p, stride, tap, a1, a2);
  else
    add_tap<R, second, false, false>(p, stride, tap, a1, a2);
}

/// Equation 5's part of one channel.
HWY_INLINE V weighted_difference(const ShiftJob& job, V D1, V D2) {
  V e = hn::Mul(hn::Set(d, job.a.a01), hn::Abs(D1));
  e = hn::MulAdd(hn::Set(d, job.a.a02), hn::Abs(D2), e);
  if (job.a.a12 != 0) e = hn::MulAdd(hn::Set(d, job.a.a12), hn::Abs(hn::Sub(D2, D1)), e);
  return e;
}

/// R rows of float pixels; pixels[c * taps + t]: where tap t begins in channel c.
template <int R>
HWY_NOINLINE void difference_rows(const ShiftJob& job, const float* const* pixels, std::size_t stride,
                                  int width, float* HWY_RESTRICT E0, std::size_t E0_stride) {
  const ShiftTap* taps = job.taps.data();
  const std::size_t count = job.taps.size();
  for (int i = 0; i < width; i += static_cast<int>(hn::Lanes(d))) {
    V e[R];
#pragma GCC unroll 16
    for (int r = 0; r < R; ++r) e[r] = hn::Zero(d);
    for (int c = 0; c < job.channels; ++c) {
      const float* const* p = pixels + static_cast<std::size_t>(c) * count;
      V a1[R], a2[R];
#pragma GCC unroll 16
      for (int r = 0; r < R; ++r) a1[r] = a2[r] = hn::Zero(d);
      for (std::size_t t = 0; t < job.in_second; ++t) add_tap_of<R, true>(taps[t], p[t] + i, stride, a1, a2);
      for (std::size_t t = job.in_second; t < count; ++t)
        add_tap_of<R, false>(taps[t], p[t] + i, stride, a1, a2);
#pragma GCC unroll 16
      for (int r = 0; r < R; ++r) e[r] = hn::Add(e[r], weighted_difference(job, a1[r], a2[r]));
    }
#pragma GCC unroll 16
    for (int r = 0; r < R; ++r) hn::StoreU(e[r], d, E0 + r * E0_stride + i);
  }
}

#if HWY_TARGET == HWY_SCALAR
/// Integers, one by one.
template <int R, class T>
void difference_rows(const ShiftJob& job, const T* const* pixels, std::size_t stride, int width, float* E0,
                     std::size_t E0_stride) {
  const auto part = [](std::int32_t pair, int q) { return static_cast<std::int16_t>(pair >> (16 * q)); };
  const std::size_t count = job.taps.size();
  for (int r = 0; r < R; ++r)
    for (int i = 0; i < width; ++i) {
      V e = hn::Zero(d);
      for (int c = 0; c < job.channels; ++c) {
        std::int64_t sum1 = 0, sum2 = 0;
        for (std::size_t t = 0; t < count; ++t) {
          const ShiftTap& tap = job.taps[t];
          const T* p = pixels[static_cast<std::size_t>(c) * count + t] + r * stride + i;
          for (int row = 0; row < (tap.two_rows ? 2 : 1); ++row, p += stride)
            for (int q = 0; q < 2; ++q) {
              sum1 += part(tap.fixed1[row], q) * static_cast<std::int64_t>(p[q]);
              if (t < job.in_second) sum2 += part(tap.fixed2[row], q) * static_cast<std::int64_t>(p[q]);
            }
        }
        e = hn::Add(e, weighted_difference(job, hn::Set(d, static_cast<float>(sum1) * job.unit1),
                                           hn::Set(d, static_cast<float>(sum2) * job.unit2)));
      }
      hn::StoreU(e, d, E0 + r * E0_stride + i);
    }
}
constexpr int kIntegerRows = 4;
#else
using D16 = hn::Repartition<std::int16_t, D>;
using V16 = hn::Vec<D16>;

/// Pixels from p on as 16-bit integers: each 32 bits hold a pixel and its right neighbour. Those of u16 are
/// less 2^15, which weights of sum 0 do not see.
HWY_INLINE V16 load_pairs(const std::uint8_t* p) {
  return hn::PromoteTo(D16(), hn::LoadU(hn::Rebind<std::uint8_t, D16>(), p));
}
HWY_INLINE V16 load_pairs(const std::uint16_t* p) {
  const V16 bits = hn::BitCast(D16(), hn::LoadU(hn::RebindToUnsigned<D16>(), p));
  return hn::Xor(bits, hn::Set(D16(), std::int16_t{-32768}));
}

/// A sum of products in the two halves that Highway's operation makes.
struct Sum {
  VI even, odd;
};

HWY_INLINE void add_products(V16 pixels, V16 weights, Sum& sum) {
#if HWY_TARGET == HWY_AVX3_DL
  // One instruction, which Highway 1.0 makes two of.
  sum.even = VI{_mm512_dpwssd_epi32(sum.even.raw, pixels.raw, weights.raw)};
#else
  sum.even = hn::ReorderWidenMulAccumulate(di, pixels, weights, sum.even, sum.odd);
#endif
}

/// Adds R output rows of one tap. sum[2 r]: pixels 0, 2, 4 .. of output row r, sum[2 r + 1]: 1, 3, 5 ..
template <int R, bool second, bool two_rows, class T>
HWY_INLINE void add_tap(const T* HWY_RESTRICT p, std::size_t stride, const ShiftTap& tap, Sum* sum1,
                        Sum* sum2) {
  const V16 upper1 = hn::BitCast(D16(), hn::Set(di, tap.fixed1[0]));
  const V16 lower1 = hn::BitCast(D16(), hn::Set(di, tap.fixed1[1]));
  const V16 upper2 = hn::BitCast(D16(), hn::Set(di, tap.fixed2[0]));
  const V16 lower2 = hn::BitCast(D16(), hn::Set(di, tap.fixed2[1]));
#pragma GCC unroll 16
  for (int r = 0; r < R + (two_rows ? 1 : 0); ++r)
#pragma GCC unroll 2
    for (int odd = 0; odd < 2; ++odd) {
      const V16 pairs = load_pairs(p + r * stride + odd);
      if (r < R) {
        add_products(pairs, upper1, sum1[2 * r + odd]);
        if constexpr (second) add_products(pairs, upper2, sum2[2 * r + odd]);
      }
      if (two_rows && r > 0) {
        add_products(pairs, lower1, sum1[2 * r - 2 + odd]);
        if constexpr (second) add_products(pairs, lower2, sum2[2 * r - 2 + odd]);
      }
    }
}

template <int R, bool second, class T>
HWY_INLINE void add_tap_of(const ShiftTap& tap, const T* p, std::size_t stride, Sum* sum1, Sum* sum2) {
  if (tap.two_rows)
    add_tap<R, second, true>(p, stride, tap, sum1, sum2);
  else
    add_tap<R, second, false>(p, stride, tap, sum1, sum2);
}

HWY_INLINE V value_of(const Sum& sum, float unit) {
  return hn::Mul(hn::Set(d, unit), hn::ConvertTo(d, hn::RearrangeToOddPlusEven(sum.even, sum.odd)));
}

/// R rows of integer pixels, both weights of a pixel and its neighbour in one multiplication.
template <int R, class T>
HWY_NOINLINE void difference_rows(const ShiftJob& job, const T* const* pixels, std::size_t stride, int width,
                                  float* HWY_RESTRICT E0, std::size_t E0_stride) {
  const ShiftTap* taps = job.taps.data();
  const std::size_t count = job.taps.size();
  for (int i = 0; i < width; i += 2 * static_cast<int>(hn::Lanes(d))) {
    V e[2 * R];
#pragma GCC unroll 16
    for (int k = 0; k < 2 * R; ++k) e[k] = hn::Zero(d);
    for (int c = 0; c < job.channels; ++c) {
      const T* const* p = pixels + static_cast<std::size_t>(c) * count;
      Sum sum1[2 * R], sum2[2 * R];
#pragma GCC unroll 16
      for (int k = 0; k < 2 * R; ++k) sum1[k] = sum2[k] = {hn::Zero(di), hn::Zero(di)};
      for (std::size_t t = 0; t < job.in_second; ++t)
        add_tap_of<R, true>(taps[t], p[t] + i, stride, sum1, sum2);
      for (std::size_t t = job.in_second; t < count; ++t)
        add_tap_of<R, false>(taps[t], p[t] + i, stride, sum1, sum2);
#pragma GCC unroll 16
      for (int k = 0; k < 2 * R; ++k)
        e[k] = hn::Add(e[k],
                       weighted_difference(job, value_of(sum1[k], job.unit1), value_of(sum2[k], job.unit2)));
    }
#pragma GCC unroll 16
    for (int r = 0; r < R; ++r) hn::StoreInterleaved2(e[2 * r], e[2 * r + 1], d, E0 + r * E0_stride + i);
  }
}
constexpr int kIntegerRows = kManyRegisters ? 4 : 2;
#endif

template <class T>
void shift_all(const ShiftJob& job, int x, int y, int width, int height, float* E0, std::size_t E0_stride) {
  static thread_local std::vector<const T*> pixels;
  const std::size_t count = job.taps.size();
  pixels.resize(count * static_cast<std::size_t>(job.channels));
  const std::size_t stride = static_cast<std::size_t>(job.taps.empty() ? 0 : job.taps.front().view->width);
  const std::ptrdiff_t first = static_cast<std::ptrdiff_t>(y) * static_cast<std::ptrdiff_t>(stride) + x;
  for (int c = 0; c < job.channels; ++c)
    for (std::size_t t = 0; t < count; ++t)
      pixels[static_cast<std::size_t>(c) * count + t] =
          job.taps[t].view->plane<T>(c) + job.taps[t].offset + first;
  int row = 0;
  const auto take = [&]<int R>(std::integral_constant<int, R>) {
    for (; row + R <= height; row += R) {
      difference_rows<R>(job, pixels.data(), stride, width, E0 + row * E0_stride, E0_stride);
      for (const T*& p : pixels) p += R * stride;
    }
  };
  if constexpr (std::is_same_v<T, float>) {
    take(std::integral_constant<int, kRows>());
    take(std::integral_constant<int, 4>());
  } else {
    take(std::integral_constant<int, kIntegerRows>());
  }
  take(std::integral_constant<int, 2>());
  take(std::integral_constant<int, 1>());
}

void ShiftDifference(const ShiftJob& job, int x, int y, int width, int height, float* E0,
                     std::size_t stride) {
  if (job.type == PixelType::u8)
    shift_all<std::uint8_t>(job, x, y, width, height, E0, stride);
  else if (job.type == PixelType::u16)
    shift_all<std::uint16_t>(job, x, y, width, height, E0, stride);
  else
    shift_all<float>(job, x, y, width, height, E0, stride);
}

/// Where a camera sees one vector of rays: upper left taps and fractions; `valid` as FocalPlaneRenderer says.
struct Place {
  VI x, y;
  V ax, ay;
  M valid;
  bool contiguous;  ///< lanes lie side by side in one row
};

struct VectorMap {
  VI whole_x, whole_y;
  V frac_x, frac_y, slope;
  M visible;
};

HWY_INLINE void split(V at, VI whole, int limit, VI& index, V& fraction, M& valid) {
  const V nearest = hn::Round(at);
  const M snaps =
      hn::Lt(hn::Abs(hn::Sub(at, nearest)), hn::Set(d, static_cast<float>(FocalPlaneRenderer::kSnap_px)));
  at = hn::IfThenElse(snaps, nearest, at);
  // Also false for NaN.
  valid = hn::And(valid, hn::Lt(hn::Abs(at), hn::Set(d, 1e6F)));
  const V below = hn::Floor(at);
  fraction = hn::IfThenElseZero(valid, hn::Sub(at, below));
  index = hn::Add(whole, hn::ConvertTo(di, hn::IfThenElseZero(valid, below)));
  const VI end =
      hn::Sub(hn::Set(di, limit),
              hn::IfThenElseZero(hn::RebindMask(di, hn::Gt(fraction, hn::Zero(d))), hn::Set(di, 1)));
  const auto inside = hn::And(hn::Gt(index, hn::Set(di, -1)), hn::Lt(index, end));
  valid = hn::And(valid, hn::RebindMask(d, inside));
}

HWY_INLINE Place place_of(const VectorMap& map, const StoredView& view, V gx, V gy) {
  Place out;
  out.valid = map.visible;
  split(hn::MulAdd(map.slope, gx, map.frac_x), map.whole_x, view.width, out.x, out.ax, out.valid);
  split(hn::MulAdd(map.slope, gy, map.frac_y), map.whole_y, view.height, out.y, out.ay, out.valid);
  const auto valid = hn::RebindMask(di, out.valid);
  const VI first_x = hn::Set(di, hn::GetLane(out.x)), first_y = hn::Set(di, hn::GetLane(out.y));
  out.contiguous = hn::AllTrue(
      di, hn::And(valid, hn::And(hn::Eq(out.y, first_y), hn::Eq(out.x, hn::Add(first_x, hn::Iota(di, 0))))));
  out.x = hn::IfThenElseZero(valid, out.x);
  out.y = hn::IfThenElseZero(valid, out.y);
  out.ax = hn::IfThenElseZero(out.valid, out.ax);
  out.ay = hn::IfThenElseZero(out.valid, out.ay);
  return out;
}

/// The four taps of each lane, of one channel.
struct Taps {
  V p00, p01, p10, p11;
};

/// Index of the right and lower neighbours; a tap of weight 0 may lie outside: the pixel stands in for it.
struct Indices {
  VI upper, lower, right;  ///< `right`: 1 or 0
};

HWY_INLINE Indices indices_of(const Place& at, int stride) {
  const VI one = hn::Set(di, 1);
  Indices out;
  out.upper = hn::Add(hn::Mul(at.y, hn::Set(di, stride)), at.x);
  out.right = hn::IfThenElseZero(hn::RebindMask(di, hn::Gt(at.ax, hn::Zero(d))), one);
  const VI down = hn::IfThenElseZero(hn::RebindMask(di, hn::Gt(at.ay, hn::Zero(d))), hn::Set(di, stride));
  out.lower = hn::Add(out.upper, down);
  return out;
}

/// Integers: one gather of 32 bits brings both taps of a row.
template <class T>
HWY_INLINE void gather_pair(const T* plane, VI index, VI right, V& p0, V& p1) {
  if constexpr (std::is_same_v<T, float>) {
    p0 = hn::GatherIndex(d, plane, index);
    p1 = hn::GatherIndex(d, plane, hn::Add(index, right));
  } else {
    constexpr int kBits = 8 * sizeof(T);
    const VI both = hn::GatherOffset(di, reinterpret_cast<const std::int32_t*>(plane),
                                     hn::ShiftLeft<sizeof(T) / 2>(index));
    const VI low = hn::Set(di, (1 << kBits) - 1);
    p0 = hn::ConvertTo(d, hn::And(both, low));
    p1 = hn::ConvertTo(d, hn::And(hn::ShiftRight<kBits>(both), low));
  }
}

template <class T>
HWY_INLINE V sample(const T* plane, const Place& at, const Indices& index, std::size_t stride) {
  Taps t;
  if (at.contiguous) {
    const std::ptrdiff_t first = hn::GetLane(index.upper);
    // Lanes of other planes may have other fractions, and some of them none.
    const M right = hn::Gt(at.ax, hn::Zero(d)), down = hn::Gt(at.ay, hn::Zero(d));
    const T* p = plane + first;
    const T* q = hn::AllFalse(d, down) ? p : p + stride;
    t.p00 = load(p);
    t.p01 = hn::IfThenElse(right, load(p + 1), t.p00);
    t.p10 = hn::IfThenElse(down, load(q), t.p00);
    t.p11 = hn::IfThenElse(down, hn::IfThenElse(right, load(q + 1), t.p10), t.p01);
  } else {
    gather_pair(plane, index.upper, index.right, t.p00, t.p01);
    gather_pair(plane, index.lower, index.right, t.p10, t.p11);
  }
  const V upper = hn::MulAdd(at.ax, hn::Sub(t.p01, t.p00), t.p00);
  const V lower = hn::MulAdd(at.ax, hn::Sub(t.p11, t.p10), t.p10);
  return hn::MulAdd(at.ay, hn::Sub(lower, upper), upper);
}

/// Lanes all of whose taps are there.
HWY_INLINE M present(const std::uint8_t* mask, const Indices& index) {
  V p00, p01, p10, p11;
  gather_pair(mask, index.upper, index.right, p00, p01);
  gather_pair(mask, index.lower, index.right, p10, p11);
  const V zero = hn::Zero(d);
  // Without a right neighbour the second value of a pair is somebody else's.
  const auto alone = hn::RebindMask(d, hn::Eq(index.right, hn::Zero(di)));
  p01 = hn::IfThenElse(alone, p00, p01);
  p11 = hn::IfThenElse(alone, p10, p11);
  return hn::Gt(hn::Min(hn::Min(p00, p01), hn::Min(p10, p11)), zero);
}

/// Weighted sums of one vector of pixels by filter and channel.
struct Sums {
  V colour[3][3];
  V weight[3];
};

template <class T>
HWY_INLINE void add_camera(const WarpJob& job, const WarpCamera& camera, const VectorMap& map, V gx, V gy,
                           const V* weight, const bool* takes_part, Sums& sums) {
  const StoredView& view = *camera.view;
  Place at = place_of(map, view, gx, gy);
  if (hn::AllFalse(d, at.valid)) return;
  const Indices index = indices_of(at, view.width);
  M valid = at.valid;
  if (camera.masked) valid = hn::And(valid, present(view.mask_plane(), index));
  V w[3];
#pragma GCC unroll 3
  for (int k = 0; k < 3; ++k) {
    w[k] = hn::IfThenElseZero(valid, weight[k]);
    if (takes_part[k]) sums.weight[k] = hn::Add(sums.weight[k], w[k]);
  }
  for (int c = 0; c < job.channels; ++c) {
    const V value = sample(view.plane<T>(c), at, index, static_cast<std::size_t>(view.width));
#pragma GCC unroll 3
    for (int k = 0; k < 3; ++k)
      if (takes_part[k]) sums.colour[k][c] = hn::MulAdd(w[k], value, sums.colour[k][c]);
  }
}

HWY_INLINE void clear(Sums& sums) {
  for (int k = 0; k < 3; ++k) {
    sums.weight[k] = hn::Zero(d);
    for (int c = 0; c < 3; ++c) sums.colour[k][c] = hn::Zero(d);
  }
}

HWY_INLINE void dispatch(const WarpJob& job, const WarpCamera& camera, const VectorMap& map, V gx, V gy,
                         const V* weight, const bool* takes_part, Sums& sums) {
  if (camera.view->type == PixelType::u8)
    add_camera<std::uint8_t>(job, camera, map, gx, gy, weight, takes_part, sums);
  else if (camera.view->type == PixelType::u16)
    add_camera<std::uint16_t>(job, camera, map, gx, gy, weight, takes_part, sums);
  else
    add_camera<float>(job, camera, map, gx, gy, weight, takes_part, sums);
}

HWY_INLINE V pair_difference(const WarpJob& job, const Sums& sums, const V* inverse, int k, int l) {
  V e = hn::Zero(d);
  for (int c = 0; c < job.channels; ++c)
    e = hn::Add(
        e, hn::Abs(hn::Sub(hn::Mul(sums.colour[k][c], inverse[k]), hn::Mul(sums.colour[l][c], inverse[l]))));
  return hn::Mul(e, hn::Set(d, job.scale));
}

/// Equation 5 of one vector of pixels, block coordinates (col, row).
void warp_vector(const WarpJob& job, const WarpMap* maps, int col, int row, float* E0, float* defined,
                 float* candidate) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  const float a[3] = {job.a.a01, job.a.a02, job.a.a12};
  const int first[3] = {0, 0, 1}, second[3] = {1, 2, 2};
  const std::size_t i = static_cast<std::size_t>(row) * job.stride + col;
  const V gx = hn::LoadU(d, job.gx + (job.parallel ? static_cast<std::size_t>(col) : i));
  const V gy = job.parallel ? hn::Set(d, job.gy[row]) : hn::LoadU(d, job.gy + i);
  const std::size_t w = static_cast<std::size_t>(row) * job.weight_stride + col;
  Sums sums;
  clear(sums);
  for (std::size_t c = 0; c < job.cameras.size(); ++c) {
    const WarpCamera& camera = job.cameras[c];
    const WarpMap& m = maps[c];
    if (!m.visible) continue;
    V weight[3];
    bool takes_part[3];
    V any = hn::Zero(d);
    for (int k = 0; k < 3; ++k) {
      takes_part[k] = camera.weight[k] != nullptr;
      weight[k] = takes_part[k] ? hn::LoadU(d, camera.weight[k] + w) : hn::Zero(d);
      any = hn::Max(any, weight[k]);
    }
    if (hn::AllFalse(d, hn::Gt(any, hn::Zero(d)))) continue;
    const VectorMap map{hn::Set(di, m.whole_x), hn::Set(di, m.whole_y), hn::Set(d, m.frac_x),
                        hn::Set(d, m.frac_y),   hn::Set(d, m.slope),    hn::FirstN(d, lanes)};
    dispatch(job, camera, map, gx, gy, weight, takes_part, sums);
  }
  V inverse[3];
  M good[3];
  for (int k = 0; k < 3; ++k) {
    good[k] = hn::Ge(sums.weight[k], hn::Set(d, FocalPlaneRenderer::kLeastCoverage));
    const M any = hn::Gt(sums.weight[k], hn::Zero(d));
    inverse[k] = hn::IfThenElseZero(any, hn::Div(hn::Set(d, 1), sums.weight[k]));
  }
  V e = hn::Zero(d);
  M all = hn::FirstN(d, lanes);
  for (int p = 0; p < 3; ++p) {
    if (a[p] == 0) continue;
    e = hn::MulAdd(hn::Set(d, a[p]), pair_difference(job, sums, inverse, first[p], second[p]), e);
    all = hn::And(all, hn::And(good[first[p]], good[second[p]]));
  }
  hn::StoreU(hn::IfThenElseZero(all, e), d, E0 + i);
  hn::StoreU(hn::IfThenElseZero(all, hn::Set(d, 1)), d, defined + i);
  hn::StoreU(hn::IfThenElseZero(hn::Gt(sums.weight[job.k], hn::Zero(d)), hn::Set(d, 1)), d, candidate + i);
}

/// One camera along a row of a parallel view with constant weights: both rows of taps and their fraction are
/// the same for the whole row.
struct RowCamera {
  const StoredView* view;
  const WarpMap* map;
  std::size_t upper, lower;  ///< samples from the plane's pixel (0, 0) to column whole_x of the two rows
  float ay, w1, w2;          ///< weights in I_0 - I_1 and I_0 - I_2
  int begin, end;            ///< taps that are there, counted from column whole_x
};

/// The cameras of a row; false if one of them does not see it.
inline bool row_cameras(const WarpJob& job, const WarpMap* maps, int row, std::vector<RowCamera>& out) {
  out.clear();
  for (std::size_t c = 0; c < job.cameras.size(); ++c) {
    const WarpCamera& camera = job.cameras[c];
    const WarpMap& m = maps[c];
    const float w1 = camera.constant[0] - camera.constant[1], w2 = camera.constant[0] - camera.constant[2];
    if (camera.constant[0] + camera.constant[1] + camera.constant[2] <= 0) continue;
    if (!m.visible) return false;
    float v = m.slope * job.gy[row] + m.frac_y;
    if (const float nearest = std::round(v);
        std::abs(v - nearest) < static_cast<float>(FocalPlaneRenderer::kSnap_px))
      v = nearest;
    if (!(std::abs(v) < 1e6F)) return false;
    const float below = std::floor(v);
    const int y0 = m.whole_y + static_cast<int>(below), y1 = y0 + (v > below ? 1 : 0);
    if (y0 < 0 || y1 >= camera.view->height) return false;
    int begin = 0, end = camera.view->width;
    if (camera.masked) {
      if (y0 < camera.spans_y0 || y1 >= camera.spans_y1) return false;
      const PresentSpan &upper = camera.spans[y0 - camera.spans_y0],
                        &lower = camera.spans[y1 - camera.spans_y0];
      begin = std::max(upper.begin, lower.begin);
      end = std::min(upper.end, lower.end);
    }
    const auto stride = static_cast<std::size_t>(camera.view->width);
    const auto x = static_cast<std::size_t>(static_cast<std::ptrdiff_t>(m.whole_x));
    out.push_back({camera.view, &m, static_cast<std::size_t>(y0) * stride + x,
                   static_cast<std::size_t>(y1) * stride + x, v - below, w1, w2, begin - m.whole_x,
                   end - m.whole_x});
  }
  return true;
}

/// Equation 5 of one vector, if every camera meets it with lanes side by side, one at most a pixel nearer or
/// farther than the rest, and all is there; else false.
template <class T, int C>
HWY_INLINE bool row_vector(const WarpJob& job, const std::vector<RowCamera>& cameras, int col, float* E0) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  const V gx = hn::LoadU(d, job.gx + col), zero = hn::Zero(d), one = hn::Set(d, 1);
  const V snap = hn::Set(d, static_cast<float>(FocalPlaneRenderer::kSnap_px));
  const V lane = hn::ConvertTo(d, hn::Iota(di, 0));
  V d1[C], d2[C];
  for (int c = 0; c < C; ++c) d1[c] = d2[c] = zero;
  for (const RowCamera& camera : cameras) {
    const WarpMap& m = *camera.map;
    // Of the first and the last lane. At a slope near 1 px a pixel those between lie between.
    const float u0 = std::floor(m.slope * job.gx[col] + m.frac_x);
    const float u1 = std::floor(m.slope * job.gx[col + lanes - 1] + m.frac_x) - static_cast<float>(lanes - 1);
    const float low = std::min(u0, u1);
    // Also for NaN.
    if (!(std::abs(u1 - u0) <= 1) || !(std::abs(low) < 1e6F)) return false;
    const bool even = u0 == u1;
    const int i = static_cast<int>(low);
    // The last lane's right neighbours are read, too.
    if (i < camera.begin || i + lanes + (even ? 0 : 1) >= camera.end) return false;
    // 0 to 1; to 2 where a lane has moved on by a pixel.
    V f = hn::Sub(hn::MulAdd(hn::Set(d, m.slope), gx, hn::Set(d, m.frac_x)), hn::Add(hn::Set(d, low), lane));
    f = hn::IfThenElse(hn::Lt(f, snap), zero, f);
    f = hn::IfThenElse(hn::Lt(hn::Abs(hn::Sub(one, f)), snap), one, f);
    const V beyond = hn::Max(hn::Sub(f, one), zero);
    f = hn::Min(f, one);
    const V ay = hn::Set(d, camera.ay), w1 = hn::Set(d, camera.w1), w2 = hn::Set(d, camera.w2);
#pragma GCC unroll 3
    for (int c = 0; c < C; ++c) {
      const T* p = camera.view->plane<T>(c) + static_cast<std::ptrdiff_t>(camera.upper) + i;
      const T* q = camera.view->plane<T>(c) + static_cast<std::ptrdiff_t>(camera.lower) + i;
      const auto column = [&](int x) {
        const V upper = load(p + x);
        return hn::MulAdd(ay, hn::Sub(load(q + x), upper), upper);
      };
      const V left = column(0), right = column(1);
      V value = hn::MulAdd(f, hn::Sub(right, left), left);
      if (!even) value = hn::MulAdd(beyond, hn::Sub(column(2), right), value);
      d1[c] = hn::MulAdd(w1, value, d1[c]);
      d2[c] = hn::MulAdd(w2, value, d2[c]);
    }
  }
  V e = zero;
  for (int c = 0; c < C; ++c) {
    e = hn::MulAdd(hn::Set(d, job.a.a01), hn::Abs(d1[c]), e);
    e = hn::MulAdd(hn::Set(d, job.a.a02), hn::Abs(d2[c]), e);
    e = hn::MulAdd(hn::Set(d, job.a.a12), hn::Abs(hn::Sub(d2[c], d1[c])), e);
  }
  hn::StoreU(hn::Mul(e, hn::Set(d, job.scale)), d, E0);
  return true;
}

template <class T, int C>
void row_difference(const WarpJob& job, const WarpMap* maps, int x, int y, int width, int height, float* E0,
                    float* defined, float* candidate) {
  const V one = hn::Set(d, 1);
  std::vector<RowCamera> cameras;
  for (int row = y; row < y + height; ++row) {
    const bool seen = row_cameras(job, maps, row, cameras);
    for (int col = x; col < x + width; col += static_cast<int>(hn::Lanes(d))) {
      const std::size_t i = static_cast<std::size_t>(row) * job.stride + col;
      if (seen && row_vector<T, C>(job, cameras, col, E0 + i)) {
        hn::StoreU(one, d, defined + i);
        hn::StoreU(one, d, candidate + i);
      } else {
        warp_vector(job, maps, col, row, E0, defined, candidate);
      }
    }
  }
}

template <class T>
void row_difference_of(const WarpJob& job, const WarpMap* maps, int x, int y, int width, int height,
                       float* E0, float* defined, float* candidate) {
  if (job.channels == 3)
    row_difference<T, 3>(job, maps, x, y, width, height, E0, defined, candidate);
  else
    row_difference<T, 1>(job, maps, x, y, width, height, E0, defined, candidate);
}

void WarpDifference(const WarpJob& job, const WarpMap* maps, int x, int y, int width, int height, float* E0,
                    float* defined, float* candidate) {
  if (job.parallel && job.weight_stride == 0 && !job.cameras.empty()) {
    const PixelType type = job.cameras.front().view->type;
    if (type == PixelType::u8)
      row_difference_of<std::uint8_t>(job, maps, x, y, width, height, E0, defined, candidate);
    else if (type == PixelType::u16)
      row_difference_of<std::uint16_t>(job, maps, x, y, width, height, E0, defined, candidate);
    else
      row_difference_of<float>(job, maps, x, y, width, height, E0, defined, candidate);
    return;
  }
  for (int row = y; row < y + height; ++row)
    for (int col = x; col < x + width; col += static_cast<int>(hn::Lanes(d)))
      warp_vector(job, maps, col, row, E0, defined, candidate);
}

/// The maps of one camera at each lane's plane.
HWY_INLINE VectorMap gather_map(const WarpMap* maps, VI plane, int cameras, int camera) {
  static_assert(sizeof(WarpMap) == 6 * 4);
  const VI at = hn::Mul(hn::Add(hn::Mul(plane, hn::Set(di, cameras)), hn::Set(di, camera)), hn::Set(di, 6));
  const auto* i = reinterpret_cast<const std::int32_t*>(maps);
  const auto* f = reinterpret_cast<const float*>(maps);
  const VI visible = hn::GatherIndex(di, i + 5, at);
  return {hn::GatherIndex(di, i, at),    hn::GatherIndex(di, i + 1, at),
          hn::GatherIndex(d, f + 2, at), hn::GatherIndex(d, f + 3, at),
          hn::GatherIndex(d, f + 4, at), hn::RebindMask(d, hn::Gt(visible, hn::Zero(di)))};
}

void WarpColour(const WarpJob& job, const WarpMap* maps, const std::int32_t* plane, int width, int height,
                float* colour, std::size_t plane_size, float* coverage) {
  const int lanes = static_cast<int>(hn::Lanes(d));
  bool takes_part[3] = {false, false, false};
  takes_part[job.k] = true;
  const int cameras = static_cast<int>(job.cameras.size());
  for (int row = 0; row < height; ++row) {
    for (int col = 0; col < width; col += lanes) {
      const std::size_t i = static_cast<std::size_t>(row) * job.stride + col;
      const V gx = hn::LoadU(d, job.gx + (job.parallel ? static_cast<std::size_t>(col) : i));
      const V gy = job.parallel ? hn::Set(d, job.gy[row]) : hn::LoadU(d, job.gy + i);
      const std::size_t w = static_cast<std::size_t>(row) * job.weight_stride + col;
      const VI n = hn::LoadU(di, plane + i);
      const auto found = hn::RebindMask(d, hn::Gt(n, hn::Set(di, -1)));
      const VI chosen = hn::Max(n, hn::Zero(di));
      const std::int32_t first = hn::GetLane(chosen);
      const bool same = hn::AllTrue(di, hn::Eq(chosen, hn::Set(di, first)));
      Sums sums;
      clear(sums);
      for (int c = 0; c < cameras; ++c) {
        const WarpCamera& camera = job.cameras[static_cast<std::size_t>(c)];
        if (camera.weight[job.k] == nullptr) continue;
        V weight[3] = {hn::Zero(d), hn::Zero(d), hn::Zero(d)};
        weight[job.k] = hn::IfThenElseZero(found, hn::LoadU(d, camera.weight[job.k] + w));
        if (hn::AllFalse(d, hn::Gt(weight[job.k], hn::Zero(d)))) continue;
        VectorMap map;
        if (same) {
          const WarpMap& m = maps[static_cast<std::size_t>(first) * cameras + c];
          map = {hn::Set(di, m.whole_x), hn::Set(di, m.whole_y), hn::Set(d, m.frac_x),
                 hn::Set(d, m.frac_y),   hn::Set(d, m.slope),    hn::FirstN(d, m.visible ? lanes : 0)};
        } else {
          map = gather_map(maps, chosen, cameras, c);
        }
        dispatch(job, camera, map, gx, gy, weight, takes_part, sums);
      }
      const M any = hn::Gt(sums.weight[job.k], hn::Zero(d));
      const V inverse = hn::IfThenElseZero(any, hn::Div(hn::Set(d, job.scale), sums.weight[job.k]));
      for (int c = 0; c < job.channels; ++c)
        hn::StoreU(hn::Mul(sums.colour[job.k][c], inverse), d, colour + plane_size * c + i);
      hn::StoreU(hn::Min(sums.weight[job.k], hn::Set(d, 1)), d, coverage + i);
    }
  }
}

/// One channel of a vector of pixels that lie on one plane.
template <class T>
HWY_INLINE V blend(const ColourTap* taps, std::size_t cameras, std::ptrdiff_t at, int channel) {
  V sum = hn::Zero(d);
  for (std::size_t c = 0; c < cameras; ++c) {
    const ColourTap& tap = taps[c];
    const T* p = tap.view->plane<T>(channel) + tap.offset + at;
    const T* q = p + (tap.two_rows ? tap.view->width : 0);
    sum = hn::MulAdd(hn::Set(d, tap.w[0]), load(p), sum);
    if (tap.two_columns) sum = hn::MulAdd(hn::Set(d, tap.w[1]), load(p + 1), sum);
    if (!tap.two_rows) continue;
    sum = hn::MulAdd(hn::Set(d, tap.w[2]), load(q), sum);
    if (tap.two_columns) sum = hn::MulAdd(hn::Set(d, tap.w[3]), load(q + 1), sum);
  }
  return sum;
}

template <class T>
void colour_rows(const ColourJob& job, int x, int y, int width, int height, const std::int32_t* plane,
                 std::size_t stride, float* colour, std::size_t plane_size) {
  for (int row = 0; row < height; ++row) {
    for (int col = 0; col < width; col += static_cast<int>(hn::Lanes(d))) {
      const std::size_t i = static_cast<std::size_t>(row) * stride + col;
      const VI n = hn::LoadU(di, plane + i);
      auto open = hn::And(hn::Gt(n, hn::Set(di, -1)), hn::FirstN(di, static_cast<std::size_t>(width - col)));
      V sum[3] = {hn::Zero(d), hn::Zero(d), hn::Zero(d)};
      // Most vectors hold one plane, few more than two.
      for (std::intptr_t lane; (lane = hn::FindFirstTrue(di, open)) >= 0;) {
        const std::int32_t p = plane[i + static_cast<std::size_t>(lane)];
        const ColourTap* taps = job.taps.data() + static_cast<std::size_t>(p) * job.cameras;
        const std::ptrdiff_t at = static_cast<std::ptrdiff_t>(y + row) * taps[0].view->width + x + col;
        const auto here = hn::And(open, hn::Eq(n, hn::Set(di, p)));
        for (int c = 0; c < job.channels; ++c)
          sum[c] = hn::IfThenElse(hn::RebindMask(d, here), blend<T>(taps, job.cameras, at, c), sum[c]);
        open = hn::AndNot(here, open);
      }
      for (int c = 0; c < job.channels; ++c) hn::StoreU(sum[c], d, colour + plane_size * c + i);
    }
  }
}

void ShiftColour(const ColourJob& job, int x, int y, int width, int height, const std::int32_t* plane,
                 std::size_t stride, float* colour, std::size_t plane_size) {
  if (job.type == PixelType::u8)
    colour_rows<std::uint8_t>(job, x, y, width, height, plane, stride, colour, plane_size);
  else if (job.type == PixelType::u16)
    colour_rows<std::uint16_t>(job, x, y, width, height, plane, stride, colour, plane_size);
  else
    colour_rows<float>(job, x, y, width, height, plane, stride, colour, plane_size);
}

/// out += in, count values (rounded up to vectors).
HWY_INLINE void add_row(const float* in, float* out, int count) {
  for (int i = 0; i < count; i += static_cast<int>(hn::Lanes(d)))
    hn::StoreU(hn::Add(hn::LoadU(d, out + i), hn::LoadU(d, in + i)), d, out + i);
}

/// Calls add(offset) for the parts of a window of `length`, and doubles(have) to double sums of `have`
/// values.
template <class Add, class Double>
HWY_INLINE void by_doubling(int length, const Add& add, const Double& doubles) {
  int offset = 0;
  for (int have = 1;; have *= 2) {
    if (length & have) {
      add(offset);
      offset += have;
    }
    if (offset == length) return;
    doubles(have);
  }
}

/// out[i] = sum of in[i + k], k < length, count values (rounded up to vectors).
HWY_INLINE void sum_row(const float* in, int length, float* out, int count) {
  for (int i = 0; i < count; i += static_cast<int>(hn::Lanes(d))) {
    V sum = hn::LoadU(d, in + i);
    for (int k = 1; k < length; ++k) sum = hn::Add(sum, hn::LoadU(d, in + i + k));
    hn::StoreU(sum, d, out + i);
  }
}

/// R outputs of sums of L values, L odd and below 10: pairs, and pairs of pairs, serve several sums. Each sum
/// is made in the same order, whatever R.
template <int L, int R>
HWY_INLINE void sums_of(const V* v, V* sum) {
  V two[R + L - 2], four[R + L];
#pragma GCC unroll 16
  for (int i = 0; i < R + L - 2; ++i) two[i] = hn::Add(v[i], v[i + 1]);
  if constexpr (L >= 5) {
#pragma GCC unroll 16
    for (int i = 0; i < R + L - 4; ++i) four[i] = hn::Add(two[i], two[i + 2]);
  }
#pragma GCC unroll 16
  for (int r = 0; r < R; ++r) {
    if constexpr (L == 3) sum[r] = hn::Add(two[r], v[r + 2]);
    if constexpr (L == 5) sum[r] = hn::Add(four[r], v[r + 4]);
    if constexpr (L == 7) sum[r] = hn::Add(hn::Add(four[r], two[r + 4]), v[r + 6]);
    if constexpr (L == 9) sum[r] = hn::Add(hn::Add(four[r], four[r + 4]), v[r + 8]);
  }
}

template <int L, int R>
HWY_INLINE void sum_down_rows(const float* in, std::size_t in_stride, int width, float* out,
                              std::size_t out_stride) {
  for (int x = 0; x < width; x += static_cast<int>(hn::Lanes(d))) {
    V v[R + L - 1], sum[R];
#pragma GCC unroll 16
    for (int i = 0; i < R + L - 1; ++i) v[i] = hn::LoadU(d, in + i * in_stride + x);
    sums_of<L, R>(v, sum);
#pragma GCC unroll 16
    for (int r = 0; r < R; ++r) hn::StoreU(sum[r], d, out + r * out_stride + x);
  }
}

/// out(x, y) = sum of in(x, y + k), k < L.
template <int L>
void sum_down(const float* in, std::size_t in_stride, int width, int height, float* out,
              std::size_t out_stride) {
  constexpr int R = kRows;
  int y = 0;
  for (; y + R <= height; y += R)
    sum_down_rows<L, R>(in + y * in_stride, in_stride, width, out + y * out_stride, out_stride);
  for (; y < height; ++y)
    sum_down_rows<L, 1>(in + y * in_stride, in_stride, width, out + y * out_stride, out_stride);
}

/// Windows up to this M are summed one by one: the values are then read from the nearest cache, and nothing
/// but the sum is written.
constexpr int kLeastDoubled = 5;

void SumRows(float* in, std::size_t stride, int width, int height, int M_x, std::vector<float>& scratch) {
  scratch.resize(static_cast<std::size_t>(width) + 64);
  float* sum = scratch.data();
  for (int y = 0; y < height; ++y) {
    float* row = in + static_cast<std::size_t>(y) * stride;
    if (M_x < kLeastDoubled) {
      sum_row(row, 2 * M_x + 1, row, width);  // writes where it has read already
      continue;
    }
    std::fill_n(sum, width, 0.0F);
    by_doubling(
        2 * M_x + 1, [&](int offset) { add_row(row + offset, sum, width); },
        [&](int have) { add_row(row + have, row, width + 2 * M_x - have); });
    std::copy_n(sum, width, row);
  }
}

void SumColumns(float* in, std::size_t in_stride, int width, int height, int M_y, float* out,
                std::size_t out_stride) {
  if (M_y == 1) return sum_down<3>(in, in_stride, width, height, out, out_stride);
  if (M_y == 2) return sum_down<5>(in, in_stride, width, height, out, out_stride);
  if (M_y == 3) return sum_down<7>(in, in_stride, width, height, out, out_stride);
  if (M_y == 4) return sum_down<9>(in, in_stride, width, height, out, out_stride);
  for (int y = 0; y < height; ++y) std::fill_n(out + static_cast<std::size_t>(y) * out_stride, width, 0.0F);
  int have_rows = height + 2 * M_y;
  by_doubling(
      2 * M_y + 1,
      [&](int offset) {
        for (int y = 0; y < height; ++y)
          add_row(in + static_cast<std::size_t>(y + offset) * in_stride,
                  out + static_cast<std::size_t>(y) * out_stride, width);
      },
      [&](int have) {
        have_rows -= have;
        for (int y = 0; y < have_rows; ++y)
          add_row(in + static_cast<std::size_t>(y + have) * in_stride,
                  in + static_cast<std::size_t>(y) * in_stride, width);
      });
}

/// Adds the costs e of plane `number` to a vector of pixels: where `valid` it is a candidate, where `defined`
/// it has a cost.
HWY_INLINE void add_costs(const MinimumRow& best, int i, VI number, V e, M valid, M defined, V margin) {
  const V E_min = hn::LoadU(d, best.E_min + i);
  const VI plane = hn::LoadU(di, best.plane + i);
  const M none = hn::RebindMask(d, hn::Lt(plane, hn::Zero(di)));
  // Clearly smaller, or equal and farther.
  const M farther = hn::RebindMask(d, hn::Lt(number, plane));
  const M smaller = hn::Lt(hn::Add(e, margin), E_min);
  const M equal = hn::And(farther, hn::Le(e, hn::Add(E_min, margin)));
  const M better = hn::And(valid, hn::Or(none, hn::Or(smaller, equal)));
  hn::StoreU(hn::IfThenElse(better, e, E_min), d, best.E_min + i);
  hn::StoreU(hn::IfThenElse(hn::RebindMask(di, better), number, plane), di, best.plane + i);
  const V E_sum = hn::LoadU(d, best.E_sum + i), E_count = hn::LoadU(d, best.E_count + i);
  hn::StoreU(hn::Add(E_sum, hn::IfThenElseZero(defined, e)), d, best.E_sum + i);
  hn::StoreU(hn::Add(E_count, hn::IfThenElseZero(defined, hn::Set(d, 1))), d, best.E_count + i);
}

void AddPlane(const MinimumRow& best, int n, int width, const float* sum, const float* inverse, float tie) {
  const V margin = hn::Set(d, tie);
  const VI number = hn::Set(di, n);
  for (int i = 0; i < width; i += static_cast<int>(hn::Lanes(d))) {
    const M here = hn::FirstN(d, static_cast<std::size_t>(width - i));
    const V e = hn::Mul(hn::LoadU(d, sum + i), hn::LoadU(d, inverse + i));
    add_costs(best, i, number, e, here, here, margin);
  }
}

void AddPartPlane(const MinimumRow& best, int n, int width, const float* sum, const float* count,
                  const float* candidate, float tie) {
  const V infinity = hn::Inf(d), zero = hn::Zero(d), margin = hn::Set(d, tie);
  const VI number = hn::Set(di, n);
  for (int i = 0; i < width; i += static_cast<int>(hn::Lanes(d))) {
    const M here = hn::FirstN(d, static_cast<std::size_t>(width - i));
    const V c = hn::LoadU(d, count + i);
    const M valid = hn::And(here, hn::Gt(hn::LoadU(d, candidate + i), zero));
    const M defined = hn::And(valid, hn::Gt(c, zero));
    const V e = hn::IfThenElse(defined, hn::Div(hn::LoadU(d, sum + i), c), infinity);
    add_costs(best, i, number, e, valid, defined, margin);
  }
}

double MeasureMultiplyAdds(double seconds) {
  using Clock = std::chrono::steady_clock;
  constexpr int kChains = 10, kSteps = 20000;  // more chains than a multiply-add takes cycles
  V chains[kChains];
  for (int i = 0; i < kChains; ++i) chains[i] = hn::Set(d, 1.0F + 0.001F * static_cast<float>(i));
  const V a = hn::Set(d, 0.999F), b = hn::Set(d, 0.001F);
  double done = 0, elapsed = 0;
  const auto start = Clock::now();
  while (elapsed < seconds) {
    for (int step = 0; step < kSteps; ++step) {
#pragma GCC unroll 10
      for (int i = 0; i < kChains; ++i) chains[i] = hn::MulAdd(a, chains[i], b);
    }
    done += static_cast<double>(kSteps) * kChains * static_cast<double>(hn::Lanes(d));
    elapsed = std::chrono::duration<double>(Clock::now() - start).count();
  }
  V sum = chains[0];
  for (int i = 1; i < kChains; ++i) sum = hn::Add(sum, chains[i]);
  // So that the loop is not optimised away.
  return hn::GetLane(sum) > -1 ? done / elapsed : 0;
}

const char* TargetName() { return hwy::TargetName(HWY_TARGET); }

}  // namespace
}  // namespace stuv::kernels::HWY_NAMESPACE
#if HWY_TARGET == HWY_AVX3_DL
HWY_POP_ATTRIBUTES
#endif
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace stuv::kernels {

HWY_EXPORT(ShiftDifference);
HWY_EXPORT(WarpDifference);
HWY_EXPORT(WarpColour);
HWY_EXPORT(ShiftColour);
HWY_EXPORT(SumRows);
HWY_EXPORT(SumColumns);
HWY_EXPORT(AddPlane);
HWY_EXPORT(AddPartPlane);
HWY_EXPORT(TargetName);
HWY_EXPORT(MeasureMultiplyAdds);

double multiply_adds(const ShiftJob& job) {
  double count = 0;
  for (std::size_t t = 0; t < job.taps.size(); ++t)
    count += (job.taps[t].two_columns ? 2 : 0) + (job.taps[t].two_rows ? 2 : 1) * (t < job.in_second ? 2 : 1);
  // The weighted differences, and their sum over the channels.
  count += job.a.a12 != 0 ? 5 : 3;
  return count * job.channels;
}

double multiply_adds_of_window(int M_x, int M_y) {
  const auto additions = [](int M) { return std::bit_width(2U * M + 1) + std::popcount(2U * M + 1) - 2; };
  // The mean, two comparisons, and the sums for the confidence.
  return additions(M_x) + additions(M_y) + 6;
}

void shift_difference(const ShiftJob& job, int x, int y, int width, int height, float* E0,
                      std::size_t stride) {
  HWY_DYNAMIC_DISPATCH(ShiftDifference)(job, x, y, width, height, E0, stride);
}
void warp_difference(const WarpJob& job, const WarpMap* maps, int x, int y, int width, int height, float* E0,
                     float* defined, float* candidate) {
  HWY_DYNAMIC_DISPATCH(WarpDifference)(job, maps, x, y, width, height, E0, defined, candidate);
}
void warp_colour(const WarpJob& job, const WarpMap* maps, const std::int32_t* plane, int width, int height,
                 float* colour, std::size_t plane_size, float* coverage) {
  HWY_DYNAMIC_DISPATCH(WarpColour)(job, maps, plane, width, height, colour, plane_size, coverage);
}
void shift_colour(const ColourJob& job, int x, int y, int width, int height, const std::int32_t* plane,
                  std::size_t stride, float* colour, std::size_t plane_size) {
  HWY_DYNAMIC_DISPATCH(ShiftColour)(job, x, y, width, height, plane, stride, colour, plane_size);
}
void sum_rows(float* in, std::size_t stride, int width, int height, int M, std::vector<float>& scratch) {
  HWY_DYNAMIC_DISPATCH(SumRows)(in, stride, width, height, M, scratch);
}
void sum_columns(float* in, std::size_t in_stride, int width, int height, int M, float* out,
                 std::size_t out_stride) {
  HWY_DYNAMIC_DISPATCH(SumColumns)(in, in_stride, width, height, M, out, out_stride);
}
void add_plane(const MinimumRow& best, int n, int width, const float* sum, const float* inverse, float tie) {
  HWY_DYNAMIC_DISPATCH(AddPlane)(best, n, width, sum, inverse, tie);
}
void add_part_plane(const MinimumRow& best, int n, int width, const float* sum, const float* count,
                    const float* candidate, float tie) {
  HWY_DYNAMIC_DISPATCH(AddPartPlane)(best, n, width, sum, count, candidate, tie);
}
const char* target_name() { return HWY_DYNAMIC_DISPATCH(TargetName)(); }
double measure_multiply_adds(double seconds) { return HWY_DYNAMIC_DISPATCH(MeasureMultiplyAdds)(seconds); }

}  // namespace stuv::kernels
#endif
