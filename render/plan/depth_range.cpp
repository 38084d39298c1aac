#include "render/plan/depth_range.h"

#include <algorithm>
#include <cmath>
#include <mutex>
#include <vector>

#include "core/parallel.h"
#include "render/cpu/coarse_views.h"
#include "render/cpu/sweep_blocks.h"
#include "render/plan/sampling.h"

namespace stuv {
namespace {

/// A pixel is sure of its plane where its cost is this much below the mean of all planes.
constexpr float kSureContrast = 0.75F;
/// Of full scale and channel: below, there is nothing to see.
constexpr float kLeastMean = 1.0F / 255;
constexpr double kLeastSure = 0.1;
constexpr double kTail = 0.005;
constexpr int kSmallWidth = 400;

struct Sure {
  std::vector<double> disparities;
  double fraction = 0;
};

/// Disparities of the sure pixels of one view.
Sure sweep_for(PixelStore& store, const Viewpoint& view, double d_min, double d_max, int planes, int window) {
  const SweepLattice lattice(store.views());
  RenderOptions options;
  options.planes = planes;
  options.window = window;
  options.d_min = d_min;
  options.d_max = d_max;
  const Sweep sweep(store, lattice, view, options);
  const float least = kLeastMean * static_cast<float>(store.views().lf.channels);
  std::mutex joining;
  std::vector<std::size_t> counts(static_cast<std::size_t>(planes), 0);
  std::size_t sure = 0;
  const std::vector<PixelRect> blocks = exact_blocks(sweep);
  parallel_for(static_cast<int>(blocks.size()), [&](int i) {
    const PixelRect& rect = blocks[static_cast<std::size_t>(i)];
    SweepBlock block(sweep, rect);
    for (int n = 0; n < planes; ++n) block.evaluate(n);
    const std::lock_guard lock(joining);
    for (int y = rect.y0; y < rect.y1; ++y)
      for (int x = rect.x0; x < rect.x1; ++x) {
        const float mean = block.E_mean(x, y), best = block.E_min(y - rect.y0)[x - rect.x0];
        const int n = block.plane(y - rect.y0)[x - rect.x0];
        if (n < 0 || !(mean > least) || !(best < (1 - kSureContrast) * mean)) continue;
        ++counts[static_cast<std::size_t>(n)];
        ++sure;
      }
  });
  Sure out;
  for (int n = 0; n < planes; ++n)
    out.disparities.insert(out.disparities.end(), counts[static_cast<std::size_t>(n)],
                           sweep.disparities[static_cast<std::size_t>(n)]);
  out.fraction = static_cast<double>(sure) / (static_cast<double>(view.width) * view.height);
  return out;
}

/// Between cameras: on one of them all filters are that camera.
Viewpoint between_cameras(const LightField& lf, double spacing_s, double spacing_t) {
  const Viewpoint middle = middle_viewpoint(lf);
  return default_viewpoint(lf, middle.s + 0.37 * spacing_s, middle.t + 0.41 * spacing_t, middle.z);
}

DepthRange range_of(const Sure& sure, double margin) {
  DepthRange out;
  out.sure_fraction = sure.fraction;
  if (sure.fraction < kLeastSure || sure.disparities.empty()) return out;
  const auto at = [&](double q) {
    return sure.disparities[static_cast<std::size_t>(q * static_cast<double>(sure.disparities.size() - 1))];
  };
  out.found = true;
  out.d_min = at(kTail) - margin;
  out.d_max = at(1 - kTail) + margin;
  return out;
}

}  // namespace

DepthRange estimate_depth_range(const std::shared_ptr<const ViewSet>& views) {
  const LightField& lf = views->lf;
  const auto [spacing_s, spacing_t] = lattice_spacing(lf);
  const double spacing = std::max(spacing_s, spacing_t);
  if (!(spacing > 0)) return {};
  PixelStore fine(views);
  PixelStore coarse(coarse_views(fine));
  PixelStore tiny(coarse_views(coarse));
  const bool large = lf.width > kSmallWidth * kCoarse;
  PixelStore& small = large ? tiny : coarse;
  const double shrunk = large ? kCoarse * kCoarse : kCoarse;
  // In px of the small picture between neighbours.
  const double reach = std::max(2.0, 0.25 * lf.width / shrunk);
  const double beyond = lf.metric ? -lf.convergence_px : -INFINITY;
  const auto search = [&](PixelStore& store, double scale, double low, double high, double step, int window) {
    low = std::max(low, beyond);
    high = std::max(high, low);
    const int planes =
        static_cast<int>(std::clamp(std::ceil((high - low) * spacing / scale / step), 1.0, 600.0)) + 1;
    Viewpoint view = between_cameras(lf, spacing_s, spacing_t);
    for (double left = scale; left > 1; left /= kCoarse) view = coarse_viewpoint(view);
    Sure sure = sweep_for(store, view, low / scale, high / scale, planes, window);
    for (double& d : sure.disparities) d *= scale;
    return sure;
  };
  const double limit = reach * shrunk / spacing;
  const DepthRange rough = range_of(search(small, shrunk, -limit, limit, 0.5, 2), 1.5 * shrunk / spacing);
  if (!rough.found) return rough;
  DepthRange out = range_of(search(fine, 1, rough.d_min, rough.d_max, 1, 4), 1 / spacing);
  if (!out.found) return out;
  out.d_min = std::max(out.d_min, beyond);
  out.d_max = std::max(out.d_max, out.d_min);
  return out;
}

}  // namespace stuv
