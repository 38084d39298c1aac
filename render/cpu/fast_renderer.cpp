#include "render/cpu/fast_renderer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <mutex>
#include <optional>

#include "core/parallel.h"
#include "render/all_in_focus.h"
#include "render/cpu/coarse_views.h"
#include "render/cpu/grey_views.h"
#include "render/cpu/sweep_blocks.h"
#include "render/cpu/sweep_renderer.h"
#include "render/cpu/tile_plan.h"

namespace stuv {
namespace {

using Clock = std::chrono::steady_clock;

/// Mean cost over planes, of full scale and channel, below which a coarse pixel looks the same on all of
/// them.
constexpr float kFlat = 0.25F / 255;

/// The last picture, from which the next one may be expected.
struct Previous {
  Viewpoint view;
  RenderOptions options;
  Raster<int> plane;
  ImageF coarse_colour;
};

/// The skipped filter alone is looked at first where a tile wants more than this part of all planes: of a few
/// planes that are all nearly in focus it rules out none.
constexpr int kManyPlanes = 3;
/// Smaller pictures leave nothing out.
constexpr int kLeastSize = 128;
/// Windows are cut above and below tiles that are at least so many times M high. Cut at lower ones they cost
/// 0.2 dB of the layers in tests/render/fast_test.cpp (M = 7 and 8); cut at all borders, 0.1 dB of a scene.
constexpr int kLeastTiles = 6;
/// Of memory for brightness and for means; both are made anew from the pixels.
constexpr std::size_t kGreyBudget = std::size_t{96} << 20, kCoarseBudget = std::size_t{64} << 20;
/// Coarse planes are a quarter as far apart in px: every second one is enough.
constexpr int kPlaneStep = 2;
/// Of costs between the best and the mean of a coarse pixel, those that are as good as the best; and of full
/// scale.
constexpr float kEnough = 0.02F, kNoise = 0.02F / 255;

/// A plane that more than this part of a tile's pixels chose wants its neighbours looked at.
constexpr float kLeastFollowed = 0.03F;

/// Tiles whose expectations were carried over at this part of their coarse pixels at least.
constexpr double kLeastKnown = 0.9;

bool is_small(const Viewpoint& view) { return std::min(view.width, view.height) < kLeastSize; }

bool same_search(const RenderOptions& a, const RenderOptions& b) {
  return a.planes == b.planes && a.window == b.window && a.a01 == b.a01 && a.a02 == b.a02 && a.a12 == b.a12 &&
         a.d_min == b.d_min && a.d_max == b.d_max;
}

/// Of one row of tiles: (pixel, plane) costs and pixels.
struct RowWork {
  double evaluated = 0, brightness_only = 0, ruled_out = 0, flat = 0, multiply_adds = 0, bytes = 0,
         cameras = 0;

  void add(const RowWork& other) {
    evaluated += other.evaluated;
    brightness_only += other.brightness_only;
    ruled_out += other.ruled_out;
    flat += other.flat;
    multiply_adds += other.multiply_adds;
    bytes += other.bytes;
    cameras += other.cameras;
  }
};

/// Means of 4x4 pixels of a picture, at its border of fewer.
ImageF coarse_picture(const ImageF& fine, const Viewpoint& small) {
  ImageF out(small.width, small.height, fine.channels);
  parallel_for(small.height, [&](int row) {
    const int y0 = row * kCoarse, y1 = std::min(y0 + kCoarse, fine.height);
    for (int col = 0; col < small.width; ++col) {
      const int x0 = col * kCoarse, x1 = std::min(x0 + kCoarse, fine.width);
      for (int c = 0; c < fine.channels; ++c) {
        float sum = 0;
        for (int y = y0; y < y1; ++y)
          for (int x = x0; x < x1; ++x) sum += fine.at(x, y, c);
        out.at(col, row, c) = sum / static_cast<float>((y1 - y0) * (x1 - x0));
      }
    }
  });
  return out;
}

class FastRenderer : public Renderer {
 public:
  explicit FastRenderer(const std::shared_ptr<const ViewSet>& views)
      : lattice_(*views),
        store_(views),
        coarse_store_(coarse_views(store_), kCoarseBudget),
        grey_store_(views->lf.channels == 3 ? grey_views(store_) : views, kGreyBudget),
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
  /// Whether tiles may compare brightness only.
  bool wants_brightness(const Viewpoint& view, const RenderOptions& options) const {
    return !is_small(view) && options.skips.colour_costs && store_.views().lf.channels == 3;
  }
  Expectation coarse_pass(const Viewpoint& view, const RenderOptions& options);
  std::optional<Expectation> from_previous(const Viewpoint& view, const RenderOptions& options) const;
  static RowWork evaluate_tiles(SweepBlock& block, const TilePlan& plan, int row, bool coloured,
                                const RenderOptions& options);
  static double follow(SweepBlock& block, int x0, int x1, std::vector<std::uint8_t>& looked);
  static double evaluate_gaps(SweepBlock& block, int x0, int x1, const std::vector<std::uint8_t>& looked);
  static RowWork make_row(const Sweep& colour, const Sweep& grey, const TilePlan& plan, int row,
                          RenderedView& out);
  void fill_statistics(RenderedView& out, const RenderOptions& options, const TilePlan& tiles,
                       const RowWork& all) const;

  SweepLattice lattice_;
  PixelStore store_, coarse_store_, grey_store_;
  std::unique_ptr<Renderer> exact_;
  std::optional<Previous> previous_;
};

Expectation nothing_expected(const Viewpoint& small) {
  Expectation out;
  out.plane = Raster<std::int32_t>(small.width, small.height, 1, -1);
  out.flat = Raster<std::uint8_t>(small.width, small.height, 1);
  return out;
}

Expectation FastRenderer::coarse_pass(const Viewpoint& view, const RenderOptions& options) {
  const Viewpoint small = coarse_viewpoint(view);
  const Sweep sweep(coarse_store_, lattice_, small, coarse_options(options));
  const int channels = store_.views().lf.channels;
  Expectation out = nothing_expected(small);
  out.enough = Raster<Brief>(small.width, small.height, 1);
  out.plane_step = kPlaneStep;
  out.coarse_planes = (options.planes + kPlaneStep - 1) / kPlaneStep;
  const std::size_t raster = out.plane.data.size();
  out.costs.resize(raster * static_cast<std::size_t>(out.coarse_planes));
  const PixelType type = store_.views().lf.type;
  const bool has_scale = type == PixelType::u8 || type == PixelType::u16;
  const auto full_scale = static_cast<float>(channels * (options.a01 + options.a02 + options.a12));
  RenderedView picture;
  const bool coloured = wants_brightness(view, options);
  if (coloured) picture = empty_picture(small, channels);
  const std::vector<PixelRect> blocks = exact_blocks(sweep);
  parallel_for(static_cast<int>(blocks.size()), [&](int i) {
    const PixelRect& rect = blocks[static_cast<std::size_t>(i)];
    SweepBlock block(sweep, rect);
    for (int k = 0; k < out.coarse_planes; ++k) {
      block.evaluate(k * kPlaneStep);
      for (int y = rect.y0; y < rect.y1; ++y) {
        Brief* costs = out.costs.data() + static_cast<std::size_t>(k) * raster +
                       static_cast<std::size_t>(y) * small.width;
        for (int x = rect.x0; x < rect.x1; ++x) costs[x] = brief(block.last_cost(x, y));
      }
    }
    if (coloured) block.write(picture);
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
  out.colour = std::move(picture.colour);
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
  Expectation out = nothing_expected(small);
  const ImageF& last_colour = previous_->coarse_colour;
  if (wants_brightness(view, options) && !last_colour.empty())
    out.colour = ImageF(small.width, small.height, last_colour.channels);
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
      if (n < plane) continue;
      plane = n;
      if (!out.colour.empty())
        std::copy_n(&last_colour.at(x / kCoarse, y / kCoarse), out.colour.channels,
                    &out.colour.at(to_x, to_y));
    }
  }
  if (static_cast<double>(known) < kLeastKnown * static_cast<double>(out.plane.data.size())) return {};
  return out;
}

/// Columns of a tile.
int left_of(int col) { return col * TilePlan::kTile; }
int right_of(int col, const PixelRect& rect) { return std::min((col + 1) * TilePlan::kTile, rect.x1); }

/// Evaluates those tiles of one row whose costs see colour, or the others.
RowWork FastRenderer::evaluate_tiles(SweepBlock& block, const TilePlan& plan, int row, bool coloured,
                                     const RenderOptions& options) {
  const PixelRect& rect = block.rect();
  const auto right = [&](int col) { return right_of(col, rect); };
  const auto pixels = [&](int first, int end) {
    return static_cast<double>(right(end - 1) - left_of(first)) * (rect.y1 - rect.y0);
  };
  RowWork work;
  std::vector<char> many(static_cast<std::size_t>(plan.cols)), done(many);
  for (int col = 0; col < plan.cols; ++col) {
    const auto i = static_cast<std::size_t>(col);
    if (plan.coloured_at(row, col) != coloured) {
      done[i] = 1;
      continue;
    }
    many[i] = plan.wanted_count(row, col) * kManyPlanes > plan.planes ? 1 : 0;
    if (const int n = plan.chosen_at(row, col); n >= 0) {
      block.evaluate(n, left_of(col), right(col));
      work.evaluated += pixels(col, col + 1);
      // At a border the plane may not be seen everywhere.
      done[i] = block.without_plane(left_of(col), right(col)).empty() ? 1 : 0;
      if (done[i]) work.flat += pixels(col, col + 1);
    }
  }
  const auto wants = [&](int n, int col) {
    return !done[static_cast<std::size_t>(col)] && plan.at(row, col)[n] != 0 && n != plan.chosen_at(row, col);
  };
  for (int n = 0; n < plan.planes; ++n) {
    for (int col = 0, end = 0; col < plan.cols; col = end) {
      end = col + 1;
      if (!wants(n, col)) continue;
      // One tile at a time: the more pixels, the less can be ruled out.
      if (options.skips.second_filter && many[static_cast<std::size_t>(col)]) {
        if (block.ruled_out(n, left_of(col), right(col)))
          work.ruled_out += pixels(col, end);
        else
          block.evaluate(n, left_of(col), right(col));
      } else {
        // Tiles side by side are evaluated together.
        while (end < plan.cols && wants(n, end)) ++end;
        block.evaluate(n, left_of(col), right(end - 1));
      }
      work.evaluated += pixels(col, end);
    }
  }
  for (int col = 0; col < plan.cols; ++col) {
    if (done[static_cast<std::size_t>(col)]) continue;
    std::vector<std::uint8_t> looked(plan.at(row, col), plan.at(row, col) + plan.planes);
    if (const int n = plan.chosen_at(row, col); n >= 0) looked[static_cast<std::size_t>(n)] = 1;
    if (options.skips.tile_planes) work.evaluated += follow(block, left_of(col), right(col), looked);
    work.evaluated += evaluate_gaps(block, left_of(col), right(col), looked);
  }
  if (!coloured) work.brightness_only = work.evaluated;
  work.multiply_adds = block.multiply_adds();
  work.bytes = block.bytes();
  return work;
}

/// Where pixels chose a plane beside which nothing was looked at, the best one may lie further that way:
/// looks there until none does. Of planes that are closer to each other than the coarse pass can tell, it
/// chooses only a near one. Returns (pixel, plane) costs.
double FastRenderer::follow(SweepBlock& block, int x0, int x1, std::vector<std::uint8_t>& looked) {
  const PixelRect& rect = block.rect();
  const int pixels = (x1 - x0) * (rect.y1 - rect.y0);
  const int least = static_cast<int>(kLeastFollowed * static_cast<float>(pixels));
  std::vector<int> count(looked.size());
  double evaluated = 0;
  for (bool more = true; more;) {
    more = false;
    std::fill(count.begin(), count.end(), 0);
    for (int y = 0; y < rect.y1 - rect.y0; ++y)
      for (int x = x0 - rect.x0; x < x1 - rect.x0; ++x)
        if (const int n = block.plane(y)[x]; n >= 0) ++count[static_cast<std::size_t>(n)];
    for (std::size_t n = 0; n < looked.size(); ++n) {
      if (count[n] <= least) continue;
      for (std::size_t next = n > 0 ? n - 1 : 0; next < std::min(n + 2, looked.size()); ++next) {
        if (looked[next]) continue;
        looked[next] = 1;
        block.evaluate(static_cast<int>(next), x0, x1);
        evaluated += pixels;
        more = true;
      }
    }
  }
  return evaluated;
}

/// Where no camera sees the planes of a tile, at borders, other planes are seen: all are evaluated there.
/// Returns (pixel, plane) costs.
double FastRenderer::evaluate_gaps(SweepBlock& block, int x0, int x1,
                                   const std::vector<std::uint8_t>& looked) {
  const PixelRect gap = block.without_plane(x0, x1);
  if (gap.empty()) return 0;
  double evaluated = 0;
  for (std::size_t n = 0; n < looked.size(); ++n) {
    if (looked[n]) continue;
    block.evaluate(static_cast<int>(n), gap);
    evaluated += static_cast<double>(gap.x1 - gap.x0) * (gap.y1 - gap.y0);
  }
  return evaluated;
}

/// Evaluates and writes one row of tiles.
RowWork FastRenderer::make_row(const Sweep& colour_sweep, const Sweep& grey_sweep, const TilePlan& plan,
                               int row, RenderedView& out) {
  const Viewpoint& view = colour_sweep.view;
  const PixelRect rect{0, row * TilePlan::kTile, view.width,
                       std::min((row + 1) * TilePlan::kTile, view.height)};
  const int coloured = plan.coloured_count(row);
  if (coloured == plan.cols) {
    SweepBlock block(colour_sweep, rect);
    RowWork work = evaluate_tiles(block, plan, row, true, colour_sweep.options);
    work.cameras = block.camera_count();
    block.write(out);
    return work;
  }
  SweepBlock grey(grey_sweep, rect);
  RowWork work = evaluate_tiles(grey, plan, row, false, grey_sweep.options);
  work.cameras = grey.camera_count();
  if (coloured == 0) {
    SweepBlock(colour_sweep, rect, SweepBlock::Purpose::colour).write(out, grey);
    return work;
  }
  SweepBlock block(colour_sweep, rect);
  work.add(evaluate_tiles(block, plan, row, true, colour_sweep.options));
  for (int col = 0; col < plan.cols; ++col)
    if (!plan.coloured_at(row, col)) block.take(grey, left_of(col), right_of(col, rect));
  block.write(out);
  return work;
}

RenderedView FastRenderer::all_in_focus(const Viewpoint& view, const RenderOptions& options,
                                        const Reporter& reporter) {
  validate(options);
  validate(view, store_.views().lf);
  const auto start = Clock::now();
  // In a small picture nothing is left out: of so few pixels a coarse pass tells too little.
  const bool small = is_small(view);
  std::optional<Expectation> expected;
  if (small) expected = nothing_expected(coarse_viewpoint(view));
  if (!expected) expected = from_previous(view, options);
  const bool coarse = !expected;
  if (coarse) expected = coarse_pass(view, options);
  const TilePlan tiles = plan_tiles(view, options, *expected);

  const bool cut = !small && options.skips.tile_margins && kLeastTiles * options.window <= TilePlan::kTile;
  const bool grey = wants_brightness(view, options);
  const Windows windows = cut ? Windows::cut : Windows::whole;
  const Sweep colour_sweep(store_, lattice_, view, options, windows);
  const Sweep grey_sweep(grey ? grey_store_ : store_, lattice_, view, options, windows);
  RenderedView out = empty_picture(view, store_.views().lf.channels);
  std::vector<RowWork> work(static_cast<std::size_t>(tiles.rows));
  std::mutex reporting;
  std::size_t done = 0;
  parallel_for(tiles.rows, [&](int row) {
    work[static_cast<std::size_t>(row)] = make_row(colour_sweep, grey_sweep, tiles, row, out);
    const std::lock_guard lock(reporting);
    reporter.at("rows of tiles", ++done, work.size());
  });

  RowWork all;
  for (const RowWork& row : work) all.add(row);
  fill_statistics(out, options, tiles, all);
  const double pixels = static_cast<double>(view.width) * view.height;
  const auto say = [&](const char* reason, double part) { out.statistics.skipped.push_back({reason, part}); };
  say("pixels beside tiles", cut ? 1.0 : 0.0);
  say("colour in costs", 2.0 / 3 * all.brightness_only / std::max(all.evaluated, 1.0));
  say("coarse pass", coarse ? 0.0 : 1.0);
  if (coarse)
    out.statistics.evaluated_fraction +=
        static_cast<double>(expected->costs.size()) / (pixels * options.planes);
  if (options.skips.previous_view)
    previous_ = Previous{view, options, out.plane,
                         grey ? coarse_picture(out.colour, coarse_viewpoint(view)) : ImageF()};
  out.statistics.milliseconds = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
  return out;
}

/// What was left out, by reason; those of planes do not overlap.
void FastRenderer::fill_statistics(RenderedView& out, const RenderOptions& options, const TilePlan& tiles,
                                   const RowWork& all) const {
  const double pixels = static_cast<double>(out.plane.data.size()), work = pixels * options.planes;
  const auto absent = static_cast<double>(std::count(tiles.present.begin(), tiles.present.end(), 0));
  const double empty = options.skips.empty_planes ? (pixels - all.flat) * absent : 0;
  const double cameras = static_cast<double>(store_.views().cameras.size()) * tiles.rows;
  out.statistics.multiply_adds = all.multiply_adds;
  out.statistics.bytes = all.bytes;
  out.statistics.evaluated_fraction = all.evaluated / work;
  out.statistics.skipped = {
      {"empty planes", empty / work},
      {"planes not near the tile", (work - all.flat * (options.planes - 1) - empty - all.evaluated) / work},
      {"flat tiles", all.flat / pixels},
      {"second filter", all.ruled_out / work},
      {"idle cameras", 1 - all.cameras / cameras},
      {"unread tiles of the database", 1 - std::min(1.0, static_cast<double>(store_.tiles_read()) /
                                                             static_cast<double>(store_.tiles_total()))}};
}

}  // namespace

std::unique_ptr<Renderer> make_cpu_fast_renderer(std::shared_ptr<const ViewSet> views) {
  return std::make_unique<FastRenderer>(views);
}

}  // namespace stuv
