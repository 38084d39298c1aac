#include "render/pixel_store.h"

#include <algorithm>
#include <cmath>
#include <cstring>

namespace stuv {
namespace {

PixelType stored_type(PixelType type) { return type == PixelType::f16 ? PixelType::f32 : type; }

int tiles_along(int size) { return (size + StoredView::kTile - 1) / StoredView::kTile; }

/// As core's from_float rounds, so that integers come back as they were stored.
template <class T>
T stored_value(float v, float scale) {
  if constexpr (std::is_floating_point_v<T>)
    return v;
  else
    return static_cast<T>(std::lrint(v * scale));
}

template <class T>
void copy_tile(StoredView& view, const ViewPixels& tile, int x0, int y0) {
  const float scale = view.type == PixelType::u8 ? 255.0F : 65535.0F;
  for (int c = 0; c < view.channels; ++c) {
    T* plane = const_cast<T*>(view.plane<T>(c));
    for (int y = 0; y < tile.colour.height; ++y)
      for (int x = 0; x < tile.colour.width; ++x)
        plane[static_cast<std::size_t>(y0 + y) * view.width + x0 + x] =
            stored_value<T>(tile.colour.at(x, y, c), scale);
  }
}

}  // namespace

PixelStore::PixelStore(std::shared_ptr<const ViewSet> views, std::size_t budget_bytes)
    : views_(std::move(views)), budget_(budget_bytes), stored_(views_->cameras.size()) {}

std::size_t PixelStore::tiles_total() const {
  const LightField& lf = views_->lf;
  return views_->cameras.size() * static_cast<std::size_t>(tiles_along(lf.width)) *
         static_cast<std::size_t>(tiles_along(lf.height));
}

std::shared_ptr<StoredView> PixelStore::make_view() const {
  const LightField& lf = views_->lf;
  auto view = std::make_shared<StoredView>();
  view->width = lf.width;
  view->height = lf.height;
  view->channels = lf.channels;
  view->type = stored_type(lf.type);
  const std::size_t samples = static_cast<std::size_t>(lf.width) * lf.height + 2 * StoredView::kPadding;
  view->plane_bytes = samples * bytes_per_sample(view->type);
  // Left as it is: pages that no tile is written to take no memory.
  view->bytes = std::make_unique_for_overwrite<std::byte[]>(view->plane_bytes * lf.channels);
  view->loaded = std::vector<std::atomic<bool>>(static_cast<std::size_t>(tiles_along(lf.width)) *
                                                tiles_along(lf.height));
  return view;
}

void PixelStore::load_tile(StoredView& view, int camera, int tile_x, int tile_y) {
  const int x0 = tile_x * StoredView::kTile, y0 = tile_y * StoredView::kTile;
  const int width = std::min(StoredView::kTile, view.width - x0);
  const int height = std::min(StoredView::kTile, view.height - y0);
  ViewPixels tile = views_->read(camera, x0, y0, width, height);
  if (view.type == PixelType::u8)
    copy_tile<std::uint8_t>(view, tile, x0, y0);
  else if (view.type == PixelType::u16)
    copy_tile<std::uint16_t>(view, tile, x0, y0);
  else
    copy_tile<float>(view, tile, x0, y0);
  if (!tile.mask.empty() &&
      std::any_of(tile.mask.data.begin(), tile.mask.data.end(), [](auto m) { return m == 0; })) {
    std::uint8_t* mask = view.mask.load(std::memory_order_relaxed);
    if (mask == nullptr) {
      const std::size_t size = static_cast<std::size_t>(view.width) * view.height + 2 * StoredView::kPadding;
      mask = new std::uint8_t[size];
      std::memset(mask, 255, size);
      view.mask.store(mask, std::memory_order_release);
    }
    for (int y = 0; y < height; ++y)
      std::copy_n(tile.mask.row(y), width,
                  mask + StoredView::kPadding + static_cast<std::size_t>(y0 + y) * view.width + x0);
  }
  const std::size_t bytes =
      static_cast<std::size_t>(width) * height * view.channels * bytes_per_sample(view.type);
  view.loaded_bytes += bytes;
  used_ += bytes;
  ++tiles_read_;
}

void PixelStore::load(StoredView& view, int camera, const PixelRect& rect) {
  const int across = tiles_along(view.width);
  const int x0 = std::max(rect.x0, 0) / StoredView::kTile, y0 = std::max(rect.y0, 0) / StoredView::kTile;
  const int x1 = tiles_along(std::min(rect.x1, view.width));
  const int y1 = tiles_along(std::min(rect.y1, view.height));
  for (int y = y0; y < y1; ++y) {
    for (int x = x0; x < x1; ++x) {
      std::atomic<bool>& loaded = view.loaded[static_cast<std::size_t>(y * across + x)];
      if (loaded.load(std::memory_order_acquire)) continue;
      const std::lock_guard lock(view.loading);
      if (loaded.load(std::memory_order_relaxed)) continue;
      load_tile(view, camera, x, y);
      loaded.store(true, std::memory_order_release);
    }
  }
}

void PixelStore::drop_oldest(int keep) {
  const std::lock_guard lock(mutex_);
  while (used_ > budget_) {
    int oldest = -1;
    for (int i = 0; i < static_cast<int>(stored_.size()); ++i) {
      const auto& view = stored_[static_cast<std::size_t>(i)];
      // A view in somebody's hands would not free anything.
      if (i == keep || !view || view.use_count() > 1) continue;
      if (oldest < 0 || view->last_use < stored_[static_cast<std::size_t>(oldest)]->last_use) oldest = i;
    }
    if (oldest < 0) return;
    used_ -= stored_[static_cast<std::size_t>(oldest)]->loaded_bytes;
    stored_[static_cast<std::size_t>(oldest)].reset();
  }
}

std::shared_ptr<const StoredView> PixelStore::acquire(int camera, const PixelRect& rect) {
  std::shared_ptr<StoredView> view;
  {
    const std::lock_guard lock(mutex_);
    auto& slot = stored_[static_cast<std::size_t>(camera)];
    if (!slot) slot = make_view();
    view = slot;
  }
  view->last_use = ++clock_;
  if (!rect.empty()) load(*view, camera, rect);
  if (used_ > budget_) drop_oldest(camera);
  return view;
}

}  // namespace stuv
