#include <algorithm>
#include <chrono>
#include <cmath>
#include <mutex>

#include "core/parallel.h"
#include "render/all_in_focus.h"
#include "render/cpu/sweep_blocks.h"
#include "render/cpu/sweep_renderer.h"

namespace stuv {
namespace {

using Clock = std::chrono::steady_clock;

/// Rows that are evaluated together on all planes: few, so that the pixels that they meet stay in a core's
/// own cache from plane to plane.
constexpr int kBand = 24;

class ExactRenderer : public Renderer {
 public:
  explicit ExactRenderer(std::shared_ptr<const ViewSet> views) : lattice_(*views), store_(std::move(views)) {}

  RenderedView all_in_focus(const Viewpoint& view, const RenderOptions& options,
                            const Reporter& reporter) override {
    validate(options);
    validate(view, store_.views().lf);
    const auto start = Clock::now();
    const Sweep sweep(store_, lattice_, view, options);
    RenderedView out = empty_picture(view, store_.views().lf.channels);
    const std::vector<PixelRect> blocks = exact_blocks(sweep);
    std::mutex reporting;
    std::size_t done = 0;
    parallel_for(static_cast<int>(blocks.size()), [&](int i) {
      SweepBlock block(sweep, blocks[static_cast<std::size_t>(i)]);
      const PixelRect& rect = block.rect();
      for (int y = rect.y0; y < rect.y1; y += kBand)
        for (int n = 0; n < options.planes; ++n) block.evaluate_rows(n, y, std::min(y + kBand, rect.y1));
      block.write(out);
      const std::lock_guard lock(reporting);
      out.statistics.multiply_adds += block.multiply_adds();
      out.statistics.bytes += block.bytes();
      reporter.at("blocks", ++done, blocks.size());
    });
    out.statistics.milliseconds = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
    return out;
  }

  RenderedView focal_plane(const Viewpoint& view, double d_px, Filter filter) override {
    const RenderOptions options = focal_plane_options(d_px, filter);
    validate(view, store_.views().lf);
    const auto start = Clock::now();
    const Sweep sweep(store_, lattice_, view, options);
    RenderedView out = empty_picture(view, store_.views().lf.channels);
    const std::vector<PixelRect> blocks = exact_blocks(sweep);
    parallel_for(static_cast<int>(blocks.size()), [&](int i) {
      SweepBlock block(sweep, blocks[static_cast<std::size_t>(i)], SweepBlock::Purpose::colour);
      block.choose(0, block.rect().x0, block.rect().x1);
      block.write(out);
    });
    out.statistics.milliseconds = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
    return out;
  }

  void load(const Viewpoint& view, const RenderOptions& options) override {
    const Sweep sweep(store_, lattice_, view, options);
    const std::vector<PixelRect> blocks = exact_blocks(sweep);
    parallel_for(static_cast<int>(blocks.size()),
                 [&](int i) { const SweepBlock block(sweep, blocks[static_cast<std::size_t>(i)]); });
  }

 private:
  SweepLattice lattice_;
  PixelStore store_;
};

}  // namespace

std::unique_ptr<Renderer> make_cpu_exact_renderer(std::shared_ptr<const ViewSet> views) {
  return std::make_unique<ExactRenderer>(std::move(views));
}

}  // namespace stuv
