#include "render/cpu/fast_renderer.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <bit>
#include <bitset>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <optional>

#include "core/parallel.h"
#include "render/all_in_focus.h"
#include "render/cpu/coarse_views.h"
#include "render/cpu/sweep_blocks.h"
#include "render/cpu/sweep_renderer.h"

namespace stuv {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kTile = 24;               ///< fine pixels
constexpr int kCell = kTile / kCoarse;  ///< coarse pixels a tile
/// Mean cost over planes, of full scale and channel, below which a coarse pixel looks the same on all of
/// them.
constexpr float kFlat = 0.25F / 255;

/// The first two bytes of a float: three digits are enough to choose candidates by.
using Brief = std::uint16_t;
Brief brief(float value) { return static_cast<Brief>(std::bit_cast<std::uint32_t>(value) >> 16); }

/// What is expected at each coarse pixel before the fine pass.
struct Expectation {
  Raster<std::int32_t> plane;  ///< -1: none
  Raster<std::uint8_t> flat;   ///< any plane will do
  /// Costs by coarse plane and pixel, one raster after the other; empty where planes are carried over.
  std::vector<Brief> costs;
  Raster<Brief> enough;  ///< a cost as good as the best
};

/// Planes to evaluate by tile: bit n of the tile's row of flags.
struct TilePlan {
  int cols = 0, rows = 0, planes = 0;
  std::vector<std::uint8_t> wanted;  ///< [tile][plane]
  std::vector<std::int32_t> chosen;  ///< plane of a tile that needs no look; -1: look
  std::uint8_t* at(int row, int col) {
    return wanted.data() + (static_cast<std::size_t>(row) * cols + col) * planes;
  }
  const std::uint8_t* at(int row, int col) const {
    return wanted.data() + (static_cast<std::size_t>(row) * cols + col) * planes;
  }
  int wanted_count(int row, int col) const {
    return static_cast<int>(std::count(at(row, col), at(row, col) + planes, std::uint8_t{1}));
  }
  std::int32_t chosen_at(int row, int col) const {
    return chosen[static_cast<std::size_t>(row) * cols + col];
  }
};

/// The last picture, from which the next one may be expected.
struct Previous {
  Viewpoint view;
  RenderOptions options;
  Raster<int> plane;
};

/// (pixel, plane) costs not computed, by reason, in pixels.
struct Saved {
  std::atomic<double> empty{0}, tile{0}, flat{0}, second_filter{0};
};

/// The skipped filter alone is looked at first where a tile wants more than this part of all planes: of a few
/// planes that are all nearly in focus it rules out none.
constexpr int kManyPlanes = 3;
/// Smaller pictures have no coarse pass: of so few pixels it tells too little. All planes are evaluated.
constexpr int kLeastSize = 128;
/// Coarse planes are a quarter as far apart in px: every second one is enough.
constexpr int kPlaneStep = 2;
/// Coarse pixels around a tile that have a say, beside the window's reach; planes taken beside each that is
/// chosen.
constexpr int kReach = 1, kNeighbours = 1;
/// Of costs between the best and the mean of a coarse pixel, those that are as good as the best; and of full
/// scale.
constexpr float kEnough = 0.04F, kNoise = 0.035F / 255;

/// Tiles whose expectations were carried over at this part of their coarse pixels at least.
constexpr double kLeastKnown = 0.9;

bool same_search(const RenderOptions& a, const RenderOptions& b) {
  return a.planes == b.planes && a.window == b.window && a.a01 == b.a01 && a.a02 == b.a02 && a.a12 == b.a12 &&
         a.d_min == b.d_min && a.d_max == b.d_max;
}

class FastRenderer : public Renderer {
 public:
  explicit FastRenderer(const std::shared_ptr<const ViewSet>& views)
      : lattice_(*views),
        store_(views),
        coarse_store_(coarse_views(store_)),
        exact_(make_cpu_exact_renderer(views)) {}

  RenderedView all_in_focus(const Viewpoint& view, const RenderOptions& options,
                            const Reporter& reporter) override;
  RenderedView focal_plane(const Viewpoint& view, double d_px, Filter filter) override {
    return exact_->focal_plane(view, d_px, filter);
  }
  void load(const Viewpoint& view, const RenderOptions& options) override {
    all_in_focus(view, options, {});
    forget();
  }
  void forget() override { previous_.reset(); }

 private:
  Expectation coarse_pass(const Viewpoint& view, const RenderOptions& options);
  std::optional<Expectation> from_previous(const Viewpoint& view, const RenderOptions& options) const;
  TilePlan plan(const Viewpoint& view, const RenderOptions& options, const Expectation& expected,
                std::vector<std::uint8_t>& present) const;
  double evaluate_tiles(SweepBlock& block, const TilePlan& plan, int row, const RenderOptions& options,
                        double& ruled_out) const;

  SweepLattice lattice_;
  PixelStore store_, coarse_store_;
  std::unique_ptr<Renderer> exact_;
  std::optional<Previous> previous_;
};

Expectation FastRenderer::coarse_pass(const Viewpoint& view, const RenderOptions& options) {
  const Viewpoint small = coarse_viewpoint(view);
  const Sweep sweep(coarse_store_, lattice_, small, coarse_options(options));
  const int channels = store_.views().lf.channels;
  Expectation out{Raster<std::int32_t>(small.width, small.height, 1, -1),
                  Raster<std::uint8_t>(small.width, small.height, 1),
                  {},
                  Raster<Brief>(small.width, small.height, 1)};
  const std::size_t raster = out.plane.data.size();
  out.costs.resize(raster * static_cast<std::size_t>(options.planes));
  const PixelType type = store_.views().lf.type;
  const bool has_scale = type == PixelType::u8 || type == PixelType::u16;
  const auto full_scale = static_cast<float>(channels * (options.a01 + options.a02 + options.a12));
  const std::vector<PixelRect> blocks = exact_blocks(sweep);
  parallel_for(static_cast<int>(blocks.size()), [&](int i) {
    const PixelRect& rect = blocks[static_cast<std::size_t>(i)];
    SweepBlock block(sweep, rect);
    for (int n = 0; n < options.planes; n += kPlaneStep) {
      block.evaluate(n);
      for (int y = rect.y0; y < rect.y1; ++y) {
        Brief* costs = out.costs.data() + static_cast<std::size_t>(n) * raster +
                       static_cast<std::size_t>(y) * small.width;
        for (int x = rect.x0; x < rect.x1; ++x) costs[x] = brief(block.last_cost(x, y));
      }
    }
    for (int y = rect.y0; y < rect.y1; ++y)
      for (int x = rect.x0; x < rect.x1; ++x) {
        const float mean = block.E_mean(x, y), best = block.E_min(y - rect.y0)[x - rect.x0];
        // Without a defined cost nothing is expected.
        if (!(best < INFINITY)) continue;
        out.plane.at(x, y) = block.plane(y - rect.y0)[x - rect.x0];
        out.flat.at(x, y) = has_scale && mean < kFlat * full_scale ? 1 : 0;
        out.enough.at(x, y) = brief(best + kEnough * (mean - best) + (has_scale ? kNoise * full_scale : 0));
      }
  });
  return out;
}

/// The planes of the last picture, each moved as a point on it moves between the two viewpoints. Nothing if
/// the views differ by more than a shift on the cameras' plane, or too little is known.
std::optional<Expectation> FastRenderer::from_previous(const Viewpoint& view,
                                                       const RenderOptions& options) const {
  if (!options.skips.previous_view || !previous_ || !same_search(previous_->options, options)) return {};
  const Viewpoint& last = previous_->view;
  if (last.z != view.z || last.width != view.width || last.height != view.height ||
      last.focal_px != view.focal_px || !is_parallel(last) || !is_parallel(view))
    return {};
  const LightField& lf = store_.views().lf;
  const Viewpoint small = coarse_viewpoint(view);
  Expectation out;
  out.plane = Raster<std::int32_t>(small.width, small.height, 1, -1);
  out.flat = Raster<std::uint8_t>(small.width, small.height, 1);
  std::size_t known = 0;
  for (int y = kCoarse / 2; y < last.height; y += 2) {
    for (int x = kCoarse / 2; x < last.width; x += 2) {
      const int n = previous_->plane.at(x, y);
      if (n < 0) continue;
      const double rho = lf.inverse_depth(plane_disparity(options, n));
      const double before = 1 - view.z * rho;
      if (!(before > 0)) continue;
      const double k = view.focal_px / before * rho;
      const int to_x =
          static_cast<int>(std::floor((x + view.cx_px - last.cx_px - k * (view.s - last.s)) / kCoarse));
      const int to_y =
          static_cast<int>(std::floor((y + view.cy_px - last.cy_px - k * (view.t - last.t)) / kCoarse));
      if (to_x < 0 || to_y < 0 || to_x >= small.width || to_y >= small.height) continue;
      std::int32_t& plane = out.plane.at(to_x, to_y);
      if (plane < 0) ++known;
      // The nearer of two covers the other.
      plane = std::max(plane, n);
    }
  }
  if (static_cast<double>(known) < kLeastKnown * static_cast<double>(out.plane.data.size())) return {};
  return out;
}

/// Coarse pixels that decide about a tile: its own and, as far as a window reaches, those around it.
PixelRect cells_of(const Expectation& expected, const RenderOptions& options, int row, int col) {
  const int reach = kReach + options.window / kCoarse;
  return {std::max(col * kCell - reach, 0), std::max(row * kCell - reach, 0),
          std::min((col + 1) * kCell + reach, expected.plane.width),
          std::min((row + 1) * kCell + reach, expected.plane.height)};
}

/// The fewest planes, picked greedily, of which one is good enough for each pixel of `cells`.
std::vector<int> covering_planes(const Expectation& expected, const RenderOptions& options,
                                 const PixelRect& cells) {
  constexpr std::size_t kMost = 1024;
  const std::size_t raster = expected.plane.data.size();
  const int planes = (options.planes + kPlaneStep - 1) / kPlaneStep;
  std::vector<std::bitset<kMost>> good(static_cast<std::size_t>(planes));
  std::bitset<kMost> open;
  std::size_t pixel = 0;
  for (int y = cells.y0; y < cells.y1; ++y)
    for (int x = cells.x0; x < cells.x1 && pixel < kMost; ++x) {
      if (expected.plane.at(x, y) < 0) continue;
      const std::size_t at = static_cast<std::size_t>(y) * expected.plane.width + x;
      const Brief enough = expected.enough.data[at];
      // As numbers >= 0 are ordered, so are their bits.
      for (int k = 0; k < planes; ++k)
        if (expected.costs[static_cast<std::size_t>(k) * kPlaneStep * raster + at] <= enough)
          good[static_cast<std::size_t>(k)][pixel] = true;
      open[pixel++] = true;
    }
  std::vector<int> chosen;
  while (open.any()) {
    std::size_t most = 0;
    int best = -1;
    for (int k = 0; k < planes; ++k)
      if (const std::size_t count = (good[static_cast<std::size_t>(k)] & open).count(); count > most) {
        most = count;
        best = k;
      }
    if (best < 0) break;
    open &= ~good[static_cast<std::size_t>(best)];
    chosen.push_back(best * kPlaneStep);
  }
  return chosen;
}

TilePlan FastRenderer::plan(const Viewpoint& view, const RenderOptions& options, const Expectation& expected,
                            std::vector<std::uint8_t>& present) const {
  TilePlan out;
  out.cols = (view.width + kTile - 1) / kTile;
  out.rows = (view.height + kTile - 1) / kTile;
  out.planes = options.planes;
  const auto tiles = static_cast<std::size_t>(out.cols) * out.rows;
  out.wanted.assign(tiles * static_cast<std::size_t>(out.planes), 0);
  out.chosen.assign(tiles, -1);
  parallel_for(out.rows, [&](int row) {
    for (int col = 0; col < out.cols; ++col) {
      const PixelRect cells = cells_of(expected, options, row, col);
      std::uint8_t* planes = out.at(row, col);
      const auto mark = [&](int n) {
        for (int k = std::max(n - kNeighbours, 0); k <= std::min(n + kNeighbours, out.planes - 1); ++k)
          planes[k] = 1;
      };
      int all = 0, flat = 0;
      std::int32_t some = -1;
      for (int y = cells.y0; y < cells.y1; ++y)
        for (int x = cells.x0; x < cells.x1; ++x) {
          ++all;
          flat += expected.flat.at(x, y);
          const int n = expected.plane.at(x, y);
          if (n < 0) continue;
          some = n;
          if (expected.costs.empty()) mark(n);
        }
      if (!expected.costs.empty())
        for (const int n : covering_planes(expected, options, cells)) mark(n);
      if (some < 0) std::fill_n(planes, out.planes, std::uint8_t{1});
      if (options.skips.flat_tiles && flat == all && some >= 0) {
        const int n = expected.plane.at(std::min(col * kCell + kCell / 2, expected.plane.width - 1),
                                        std::min(row * kCell + kCell / 2, expected.plane.height - 1));
        out.chosen[static_cast<std::size_t>(row) * out.cols + col] = n >= 0 ? n : some;
      }
    }
  });
  present.assign(static_cast<std::size_t>(out.planes), 0);
  for (std::size_t i = 0; i < out.wanted.size(); ++i)
    if (out.wanted[i]) present[i % static_cast<std::size_t>(out.planes)] = 1;
  for (std::size_t i = 0; i < out.wanted.size(); ++i) {
    const bool empty = present[i % static_cast<std::size_t>(out.planes)] == 0;
    if (empty ? !options.skips.empty_planes : !options.skips.tile_planes) out.wanted[i] = 1;
  }
  return out;
}

/// Evaluates the tiles of one row of them; returns the (pixel, plane) costs computed.
double FastRenderer::evaluate_tiles(SweepBlock& block, const TilePlan& plan, int row,
                                    const RenderOptions& options, double& ruled_out) const {
  const PixelRect& rect = block.rect();
  const int height = rect.y1 - rect.y0;
  const auto left = [&](int col) { return col * kTile; };
  const auto right = [&](int col) { return std::min((col + 1) * kTile, rect.x1); };
  double evaluated = 0;
  for (int col = 0; col < plan.cols; ++col)
    if (const int n = plan.chosen_at(row, col); n >= 0) block.choose(n, left(col), right(col));
  const auto wants = [&](int n, int col) {
    return plan.chosen_at(row, col) < 0 && plan.at(row, col)[n] != 0;
  };
  for (int n = 0; n < plan.planes; ++n) {
    // Runs of tiles share their halos.
    for (int col = 0; col < plan.cols;) {
      if (!wants(n, col)) {
        ++col;
        continue;
      }
      int end = col + 1;
      while (end < plan.cols && wants(n, end)) ++end;
      const double pixels = static_cast<double>(right(end - 1) - left(col)) * height;
      evaluated += pixels;
      if (options.skips.second_filter && plan.wanted_count(row, col) * kManyPlanes > plan.planes) {
        // One tile at a time: the more pixels, the less can be ruled out.
        end = col + 1;
        if (block.ruled_out(n, left(col), right(col)))
          ruled_out += static_cast<double>(right(col) - left(col)) * height;
        else
          block.evaluate(n, left(col), right(col));
        evaluated += static_cast<double>(right(col) - left(col)) * height - pixels;
      } else {
        block.evaluate(n, left(col), right(end - 1));
      }
      col = end;
    }
  }
  return evaluated;
}

RenderedView FastRenderer::all_in_focus(const Viewpoint& view, const RenderOptions& options,
                                        const Reporter& reporter) {
  validate(options);
  validate(view, store_.views().lf);
  const auto start = Clock::now();
  const double pixels = static_cast<double>(view.width) * view.height;
  std::optional<Expectation> expected = from_previous(view, options);
  const bool carried_over = expected.has_value();
  double coarse_costs = 0;
  const bool too_small = std::min(view.width, view.height) < kLeastSize;
  if (too_small) {
    expected = Expectation{};
  } else if (!carried_over) {
    expected = coarse_pass(view, options);
    coarse_costs =
        static_cast<double>(expected->plane.data.size()) * ((options.planes + kPlaneStep - 1) / kPlaneStep);
  }
  std::vector<std::uint8_t> present;
  const TilePlan tiles = plan(view, options, *expected, present);
  const Sweep sweep(store_, lattice_, view, options);
  RenderedView out = empty_picture(view, store_.views().lf.channels);
  std::vector<double> evaluated(static_cast<std::size_t>(tiles.rows), 0), ruled_out(evaluated),
      adds(evaluated);
  std::vector<int> cameras(evaluated.size(), 0);
  std::atomic<std::size_t> done{0};
  parallel_for(tiles.rows, [&](int row) {
    const auto i = static_cast<std::size_t>(row);
    SweepBlock block(sweep, {0, row * kTile, view.width, std::min((row + 1) * kTile, view.height)});
    evaluated[i] = evaluate_tiles(block, tiles, row, options, ruled_out[i]);
    block.write(out);
    adds[i] = block.multiply_adds();
    cameras[i] = block.camera_count();
    ++done;
  });
  reporter.at("rows of tiles", done, static_cast<std::size_t>(tiles.rows));

  // What was left out, by reason; the reasons do not overlap.
  double computed = 0, ruled = 0, flat = 0, most_cameras = 0;
  for (std::size_t i = 0; i < evaluated.size(); ++i) {
    computed += evaluated[i];
    ruled += ruled_out[i];
    out.statistics.multiply_adds += adds[i];
    most_cameras += cameras[i];
  }
  const auto empty_planes = static_cast<double>(std::count(present.begin(), present.end(), 0));
  for (int row = 0; row < tiles.rows; ++row)
    for (int col = 0; col < tiles.cols; ++col)
      if (tiles.chosen_at(row, col) >= 0)
        flat += static_cast<double>(std::min((col + 1) * kTile, view.width) - col * kTile) *
                (std::min((row + 1) * kTile, view.height) - row * kTile);
  const double work = pixels * options.planes;
  const double empty = options.skips.empty_planes ? (pixels - flat) * empty_planes : 0;
  const double all_cameras = static_cast<double>(store_.views().cameras.size());
  out.statistics.evaluated_fraction = (computed + coarse_costs) / work;
  out.statistics.skipped = {
      {"empty planes", empty / work},
      {"planes not near the tile", (work - flat * options.planes - empty - computed) / work},
      {"flat tiles", flat / pixels},
      {"idle cameras", 1 - most_cameras / static_cast<double>(evaluated.size()) / all_cameras},
      {"second filter", ruled / work},
      {"unread tiles of the database", 1 - std::min(1.0, static_cast<double>(store_.tiles_read()) /
                                                             static_cast<double>(store_.tiles_total()))},
      {"coarse pass", carried_over || too_small ? 1.0 : 0.0}};
  if (options.skips.previous_view) previous_ = Previous{view, options, out.plane};
  out.statistics.milliseconds = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
  return out;
}

}  // namespace

std::unique_ptr<Renderer> make_cpu_fast_renderer(std::shared_ptr<const ViewSet> views) {
  return std::make_unique<FastRenderer>(views);
}

}  // namespace stuv
