#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include "render/view_set.h"

namespace stuv {

/// One view's pixels as they are stored, one plane a channel, filled tile by tile. Halves are kept as float.
struct StoredView {
  static constexpr int kTile = 64;
  /// Samples that may be read before and after each plane.
  static constexpr int kPadding = 64;

  int width = 0, height = 0, channels = 0;
  PixelType type = PixelType::u8;  ///< u8, u16 or f32
  std::size_t plane_bytes = 0;
  std::unique_ptr<std::byte[]> bytes;
  /// 255 where a pixel is there, of the same layout as a plane; null until a missing pixel is met.
  std::atomic<std::uint8_t*> mask{nullptr};

  ~StoredView() { delete[] mask.load(); }

  /// Pixel (0, 0) of a channel; T is the type's: std::uint8_t, std::uint16_t or float.
  template <class T>
  const T* plane(int channel) const {
    return reinterpret_cast<const T*>(bytes.get() + plane_bytes * channel) + kPadding;
  }
  const std::uint8_t* mask_plane() const {
    const std::uint8_t* all = mask.load(std::memory_order_acquire);
    return all != nullptr ? all + kPadding : nullptr;
  }

  // The store's bookkeeping.
  std::mutex loading;
  std::vector<std::atomic<bool>> loaded;  ///< per tile, row by row
  std::atomic<std::size_t> loaded_bytes{0};
  std::atomic<std::uint64_t> last_use{0};
};

/// A rectangle of pixels: x0 <= x < x1, y0 <= y < y1.
struct PixelRect {
  int x0 = 0, y0 = 0, x1 = 0, y1 = 0;
  bool empty() const { return x0 >= x1 || y0 >= y1; }
  bool operator==(const PixelRect&) const = default;
};

/// Pixels of the input views, read from disk where a ray first needs them and kept within a budget: what was
/// not used for longest is dropped. Views larger than memory are ordinary. Thread-safe.
class PixelStore {
 public:
  static constexpr std::size_t kDefaultBudget = std::size_t{256} << 20;

  explicit PixelStore(std::shared_ptr<const ViewSet> views, std::size_t budget_bytes = kDefaultBudget);

  /// The view of a camera with all pixels of `rect` (cut at the picture's borders) there. It stays valid as
  /// long as it is held, dropped from the store or not. Throws Error if a picture cannot be read.
  std::shared_ptr<const StoredView> acquire(int camera, const PixelRect& rect);

  const ViewSet& views() const { return *views_; }
  const std::shared_ptr<const ViewSet>& shared_views() const { return views_; }
  /// Tiles read since the store was made, and how many all views have.
  std::size_t tiles_read() const { return tiles_read_; }
  std::size_t tiles_total() const;

 private:
  std::shared_ptr<StoredView> make_view() const;
  void load(StoredView& view, int camera, const PixelRect& rect);
  void load_tile(StoredView& view, int camera, int tile_x, int tile_y);
  void drop_oldest(int keep);

  std::shared_ptr<const ViewSet> views_;
  std::size_t budget_;
  std::mutex mutex_;
  std::vector<std::shared_ptr<StoredView>> stored_;
  std::atomic<std::size_t> used_{0}, tiles_read_{0};
  std::atomic<std::uint64_t> clock_{0};
};

}  // namespace stuv
