#pragma once

#include <bit>
#include <cstdint>
#include <vector>

#include "core/view.h"
#include "render/cpu/coarse_views.h"

namespace stuv {

/// The first two bytes of a float >= 0: three digits are enough to choose candidates by. As the numbers are
/// ordered, so are these.
using Brief = std::uint16_t;
inline Brief brief(float value) { return static_cast<Brief>(std::bit_cast<std::uint32_t>(value) >> 16); }

/// What is expected at each coarse pixel before the fine pass.
struct Expectation {
  Raster<std::int32_t> plane;  ///< -1: none
  Raster<std::uint8_t> flat;   ///< any plane will do
  /// Costs by coarse plane and pixel, one raster after the other; raster k is of plane k * plane_step. Empty
  /// where planes are carried over from another picture.
  std::vector<Brief> costs;
  int coarse_planes = 0, plane_step = 1;
  Raster<Brief> enough;  ///< a cost as good as the best
  ImageF colour;         ///< where there is a plane; empty where costs of brightness are not asked for
};

/// Tiles of the picture, and the planes to evaluate on each.
struct TilePlan {
  static constexpr int kTile = 24;  ///< px along each side
  int cols = 0, rows = 0, planes = 0;
  std::vector<std::uint8_t> wanted;    ///< [tile][plane]
  std::vector<std::int32_t> chosen;    ///< plane of a tile that needs no look; -1: look
  std::vector<std::uint8_t> present;   ///< per plane: some tile wants it by itself
  std::vector<std::uint8_t> coloured;  ///< tiles whose costs have to see colour

  const std::uint8_t* at(int row, int col) const {
    return wanted.data() + (static_cast<std::size_t>(row) * cols + col) * planes;
  }
  int wanted_count(int row, int col) const;
  std::int32_t chosen_at(int row, int col) const {
    return chosen[static_cast<std::size_t>(row) * cols + col];
  }
  bool coloured_at(int row, int col) const {
    return coloured[static_cast<std::size_t>(row) * cols + col] != 0;
  }
  /// How many tiles of a row there are of that kind.
  int coloured_count(int row) const {
    int count = 0;
    for (int col = 0; col < cols; ++col) count += coloured_at(row, col) ? 1 : 0;
    return count;
  }
};

/// A tile wants the fewest planes of which one is good enough for each coarse pixel in it and around it, as
/// far as a window reaches, and the neighbours of these planes; flat ones want none; where nothing is
/// expected, all. Skips that are off add what they would have left out. Without expected colours, all tiles
/// are coloured.
TilePlan plan_tiles(const Viewpoint& view, const RenderOptions& options, const Expectation& expected);

}  // namespace stuv
