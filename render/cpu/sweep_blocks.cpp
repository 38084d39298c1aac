#include "render/cpu/sweep_blocks.h"

#include <algorithm>
#include <limits>
#include <thread>

#include "core/parallel.h"

namespace stuv {

std::vector<PixelRect> blocks_of(const Viewpoint& view, int width, int height) {
  const int columns = std::max(1, (view.width + width - 1) / width),
            rows = std::max(1, (view.height + height - 1) / height);
  const auto edge = [](int i, int n, int size) {
    return static_cast<int>(static_cast<std::int64_t>(i) * size / n);
  };
  std::vector<PixelRect> blocks;
  for (int row = 0; row < rows; ++row)
    for (int col = 0; col < columns; ++col)
      blocks.push_back({edge(col, columns, view.width), edge(row, rows, view.height),
                        edge(col + 1, columns, view.width), edge(row + 1, rows, view.height)});
  return blocks;
}

std::vector<PixelRect> exact_blocks(const Sweep& sweep) {
  const int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  const int window = std::max(sweep.M_x, sweep.M_y);
  const int share = (sweep.view.height + 2 * threads - 1) / (2 * threads);
  const int height = std::max(std::clamp(share, 32, 128), 4 * window);
  return blocks_of(sweep.view, std::max(256, 4 * window), height);
}

RenderedView unset_picture(const Viewpoint& view, int channels) {
  RenderedView out;
  out.colour = ImageF::unset(view.width, view.height, channels);
  out.disparity = ImageF::unset(view.width, view.height, 1);
  out.plane = Raster<int>::unset(view.width, view.height, 1);
  out.confidence = ImageF::unset(view.width, view.height, 1);
  return out;
}

RenderedView empty_picture(const Viewpoint& view, int channels) {
  RenderedView out = unset_picture(view, channels);
  parallel_for(view.height, [&](int y) {
    const auto fill = [&](auto& raster, auto value) {
      std::fill_n(raster.row(y), static_cast<std::size_t>(raster.width) * raster.channels, value);
    };
    fill(out.colour, 0.0F);
    fill(out.disparity, std::numeric_limits<float>::quiet_NaN());
    fill(out.plane, -1);
    fill(out.confidence, 0.0F);
  });
  return out;
}

}  // namespace stuv
