#include "render/all_in_focus.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "core/parallel.h"

namespace stuv {
namespace {

using Clock = std::chrono::steady_clock;
using Views = std::array<FocalPlaneView, 3>;  // by filter

constexpr double kUndefined = std::numeric_limits<double>::infinity();

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

/// Equation 5. kUndefined where a filter that takes part keeps less than half its weight.
Raster<double> difference(const Views& views, const RenderOptions& options) {
  const std::array<std::tuple<int, int, double>, 3> pairs{
      {{0, 1, options.a01}, {0, 2, options.a02}, {1, 2, options.a12}}};
  const ImageF& size = views[static_cast<std::size_t>(options.k)].colour;
  Raster<double> E0(size.width, size.height, 1);
  parallel_for(size.height, [&](int y) {
    for (int x = 0; x < size.width; ++x) {
      double& e = E0.at(x, y);
      for (const auto& [k, l, a] : pairs) {
        if (a == 0) continue;
        const FocalPlaneView &I_k = views[static_cast<std::size_t>(k)],
                             &I_l = views[static_cast<std::size_t>(l)];
        if (std::min(I_k.coverage.at(x, y), I_l.coverage.at(x, y)) < FocalPlaneRenderer::kLeastCoverage)
          e = kUndefined;
        for (int c = 0; c < size.channels; ++c)
          e += a * std::abs(static_cast<double>(I_k.colour.at(x, y, c)) - I_l.colour.at(x, y, c));
      }
    }
  });
  return E0;
}

/// Equation 6 as a mean over the defined pixels; kUndefined where there is none. Every window is summed anew:
/// running sums drift, and then windows of equal differences are no longer equal.
Raster<double> window_mean(const Raster<double>& E0, int M) {
  Raster<double> E(E0.width, E0.height, 1);
  parallel_for(E0.height, [&](int y) {
    std::vector<double> column_sum(static_cast<std::size_t>(E0.width), 0.0);
    std::vector<double> column_count(column_sum.size(), 0.0);
    const int y_end = y >= E0.height - 1 - M ? E0.height - 1 : y + M;
    for (int j = std::max(y - M, 0); j <= y_end; ++j) {
      for (int x = 0; x < E0.width; ++x) {
        const bool defined = E0.at(x, j) < kUndefined;
        column_sum[static_cast<std::size_t>(x)] += defined ? E0.at(x, j) : 0.0;
        column_count[static_cast<std::size_t>(x)] += defined ? 1.0 : 0.0;
      }
    }
    for (int x = 0; x < E0.width; ++x) {
      double sum = 0, count = 0;
      const int x_end = x >= E0.width - 1 - M ? E0.width - 1 : x + M;
      for (int i = std::max(x - M, 0); i <= x_end; ++i) {
        sum += column_sum[static_cast<std::size_t>(i)];
        count += column_count[static_cast<std::size_t>(i)];
      }
      E.at(x, y) = count > 0 ? sum / count : kUndefined;
    }
  });
  return E;
}

/// Equations 7 and 8 as planes go by, farthest first: the best so far, instead of N stacks.
struct RunningMinimum {
  Raster<int> plane;
  Raster<double> E_min, E_sum;
  Raster<int> E_count;
  FocalPlaneView view;
  double tie = 0;

  RunningMinimum(int width, int height, int channels)
      : plane(width, height, 1, -1),
        E_min(width, height, 1, kUndefined),
        E_sum(width, height, 1, 0.0),
        E_count(width, height, 1, 0),
        view{ImageF(width, height, channels), ImageF(width, height, 1)} {}

  void add(int n, const Raster<double>& E, const FocalPlaneView& I_k) {
    parallel_for(plane.height, [&](int y) {
      for (int x = 0; x < plane.width; ++x) {
        if (!(I_k.coverage.at(x, y) > 0)) continue;
        const double e = E.at(x, y);
        if (e < kUndefined) {
          E_sum.at(x, y) += e;
          ++E_count.at(x, y);
        }
        // Of equal minima the farther plane.
        if (plane.at(x, y) >= 0 && !(e < E_min.at(x, y) - tie)) continue;
        plane.at(x, y) = n;
        E_min.at(x, y) = e;
        std::copy_n(&I_k.colour.at(x, y), view.colour.channels, &view.colour.at(x, y));
        view.coverage.at(x, y) = I_k.coverage.at(x, y);
      }
    });
  }

  float contrast(int x, int y) const {
    const double sum = E_sum.at(x, y);
    return sum > 0 ? static_cast<float>(std::clamp(1 - E_min.at(x, y) * E_count.at(x, y) / sum, 0.0, 1.0))
                   : 0.0F;
  }
};

RenderedView finish(RunningMinimum best, const ViewSet& views, const Viewpoint& view,
                    const RenderOptions& options) {
  const Raster<std::uint8_t> hull = inside_hull(views, view);
  RenderedView out;
  out.disparity = ImageF(view.width, view.height, 1, std::numeric_limits<float>::quiet_NaN());
  out.confidence = ImageF(view.width, view.height, 1);
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      const int n = best.plane.at(x, y);
      if (n < 0) continue;
      out.disparity.at(x, y) = static_cast<float>(plane_disparity(options, n));
      out.confidence.at(x, y) = hull.at(x, y) ? best.view.coverage.at(x, y) * best.contrast(x, y) : 0.0F;
    }
  }
  out.colour = std::move(best.view.colour);
  out.plane = std::move(best.plane);
  return out;
}

}  // namespace

void validate(const RenderOptions& options) {
  if (options.planes < 1) throw std::invalid_argument("RenderOptions: planes must be >= 1");
  if (options.window < 0) throw std::invalid_argument("RenderOptions: window must be >= 0");
  for (const double a : {options.a01, options.a02, options.a12})
    if (!std::isfinite(a) || a < 0) throw std::invalid_argument("RenderOptions: a_kl must be >= 0");
  if (options.a01 + options.a02 + options.a12 <= 0)
    throw std::invalid_argument("RenderOptions: one of a_kl must be > 0");
  if (!std::isfinite(options.d_min) || !std::isfinite(options.d_max) || options.d_min > options.d_max)
    throw std::invalid_argument("RenderOptions: d_min <= d_max must be finite");
}

double plane_disparity(const RenderOptions& options, int n) {
  if (options.planes == 1) return (options.d_min + options.d_max) / 2;
  const double a = static_cast<double>(n) / (options.planes - 1);
  return (1 - a) * options.d_min + a * options.d_max;
}

Raster<double> focus_cost(FocalPlaneRenderer& renderer, const Viewpoint& view, const RenderOptions& options,
                          int n) {
  const double d = plane_disparity(options, n);
  return window_mean(
      difference({renderer.render(view, d, Filter::normal), renderer.render(view, d, Filter::wide),
                  renderer.render(view, d, Filter::skipped)},
                 options),
      options.window);
}

RenderedView all_in_focus(FocalPlaneRenderer& renderer, const Viewpoint& view, const RenderOptions& options,
                          const Reporter& reporter) {
  validate(options);
  validate(view, renderer.views().lf);
  const auto start = Clock::now();
  RunningMinimum best(view.width, view.height, renderer.views().lf.channels);
  best.tie = tie_of(renderer.views().lf.type);
  for (int n = 0; n < options.planes; ++n) {
    const double d = plane_disparity(options, n);
    const Views I{renderer.render(view, d, Filter::normal), renderer.render(view, d, Filter::wide),
                  renderer.render(view, d, Filter::skipped)};
    const Raster<double> E = window_mean(difference(I, options), options.window);
    best.add(n, E, I[static_cast<std::size_t>(options.k)]);
    reporter.at("planes", static_cast<std::size_t>(n) + 1, static_cast<std::size_t>(options.planes));
  }
  RenderedView out = finish(std::move(best), renderer.views(), view, options);
  out.statistics.milliseconds = milliseconds_since(start);
  return out;
}

namespace {

class LiteralRenderer : public Renderer {
 public:
  explicit LiteralRenderer(std::unique_ptr<FocalPlaneRenderer> planes) : planes_(std::move(planes)) {}

  RenderedView all_in_focus(const Viewpoint& view, const RenderOptions& options,
                            const Reporter& reporter) override {
    return stuv::all_in_focus(*planes_, view, options, reporter);
  }
  RenderedView focal_plane(const Viewpoint& view, double d_px, Filter filter) override {
    return stuv::focal_plane(*planes_, view, d_px, filter);
  }

 private:
  std::unique_ptr<FocalPlaneRenderer> planes_;
};

}  // namespace

std::unique_ptr<Renderer> make_literal_renderer(std::unique_ptr<FocalPlaneRenderer> planes) {
  return std::make_unique<LiteralRenderer>(std::move(planes));
}

RenderedView focal_plane(FocalPlaneRenderer& renderer, const Viewpoint& view, double d_px, Filter filter) {
  const auto start = Clock::now();
  FocalPlaneView picture = renderer.render(view, d_px, filter);
  const Raster<std::uint8_t> hull = inside_hull(renderer.views(), view);
  RenderedView out;
  out.disparity = ImageF(view.width, view.height, 1, std::numeric_limits<float>::quiet_NaN());
  out.plane = Raster<int>(view.width, view.height, 1, -1);
  out.confidence = ImageF(view.width, view.height, 1);
  for (std::size_t i = 0; i < picture.coverage.data.size(); ++i) {
    if (!(picture.coverage.data[i] > 0)) continue;
    out.disparity.data[i] = static_cast<float>(d_px);
    out.plane.data[i] = 0;
    out.confidence.data[i] = hull.data[i] ? picture.coverage.data[i] : 0.0F;
  }
  out.colour = std::move(picture.colour);
  out.statistics.milliseconds = milliseconds_since(start);
  return out;
}

}  // namespace stuv
