#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace stuv {

/// A plain array of pixels, row by row, channels interleaved: data[(y * width + x) * channels + c].
template <class T>
struct Raster {
  int width = 0, height = 0, channels = 1;
  std::vector<T> data;

  Raster() = default;
  Raster(int w, int h, int c, T value = T{})
      : width(w), height(h), channels(c), data(static_cast<std::size_t>(w) * h * c, value) {}

  bool empty() const { return data.empty(); }
  T* row(int y) { return data.data() + static_cast<std::size_t>(y) * width * channels; }
  const T* row(int y) const { return data.data() + static_cast<std::size_t>(y) * width * channels; }
  T& at(int x, int y, int c = 0) { return row(y)[static_cast<std::size_t>(x) * channels + c]; }
  const T& at(int x, int y, int c = 0) const { return row(y)[static_cast<std::size_t>(x) * channels + c]; }
};

using ImageF = Raster<float>;
/// 255 where a pixel is there, 0 where it is missing. An empty mask means that all are there.
using Mask = Raster<std::uint8_t>;

}  // namespace stuv
