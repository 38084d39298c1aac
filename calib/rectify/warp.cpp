#include "calib/rectify/warp.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstring>
#include <memory>
#include <numbers>

#include "calib/rectify/warp_kernels.h"
#include "core/parallel.h"

namespace stuv {
namespace {

using namespace warp_kernels;

constexpr int kTileWidth = 4 * LensMap::kBlock, kTileHeight = 2 * LensMap::kBlock;
constexpr int kBefore = kRadius - 1;  ///< taps left of (above) the whole part of a position

double lanczos(double d) {
  if (d == 0) return 1;
  if (std::abs(d) >= kRadius) return 0;
  const double a = std::numbers::pi * d;
  return kRadius * std::sin(a) * std::sin(a / kRadius) / (a * a);
}

struct Table {
  alignas(64) Weights weights[LensMap::kPhases] = {};
};

/// Weights of the taps floor(q) - 2 .. floor(q) + 3 by the fraction of q; each sums to 1.
const Weights* lanczos_table() {
  static const std::unique_ptr<const Table> table = [] {
    auto made = std::make_unique<Table>();
    for (int phase = 0; phase < LensMap::kPhases; ++phase) {
      std::array<double, kTaps> exact{};
      double sum = 0;
      for (int k = 0; k < kTaps; ++k)
        sum += exact[k] = lanczos(static_cast<double>(phase) / LensMap::kPhases - (k - kBefore));
      for (int k = 0; k < kTaps; ++k) made->weights[phase][k] = static_cast<float>(exact[k] / sum);
    }
    return made;
  }();
  return table->weights;
}

/// The part of the picture that a tile looks at, as planes of float; missing pixels are 0.
struct Box {
  int x = 0, y = 0, columns = 0, rows = 0;  ///< of the picture; taps may lie beyond its border
  int stride = 0;
  std::vector<float> planes, there;  ///< there: 1, or 0 where a pixel is missing
  bool complete = true;

  std::size_t pitch() const { return static_cast<std::size_t>(stride) * rows; }
};

struct Scratch {
  std::vector<std::int32_t> qx, qy;
  std::vector<std::uint8_t> seen;
  std::vector<float> out, weight;
  Box box;
};

/// What the tiles of one picture have in common.
struct Warp {
  const Image& in;
  const LensMap& map;
  const CommonView& view;
  std::vector<Correction> corrections;  ///< per channel, or none
  float cy = 0;                         ///< of the corrections
  Image& out;
  Mask& mask;
};

template <class T>
const T* pixels_of(const Image& image, int x, int y) {
  return reinterpret_cast<const T*>(image.bytes.data()) +
         (static_cast<std::size_t>(y) * image.width + x) * image.channels;
}

template <class T>
void load_floats(const T* from, int channels, int count, float* to, std::size_t pitch) {
  for (int i = 0; i < count; ++i)
    for (int c = 0; c < channels; ++c) to[c * pitch + i] = static_cast<float>(from[i * channels + c]);
}

void load_pixels(const Image& in, int x, int y, int count, float* to, std::size_t pitch) {
  switch (in.type) {
    case PixelType::u8:
      return load(pixels_of<std::uint8_t>(in, x, y), in.channels, count, to, pitch);
    case PixelType::u16:
      return load(pixels_of<std::uint16_t>(in, x, y), in.channels, count, to, pitch);
    case PixelType::f16:
      return load_floats(pixels_of<Eigen::half>(in, x, y), in.channels, count, to, pitch);
    case PixelType::f32:
      return load_floats(pixels_of<float>(in, x, y), in.channels, count, to, pitch);
  }
}

/// Sets missing pixels of a row to 0; true if there are any.
bool take_out_missing(const Image& in, int x, int y, int count, float* to, std::size_t pitch, float* there) {
  const bool is_float = in.type == PixelType::f16 || in.type == PixelType::f32;
  std::fill_n(there, count, 1.0F);
  if (in.mask.empty() && !is_float) return false;
  bool missing = false;
  for (int i = 0; i < count; ++i) {
    bool good = in.mask.empty() || in.mask.at(x + i, y) != 0;
    for (int c = 0; c < in.channels; ++c) good = good && std::isfinite(to[c * pitch + i]);
    if (good) continue;
    missing = true;
    there[i] = 0;
    for (int c = 0; c < in.channels; ++c) to[c * pitch + i] = 0;
  }
  return missing;
}

/// Repeats the ends of what lies in the picture.
void extend(float* row, int before, int count, int after) {
  std::fill_n(row, before, row[before]);
  std::fill_n(row + before + count, after, row[before + count - 1]);
}

void fill_row(const Warp& w, Box& box, int r) {
  const int y = std::clamp(box.y + r, 0, w.in.height - 1);
  const int x0 = std::max(box.x, 0), x1 = std::min(box.x + box.columns, w.in.width);
  const int before = x0 - box.x, count = x1 - x0, after = box.columns - before - count;
  float* row = box.planes.data() + static_cast<std::size_t>(r) * box.stride;
  float* there = box.there.data() + static_cast<std::size_t>(r) * box.stride;
  load_pixels(w.in, x0, y, count, row + before, box.pitch());
  for (std::size_t c = 0; c < w.corrections.size(); ++c) {
    const float dy = static_cast<float>(y) - w.cy;
    correct(w.corrections[c], x0, dy * dy, count, row + c * box.pitch() + before);
  }
  if (take_out_missing(w.in, x0, y, count, row + before, box.pitch(), there + before)) box.complete = false;
  extend(there, before, count, after);
  for (int c = 0; c < w.in.channels; ++c) extend(row + c * box.pitch(), before, count, after);
}

void fill(const Warp& w, Box& box) {
  // Vectors read two columns more than there are taps: these weigh nothing, but must be numbers.
  box.stride = (box.columns + kPadded - kTaps + 7) / 8 * 8;
  box.planes.assign(box.pitch() * w.in.channels, 0.0F);
  box.there.assign(box.pitch(), 0.0F);
  box.complete = true;
  for (int r = 0; r < box.rows; ++r) fill_row(w, box, r);
}

/// Finds what the tile sees, and makes positions relative to its box. False if it sees nothing.
bool place_box(Scratch& s, std::size_t count) {
  std::int32_t low_x = std::numeric_limits<std::int32_t>::max(), low_y = low_x, high_x = 0, high_y = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const bool seen = s.qx[i] != LensMap::kNowhere;
    s.seen[i] = seen ? 255 : 0;
    low_x = seen ? std::min(low_x, s.qx[i]) : low_x;
    low_y = seen ? std::min(low_y, s.qy[i]) : low_y;
    high_x = seen ? std::max(high_x, s.qx[i]) : high_x;
    high_y = seen ? std::max(high_y, s.qy[i]) : high_y;
  }
  if (low_x > high_x) return false;
  const int x = low_x >> LensMap::kPhaseBits, y = low_y >> LensMap::kPhaseBits;
  for (std::size_t i = 0; i < count; ++i) {
    s.qx[i] = s.seen[i] != 0 ? s.qx[i] - x * LensMap::kPhases : 0;
    s.qy[i] = s.seen[i] != 0 ? s.qy[i] - y * LensMap::kPhases : 0;
  }
  s.box.x = x - kBefore;
  s.box.y = y - kBefore;
  s.box.columns = (high_x >> LensMap::kPhaseBits) - x + kTaps;
  s.box.rows = (high_y >> LensMap::kPhaseBits) - y + kTaps;
  return true;
}

/// Takes out pixels that one of the four around a position is missing of; makes the weights of the others 1
/// again where missing pixels further away have added 0.
void mend_row(const Box& box, const std::int32_t* qx, const std::int32_t* qy, int count, int channels,
              std::uint8_t* seen, Scratch& s) {
  interpolate(box.there.data(), box.stride, lanczos_table(), qx, qy, count, s.weight.data());
  for (int i = 0; i < count; ++i) {
    const float* p = box.there.data() +
                     ((qy[i] >> LensMap::kPhaseBits) + kBefore) * static_cast<std::size_t>(box.stride) +
                     (qx[i] >> LensMap::kPhaseBits) + kBefore;
    if (p[0] * p[1] * p[box.stride] * p[box.stride + 1] == 0) seen[i] = 0;
    for (int c = 0; c < channels; ++c) s.out[c * kTileWidth + i] /= s.weight[i];
  }
}

template <class T>
void store_floats(const float* from, std::size_t pitch, int channels, int count, T* to) {
  for (int i = 0; i < count; ++i)
    for (int c = 0; c < channels; ++c) to[i * channels + c] = static_cast<T>(from[c * pitch + i]);
}

void store_pixels(const float* from, int count, int x, int y, Image& out) {
  const auto n = (static_cast<std::size_t>(y) * out.width + x) * out.channels;
  std::byte* to = out.bytes.data() + n * bytes_per_sample(out.type);
  switch (out.type) {
    case PixelType::u8:
      return store(from, kTileWidth, out.channels, count, reinterpret_cast<std::uint8_t*>(to));
    case PixelType::u16:
      return store(from, kTileWidth, out.channels, count, reinterpret_cast<std::uint16_t*>(to));
    case PixelType::f16:
      return store_floats(from, kTileWidth, out.channels, count, reinterpret_cast<Eigen::half*>(to));
    case PixelType::f32:
      return store_floats(from, kTileWidth, out.channels, count, reinterpret_cast<float*>(to));
  }
}

/// True if all of the tile's pixels are there.
bool warp_tile(const Warp& w, int x, int y, Scratch& s) {
  const int width = std::min(kTileWidth, w.out.width - x), height = std::min(kTileHeight, w.out.height - y);
  const auto count = static_cast<std::size_t>(width) * height;
  s.qx.resize(count);
  s.qy.resize(count);
  s.seen.resize(count);
  w.map.block(x, y, width, height, s.qx.data(), s.qy.data());
  if (!place_box(s, count)) return false;  // the picture is black and masked to begin with
  fill(w, s.box);
  bool complete = true;
  for (int j = 0; j < height; ++j) {
    const std::int32_t *qx = s.qx.data() + j * width, *qy = s.qy.data() + j * width;
    std::uint8_t* seen = s.seen.data() + j * width;
    for (int c = 0; c < w.in.channels; ++c)
      interpolate(s.box.planes.data() + c * s.box.pitch(), s.box.stride, lanczos_table(), qx, qy, width,
                  s.out.data() + static_cast<std::size_t>(c) * kTileWidth);
    if (!s.box.complete) mend_row(s.box, qx, qy, width, w.in.channels, seen, s);
    for (int i = 0; i < width; ++i) {
      if (seen[i] != 0) continue;
      complete = false;
      for (int c = 0; c < w.in.channels; ++c) s.out[c * kTileWidth + i] = 0;
    }
    store_pixels(s.out.data(), width, x, y + j, w.out);
    std::copy_n(seen, width, w.mask.row(y + j) + x);
  }
  return complete;
}

std::vector<Correction> corrections_of(const Image& image, const CameraPhotometry& p) {
  // Integers are not scaled. Float pictures clip nowhere.
  const bool whole = image.type == PixelType::u8 || image.type == PixelType::u16;
  const float top = image.type == PixelType::u8 ? 255.0F : image.type == PixelType::u16 ? 65535.0F : 1.0F;
  constexpr float kInf = std::numeric_limits<float>::infinity();
  const float white = whole ? std::round(static_cast<float>(white_level(image)) * top) : kInf;
  std::vector<Correction> corrections;
  for (int c = 0; c < image.channels; ++c) {
    const double gain = p.gain[image.channels == 1 ? 0 : c], offset = p.offset[image.channels == 1 ? 0 : c];
    corrections.push_back({static_cast<float>(offset) * top, static_cast<float>(1 / gain),
                           static_cast<float>(p.falloff[0]), static_cast<float>(p.falloff[1]),
                           static_cast<float>(p.falloff[2]), static_cast<float>(p.centre_px.x()),
                           static_cast<float>(1 / (p.corner_px * p.corner_px)), whole ? 0.0F : -kInf, white});
  }
  return corrections;
}

}  // namespace

Image warp_to_common_view(const Image& image, const LensMap& map, const CommonView& view,
                          const CameraPhotometry* photometry) {
  Image out{view.width, view.height, image.channels, image.type, {}, Mask(view.width, view.height, 1)};
  out.bytes.resize(static_cast<std::size_t>(view.width) * view.height * image.channels *
                   bytes_per_sample(image.type));
  Warp warp{image, map, view, {}, 0, out, out.mask};
  if (photometry != nullptr) {
    warp.corrections = corrections_of(image, *photometry);
    warp.cy = static_cast<float>(photometry->centre_px.y());
  }
  tbb::enumerable_thread_specific<Scratch> scratch([] {
    Scratch s;
    s.out.resize(3 * kTileWidth);
    s.weight.resize(kTileWidth);
    return s;
  });
  const int columns = (view.width + kTileWidth - 1) / kTileWidth;
  const int rows = (view.height + kTileHeight - 1) / kTileHeight;
  std::atomic<bool> complete = true;
  parallel_for(columns * rows, [&](int tile) {
    if (!warp_tile(warp, tile % columns * kTileWidth, tile / columns * kTileHeight, scratch.local()))
      complete = false;
  });
  if (complete) out.mask = {};
  return out;
}

Image warp_to_common_view(const Image& image, const Camera& camera, const CommonView& view) {
  return warp_to_common_view(image, LensMap(camera, view), view);
}

}  // namespace stuv
