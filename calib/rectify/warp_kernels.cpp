#include "calib/rectify/warp_kernels.h"

#include <algorithm>

#include "calib/rectify/lens_map.h"

// Vectors of at most eight floats: the taps of a row.
#define HWY_DISABLED_TARGETS                                                                        \
  (HWY_SSSE3 | HWY_AVX3_DL | HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128 | HWY_RVV | HWY_WASM | \
   HWY_WASM_EMU256)
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "calib/rectify/warp_kernels.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace stuv::warp_kernels::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;

void Positions(const CubicRow& row, int step, int count, int width, int height, std::int32_t* qx,
               std::int32_t* qy) {
  constexpr auto kUnit = static_cast<float>(LensMap::kPhases);
  const float scale = 1.0F / static_cast<float>(step);
  const std::int32_t last_x = (width - 1) * LensMap::kPhases, last_y = (height - 1) * LensMap::kPhases;
  const std::int32_t base_x = row.base_x * LensMap::kPhases, base_y = row.base_y * LensMap::kPhases;
  // A whole number added before the conversion, which cuts off, makes it round to nearest below zero too.
  constexpr std::int32_t kShift = 1 << 22;
  for (int i = 0; i < count; ++i) {
    const float t = static_cast<float>(i) * scale;
    const float x = row.x[0] + t * (row.x[1] + t * (row.x[2] + t * row.x[3]));
    const float y = row.y[0] + t * (row.y[1] + t * (row.y[2] + t * row.y[3]));
    const std::int32_t ix =
        static_cast<std::int32_t>(x * kUnit + 0.5F + static_cast<float>(kShift)) - kShift + base_x;
    const std::int32_t iy =
        static_cast<std::int32_t>(y * kUnit + 0.5F + static_cast<float>(kShift)) - kShift + base_y;
    const bool inside = (ix >= 0) & (iy >= 0) & (ix <= last_x) & (iy <= last_y);
    qx[i] = inside ? ix : LensMap::kNowhere;
    qy[i] = inside ? iy : LensMap::kNowhere;
  }
}

#if HWY_TARGET != HWY_SCALAR

template <class D>
HWY_INLINE hn::Vec<D> pairs(D d, hn::Vec<D> a, hn::Vec<D> b) {
  return hn::Add(hn::InterleaveLower(d, a, b), hn::InterleaveUpper(d, a, b));
}

/// The sums over the lanes of four vectors: a transposition by halves, added up on the way.
template <class D>
HWY_INLINE void store_sums(D d, hn::Vec<D> a, hn::Vec<D> b, hn::Vec<D> c, hn::Vec<D> e, float* out) {
  // In every block of four: a02 c02 a13 c13 and b02 e02 b13 e13, then a b c e.
  const auto sums = pairs(d, pairs(d, a, c), pairs(d, b, e));
  const hn::CappedTag<float, 4> d4;
  if constexpr (hn::MaxLanes(D()) == 8) {
    hn::StoreU(hn::Add(hn::LowerHalf(d4, sums), hn::UpperHalf(d4, sums)), d4, out);
  } else {
    hn::StoreU(sums, d4, out);
  }
}

/// The six rows of one pixel, weighed down the column and along the row; lanes are still to be added up.
template <class D>
HWY_INLINE hn::Vec<D> rows_of(D d, const float* p, int stride, const float* wx, const float* wy) {
  const auto column = [&](const float* q) {
    auto sum = hn::Mul(hn::Set(d, wy[0]), hn::LoadU(d, q));
    for (int j = 1; j < kTaps; ++j) {
      q += stride;
      sum = hn::MulAdd(hn::Set(d, wy[j]), hn::LoadU(d, q), sum);
    }
    return sum;
  };
  auto sum = hn::Mul(column(p), hn::LoadU(d, wx));
  if constexpr (hn::MaxLanes(D()) == 4) sum = hn::MulAdd(column(p + 4), hn::LoadU(d, wx + 4), sum);
  return sum;
}

void Interpolate(const float* box, int stride, const Weights* table, const std::int32_t* qx,
                 const std::int32_t* qy, int count, float* out) {
  const hn::CappedTag<float, 8> d;
  constexpr int kMask = LensMap::kPhases - 1;
  const auto at = [&](int i) HWY_ATTR {
    const int x = qx[i], y = qy[i];
    return rows_of(d, box + (y >> LensMap::kPhaseBits) * stride + (x >> LensMap::kPhaseBits), stride,
                   table[x & kMask], table[y & kMask]);
  };
  int i = 0;
  for (; i + 4 <= count; i += 4) store_sums(d, at(i), at(i + 1), at(i + 2), at(i + 3), out + i);
  float rest[4];
  for (; i < count; ++i) {
    const auto v = at(i);
    store_sums(d, v, v, v, v, rest);
    out[i] = rest[0];
  }
}

#else

void Interpolate(const float* box, int stride, const Weights* table, const std::int32_t* qx,
                 const std::int32_t* qy, int count, float* out) {
  constexpr int kMask = LensMap::kPhases - 1;
  for (int i = 0; i < count; ++i) {
    const float* p = box + (qy[i] >> LensMap::kPhaseBits) * stride + (qx[i] >> LensMap::kPhaseBits);
    const float *wx = table[qx[i] & kMask], *wy = table[qy[i] & kMask];
    float sum = 0;
    for (int j = 0; j < kTaps; ++j) {
      float line = 0;
      for (int k = 0; k < kTaps; ++k) line += wx[k] * p[j * stride + k];
      sum += wy[j] * line;
    }
    out[i] = sum;
  }
}

#endif

template <class T>
HWY_INLINE void load_planes(const T* from, int channels, int count, float* to, std::size_t pitch) {
  if (channels == 1) {
    for (int i = 0; i < count; ++i) to[i] = from[i];
  } else {
    for (int i = 0; i < count; ++i) {
      to[i] = from[3 * i];
      to[pitch + i] = from[3 * i + 1];
      to[2 * pitch + i] = from[3 * i + 2];
    }
  }
}

template <class T>
HWY_INLINE void store_planes(const float* from, std::size_t pitch, int channels, int count, T* to) {
  constexpr auto kTop = static_cast<float>(std::numeric_limits<T>::max());
  const auto whole = [](float v) {
    const float low = v > 0 ? v : 0;
    return static_cast<T>(static_cast<std::int32_t>((low < kTop ? low : kTop) + 0.5F));
  };
  if (channels == 1) {
    for (int i = 0; i < count; ++i) to[i] = whole(from[i]);
  } else {
    for (int i = 0; i < count; ++i)
      for (int c = 0; c < 3; ++c) to[3 * i + c] = whole(from[c * pitch + i]);
  }
}

void Load8(const std::uint8_t* from, int channels, int count, float* to, std::size_t pitch) {
  load_planes(from, channels, count, to, pitch);
}
void Load16(const std::uint16_t* from, int channels, int count, float* to, std::size_t pitch) {
  load_planes(from, channels, count, to, pitch);
}
void Store8(const float* from, std::size_t pitch, int channels, int count, std::uint8_t* to) {
  store_planes(from, pitch, channels, count, to);
}
void Store16(const float* from, std::size_t pitch, int channels, int count, std::uint16_t* to) {
  store_planes(from, pitch, channels, count, to);
}

void Correct(const Correction& c, int first, float dy2, int count, float* values) {
  for (int i = 0; i < count; ++i) {
    const float dx = static_cast<float>(first + i) - c.cx, rho = (dx * dx + dy2) * c.inv_r2;
    const float v = values[i], fall = 1 + rho * (c.v1 + rho * (c.v2 + rho * c.v3));
    const float corrected = (v - c.offset) * c.factor / fall;
    values[i] = v <= c.black ? c.black : v >= c.white ? c.white : corrected;
  }
}

const char* TargetName() { return hwy::TargetName(HWY_TARGET); }

}  // namespace
}  // namespace stuv::warp_kernels::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace stuv::warp_kernels {

HWY_EXPORT(Positions);
HWY_EXPORT(Interpolate);
HWY_EXPORT(Load8);
HWY_EXPORT(Load16);
HWY_EXPORT(Store8);
HWY_EXPORT(Store16);
HWY_EXPORT(Correct);
HWY_EXPORT(TargetName);

void positions(const CubicRow& row, int step, int count, int width, int height, std::int32_t* qx,
               std::int32_t* qy) {
  HWY_DYNAMIC_DISPATCH(Positions)(row, step, count, width, height, qx, qy);
}
void interpolate(const float* box, int stride, const Weights* table, const std::int32_t* qx,
                 const std::int32_t* qy, int count, float* out) {
  HWY_DYNAMIC_DISPATCH(Interpolate)(box, stride, table, qx, qy, count, out);
}
void load(const std::uint8_t* from, int channels, int count, float* to, std::size_t pitch) {
  HWY_DYNAMIC_DISPATCH(Load8)(from, channels, count, to, pitch);
}
void load(const std::uint16_t* from, int channels, int count, float* to, std::size_t pitch) {
  HWY_DYNAMIC_DISPATCH(Load16)(from, channels, count, to, pitch);
}
void store(const float* from, std::size_t pitch, int channels, int count, std::uint8_t* to) {
  HWY_DYNAMIC_DISPATCH(Store8)(from, pitch, channels, count, to);
}
void store(const float* from, std::size_t pitch, int channels, int count, std::uint16_t* to) {
  HWY_DYNAMIC_DISPATCH(Store16)(from, pitch, channels, count, to);
}
void correct(const Correction& c, int first, float dy2, int count, float* values) {
  HWY_DYNAMIC_DISPATCH(Correct)(c, first, dy2, count, values);
}
const char* target_name() { return HWY_DYNAMIC_DISPATCH(TargetName)(); }

}  // namespace stuv::warp_kernels
#endif
