#include "render/cpu/tile_plan.h"

#include <algorithm>

#include "core/parallel.h"
#include "render/cpu/tile_colour.h"
#include "render/pixel_store.h"

namespace stuv {
namespace {

constexpr int kCell = TilePlan::kTile / kCoarse;  ///< coarse pixels a tile
/// Coarse pixels around a tile that have a say, beside the window's reach.
constexpr int kReach = 2;

/// Coarse pixels that decide about a tile.
PixelRect cells_of(const Expectation& expected, const RenderOptions& options, int row, int col) {
  const int reach = kReach + std::min(options.window, expected.plane.width * kCoarse) / kCoarse;
  return {std::max(col * kCell - reach, 0), std::max(row * kCell - reach, 0),
          std::min((col + 1) * kCell + reach, expected.plane.width),
          std::min((row + 1) * kCell + reach, expected.plane.height)};
}

/// A neighbour of a chosen plane is evaluated if it looks better than the other one at more than this part of
/// the pixels.
constexpr float kLeastVote = 0.1F;

struct CoarsePlane {
  int plane = 0;
  bool farther = true, nearer = true;  ///< neighbours to evaluate too
};

/// Scratch of covering_planes, kept from tile to tile.
struct Cover {
  std::vector<std::uint8_t> good;  ///< [coarse plane][pixel]
  std::vector<std::uint8_t> open;  ///< pixels without a plane
  std::vector<int> most;           ///< by coarse plane: open pixels that it covers, at most
  std::vector<CoarsePlane> chosen;
};

/// Where each coarse plane is good enough: [coarse plane][pixel of the raster].
std::vector<std::uint8_t> good_planes(const Expectation& expected) {
  const std::size_t raster = expected.plane.data.size();
  std::vector<std::uint8_t> good(expected.costs.size());
  const Brief* enough = expected.enough.data.data();
  parallel_for(expected.coarse_planes, [&](int k) {
    const Brief* costs = expected.costs.data() + static_cast<std::size_t>(k) * raster;
    std::uint8_t* out = good.data() + static_cast<std::size_t>(k) * raster;
    for (std::size_t i = 0; i < raster; ++i) out[i] = costs[i] <= enough[i] ? 1 : 0;
  });
  return good;
}

int count_both(const std::uint8_t* a, const std::uint8_t* b, std::size_t size) {
  int sum = 0;
  // Blocks whose counts fit into a byte, for the compiler's vectors.
  for (std::size_t i = 0; i < size; i += 128) {
    std::uint8_t block[16] = {};
    const std::size_t end = std::min(i + 128, size);
    for (std::size_t j = i; j < end; j += 16)
      for (std::size_t k = 0; k < 16; ++k)
        block[k] = static_cast<std::uint8_t>(block[k] + (a[j + k] & b[j + k]));
    for (const std::uint8_t count : block) sum += count;
  }
  return sum;
}

/// Which neighbours of a coarse plane look better at the pixels that it covers first.
CoarsePlane with_neighbours(const Expectation& expected, const PixelRect& cells, const Cover& cover,
                            std::size_t k, std::size_t size, int covered) {
  CoarsePlane out{static_cast<int>(k) * expected.plane_step};
  if (k == 0 || k + 1 == static_cast<std::size_t>(expected.coarse_planes)) return out;
  const std::size_t raster = expected.plane.data.size();
  int farther = 0, nearer = 0;
  std::size_t i = 0;
  for (int y = cells.y0; y < cells.y1; ++y)
    for (int x = cells.x0; x < cells.x1; ++x, ++i) {
      if ((cover.good[k * size + i] & cover.open[i]) == 0) continue;
      const Brief* cost =
          expected.costs.data() + k * raster + static_cast<std::size_t>(y) * expected.plane.width + x;
      const Brief before = *(cost - raster), after = cost[raster];
      farther += before <= after ? 1 : 0;
      nearer += after <= before ? 1 : 0;
    }
  const float least = kLeastVote * static_cast<float>(covered);
  out.farther = static_cast<float>(farther) > least;
  out.nearer = static_cast<float>(nearer) > least;
  return out;
}

/// The fewest planes, picked greedily, of which one is good enough for each pixel of `cells`.
void covering_planes(const Expectation& expected, const std::vector<std::uint8_t>& good,
                     const PixelRect& cells, Cover& cover) {
  const auto planes = static_cast<std::size_t>(expected.coarse_planes);
  const auto width = static_cast<std::size_t>(cells.x1 - cells.x0),
             height = static_cast<std::size_t>(cells.y1 - cells.y0);
  const std::size_t size = (width * height + 15) / 16 * 16, raster = expected.plane.data.size();
  cover.good.assign(planes * size, 0);
  cover.open.assign(size, 0);
  cover.chosen.clear();
  for (std::size_t y = 0; y < height; ++y) {
    const std::size_t at =
        (y + static_cast<std::size_t>(cells.y0)) * expected.plane.width + static_cast<std::size_t>(cells.x0);
    for (std::size_t x = 0; x < width; ++x)
      cover.open[y * width + x] = expected.plane.data[at + x] >= 0 ? 1 : 0;
    for (std::size_t k = 0; k < planes; ++k)
      std::copy_n(good.data() + k * raster + at, width, cover.good.data() + k * size + y * width);
  }
  // What a plane adds only gets less as others are chosen: the last count is a bound.
  cover.most.assign(planes, static_cast<int>(size));
  while (true) {
    std::size_t best = planes;
    for (std::size_t counted = planes; best == planes;) {
      const auto k = static_cast<std::size_t>(std::max_element(cover.most.begin(), cover.most.end()) -
                                              cover.most.begin());
      if (k == counted)
        best = k;
      else
        cover.most[k] = count_both(cover.good.data() + k * size, cover.open.data(), size);
      counted = k;
    }
    if (cover.most[best] == 0) return;
    cover.chosen.push_back(with_neighbours(expected, cells, cover, best, size, cover.most[best]));
    for (std::size_t i = 0; i < size; ++i)
      cover.open[i] = static_cast<std::uint8_t>(cover.open[i] & ~cover.good[best * size + i]);
  }
}

/// Where every coarse pixel is flat: the middle's plane, or any; -1 where one is not, or has none.
std::int32_t flat_plane(const Expectation& expected, const PixelRect& cells, int row, int col) {
  std::int32_t some = -1;
  for (int y = cells.y0; y < cells.y1; ++y)
    for (int x = cells.x0; x < cells.x1; ++x) {
      if (!expected.flat.at(x, y)) return -1;
      some = std::max(some, expected.plane.at(x, y));
    }
  const std::int32_t middle = expected.plane.at(std::min(col * kCell + kCell / 2, expected.plane.width - 1),
                                                std::min(row * kCell + kCell / 2, expected.plane.height - 1));
  return middle >= 0 ? middle : some;
}

}  // namespace

int TilePlan::wanted_count(int row, int col) const {
  return static_cast<int>(std::count(at(row, col), at(row, col) + planes, std::uint8_t{1}));
}

TilePlan plan_tiles(const Viewpoint& view, const RenderOptions& options, const Expectation& expected) {
  TilePlan out;
  out.cols = (view.width + TilePlan::kTile - 1) / TilePlan::kTile;
  out.rows = (view.height + TilePlan::kTile - 1) / TilePlan::kTile;
  out.planes = options.planes;
  const auto tiles = static_cast<std::size_t>(out.cols) * out.rows;
  const auto planes = static_cast<std::size_t>(out.planes);
  out.wanted.assign(tiles * planes, 0);
  out.chosen.assign(tiles, -1);
  out.coloured.assign(tiles, 1);
  const std::vector<std::uint8_t> good = good_planes(expected);
  parallel_for(out.rows, [&](int row) {
    Cover cover;
    for (int col = 0; col < out.cols; ++col) {
      const std::size_t tile = static_cast<std::size_t>(row) * out.cols + col;
      std::uint8_t* wanted = out.wanted.data() + tile * planes;
      const auto mark = [&](const CoarsePlane& n) {
        const int first = std::max(n.farther ? n.plane - 1 : n.plane, 0),
                  last = std::min(n.nearer ? n.plane + 1 : n.plane, out.planes - 1);
        std::fill(wanted + first, wanted + last + 1, std::uint8_t{1});
      };
      const PixelRect cells = cells_of(expected, options, row, col);
      if (!expected.colour.empty())
        out.coloured[tile] = colour_beside_brightness(expected, cells) > kLeastColour ? 1 : 0;
      if (options.skips.flat_tiles) out.chosen[tile] = flat_plane(expected, cells, row, col);
      if (expected.costs.empty()) {
        for (int y = cells.y0; y < cells.y1; ++y)
          for (int x = cells.x0; x < cells.x1; ++x)
            if (const int n = expected.plane.at(x, y); n >= 0) mark({n});
      } else {
        covering_planes(expected, good, cells, cover);
        for (const CoarsePlane& n : cover.chosen) mark(n);
      }
      if (std::find(wanted, wanted + planes, std::uint8_t{1}) == wanted + planes)
        std::fill_n(wanted, planes, std::uint8_t{1});
    }
  });
  out.present.assign(planes, 0);
  for (std::size_t tile = 0; tile < tiles; ++tile)
    for (std::size_t n = 0; n < planes; ++n) out.present[n] |= out.wanted[tile * planes + n];
  for (std::size_t n = 0; n < planes; ++n) {
    const bool skips = out.present[n] != 0 ? options.skips.tile_planes : options.skips.empty_planes;
    if (skips) continue;
    for (std::size_t tile = 0; tile < tiles; ++tile) out.wanted[tile * planes + n] = 1;
  }
  return out;
}

}  // namespace stuv
