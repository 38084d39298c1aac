#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <utility>
#include <vector>

namespace stuv {

/// Leaves values unset where none is given: pictures that are written whole, or in parallel, are not filled
/// before.
template <class T>
struct UnsetAllocator : std::allocator<T> {
  template <class U>
  struct rebind {
    using other = UnsetAllocator<U>;
  };
  template <class U>
  void construct(U* place) {
    ::new (static_cast<void*>(place)) U;
  }
  template <class U, class... Args>
  void construct(U* place, Args&&... args) {
    ::new (static_cast<void*>(place)) U(std::forward<Args>(args)...);
  }
};

/// A plain array of pixels, row by row, channels interleaved: data[(y * width + x) * channels + c].
template <class T>
struct Raster {
  int width = 0, height = 0, channels = 1;
  std::vector<T, UnsetAllocator<T>> data;

  Raster() = default;
  Raster(int w, int h, int c, T value = T{})
      : width(w), height(h), channels(c), data(static_cast<std::size_t>(w) * h * c, value) {}

  /// Values are not set.
  static Raster unset(int w, int h, int c) {
    Raster out;
    out.width = w, out.height = h, out.channels = c;
    out.data.resize(static_cast<std::size_t>(w) * h * c);
    return out;
  }

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
