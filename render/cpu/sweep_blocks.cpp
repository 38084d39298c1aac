#include "render/cpu/sweep_blocks.h"

#include <algorithm>
#include <limits>
#include <thread>

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

RenderedView empty_picture(const Viewpoint& view, int channels) {
  RenderedView out;
  out.colour = ImageF(view.width, view.height, channels);
  out.disparity = ImageF(view.width, view.height, 1, std::numeric_limits<float>::quiet_NaN());
  out.plane = Raster<int>(view.width, view.height, 1, -1);
  out.confidence = ImageF(view.width, view.height, 1);
  return out;
}

}  // namespace stuv
