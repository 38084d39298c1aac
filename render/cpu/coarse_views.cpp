#include "render/cpu/coarse_views.h"

#include <algorithm>

namespace stuv {
namespace {

int coarse_size(int size) { return (size + kCoarse - 1) / kCoarse; }
double coarse_centre(double at) { return (at + 0.5) / kCoarse - 0.5; }

/// Means of what is there of each 4x4 pixels; missing where less than half is.
template <class T>
ViewPixels shrink(const StoredView& view, float scale, int x, int y, int width, int height) {
  const std::uint8_t* mask = view.mask_plane();
  ViewPixels out;
  out.colour = ImageF(width, height, view.channels);
  if (mask != nullptr) out.mask = Mask(width, height, 1, 255);
  for (int row = 0; row < height; ++row) {
    const int y0 = (y + row) * kCoarse, y1 = std::min(y0 + kCoarse, view.height);
    for (int col = 0; col < width; ++col) {
      const int x0 = (x + col) * kCoarse, x1 = std::min(x0 + kCoarse, view.width);
      float sum[3] = {0, 0, 0};
      int count = 0;
      for (int v = y0; v < y1; ++v) {
        for (int u = x0; u < x1; ++u) {
          const std::size_t i = static_cast<std::size_t>(v) * view.width + u;
          if (mask != nullptr && mask[i] == 0) continue;
          ++count;
          for (int c = 0; c < view.channels; ++c) sum[c] += static_cast<float>(view.plane<T>(c)[i]);
        }
      }
      for (int c = 0; c < view.channels; ++c)
        out.colour.at(col, row, c) = count > 0 ? sum[c] * scale / static_cast<float>(count) : 0;
      if (mask != nullptr && 2 * count < (x1 - x0) * (y1 - y0)) out.mask.at(col, row) = 0;
    }
  }
  return out;
}

}  // namespace

std::shared_ptr<const ViewSet> coarse_views(PixelStore& store) {
  auto set = std::make_shared<ViewSet>();
  set->lf = store.views().lf;
  set->cameras = store.views().cameras;
  LightField& lf = set->lf;
  lf.width = coarse_size(lf.width);
  lf.height = coarse_size(lf.height);
  // Integers are summed faster, and 16 bits hold a mean of bytes.
  lf.type = lf.type == PixelType::u8 || lf.type == PixelType::u16 ? PixelType::u16 : PixelType::f32;
  lf.focal_px /= kCoarse;
  lf.convergence_px /= kCoarse;
  lf.cx0_px = coarse_centre(lf.cx0_px);
  lf.cy0_px = coarse_centre(lf.cy0_px);
  lf.d_min /= kCoarse;
  lf.d_max /= kCoarse;
  for (View& camera : set->cameras) {
    camera.cx_px = coarse_centre(camera.cx_px);
    camera.cy_px = coarse_centre(camera.cy_px);
  }
  set->source = [&store](int camera, int x, int y, int width, int height) {
    const auto view =
        store.acquire(camera, {x * kCoarse, y * kCoarse, (x + width) * kCoarse, (y + height) * kCoarse});
    if (view->type == PixelType::u8) return shrink<std::uint8_t>(*view, 1.0F / 255, x, y, width, height);
    if (view->type == PixelType::u16) return shrink<std::uint16_t>(*view, 1.0F / 65535, x, y, width, height);
    return shrink<float>(*view, 1, x, y, width, height);
  };
  return set;
}

Viewpoint coarse_viewpoint(const Viewpoint& view) {
  Viewpoint out = view;
  out.width = coarse_size(view.width);
  out.height = coarse_size(view.height);
  out.focal_px /= kCoarse;
  out.cx_px = coarse_centre(view.cx_px);
  out.cy_px = coarse_centre(view.cy_px);
  return out;
}

RenderOptions coarse_options(const RenderOptions& options) {
  RenderOptions out = options;
  out.d_min /= kCoarse;
  out.d_max /= kCoarse;
  out.window = options.window == 0 ? 0 : std::max(1, (options.window + kCoarse / 2) / kCoarse);
  return out;
}

}  // namespace stuv
