#include "render/cpu/grey_views.h"

namespace stuv {
namespace {

template <class T>
ViewPixels brightness(const StoredView& view, float scale, int x, int y, int width, int height) {
  const std::uint8_t* mask = view.mask_plane();
  ViewPixels out;
  out.colour = ImageF(width, height, 1);
  if (mask != nullptr) out.mask = Mask(width, height, 1);
  for (int row = 0; row < height; ++row) {
    const std::size_t from = static_cast<std::size_t>(y + row) * view.width + x;
    const T *red = view.plane<T>(0) + from, *green = view.plane<T>(1) + from, *blue = view.plane<T>(2) + from;
    float* grey = out.colour.row(row);
    for (int col = 0; col < width; ++col)
      grey[col] = (static_cast<float>(red[col]) + 2 * static_cast<float>(green[col]) +
                   static_cast<float>(blue[col])) *
                  (0.25F * scale);
    if (mask != nullptr) std::copy_n(mask + from, width, out.mask.row(row));
  }
  return out;
}

}  // namespace

std::shared_ptr<const ViewSet> grey_views(PixelStore& store) {
  auto set = std::make_shared<ViewSet>();
  set->lf = store.views().lf;
  set->cameras = store.views().cameras;
  set->lf.channels = 1;
  // As fine as a mean of bytes needs, and integers are summed faster.
  if (set->lf.type == PixelType::u8) set->lf.type = PixelType::u16;
  set->source = [&store](int camera, int x, int y, int width, int height) {
    const auto view = store.acquire(camera, {x, y, x + width, y + height});
    if (view->type == PixelType::u8) return brightness<std::uint8_t>(*view, 1.0F / 255, x, y, width, height);
    if (view->type == PixelType::u16)
      return brightness<std::uint16_t>(*view, 1.0F / 65535, x, y, width, height);
    return brightness<float>(*view, 1, x, y, width, height);
  };
  return set;
}

}  // namespace stuv
