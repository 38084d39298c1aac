#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "core/parallel.h"
#include "render/focal_plane.h"
#include "render/lattice_positions.h"

namespace stuv {
namespace {

/// Whole part and fraction of a coordinate inside a picture of `size` pixels. False outside.
bool split(double at, int size, int& whole, float& fraction) {
  // Also false for NaN.
  if (!(at > -1 && at < size)) return false;
  const double nearest = std::round(at);
  if (std::abs(at - nearest) < FocalPlaneRenderer::kSnap_px) at = nearest;
  whole = static_cast<int>(std::floor(at));
  fraction = static_cast<float>(at - whole);
  return whole >= 0 && whole + (fraction > 0 ? 1 : 0) < size;
}

/// Adds weight * L(u, v), bilinear, to `sum`. False, and nothing added, if a tap is not there.
bool add_sample(const ViewPixels& picture, double u, double v, float weight, float* sum) {
  const ImageF& image = picture.colour;
  int x = 0, y = 0;
  float ax = 0, ay = 0;
  if (!split(u, image.width, x, ax) || !split(v, image.height, y, ay)) return false;
  // A tap of weight 0 may lie outside: the pixel itself stands in for it.
  const int dx = ax > 0 ? 1 : 0, dy = ay > 0 ? 1 : 0;
  if (!picture.mask.empty()) {
    const Mask& mask = picture.mask;
    if (!mask.at(x, y) || !mask.at(x + dx, y) || !mask.at(x, y + dy) || !mask.at(x + dx, y + dy))
      return false;
  }
  const float* p00 = &image.at(x, y);
  const float* p01 = p00 + dx * image.channels;
  const std::size_t down = dy * static_cast<std::size_t>(image.width) * image.channels;
  const float w00 = weight * (1 - ax) * (1 - ay), w01 = weight * ax * (1 - ay);
  const float w10 = weight * (1 - ax) * ay, w11 = weight * ax * ay;
  for (int c = 0; c < image.channels; ++c)
    sum[c] += w00 * p00[c] + w01 * p01[c] + w10 * p00[down + c] + w11 * p01[down + c];
  return true;
}

class CpuRenderer : public FocalPlaneRenderer {
 public:
  explicit CpuRenderer(std::shared_ptr<const ViewSet> views)
      : views_(std::move(views)), chart_(views_->lf.rows, views_->lf.cols, views_->cameras) {
    for (const Filter filter : {Filter::normal, Filter::wide, Filter::skipped})
      filters_.emplace_back(views_->lf.rows, views_->lf.cols, views_->cameras, filter);
  }

  FocalPlaneView render(const Viewpoint& view, double d_px, Filter filter) override;
  const ViewSet& views() const override { return *views_; }
  const char* name() const override { return "cpu"; }

 private:
  std::shared_ptr<const ViewSet> views_;
  LatticeChart chart_;
  std::vector<LatticeFilter> filters_;
  // A focal stack asks for one viewpoint again and again.
  Viewpoint last_view_;
  LatticePositions positions_;
};

FocalPlaneView CpuRenderer::render(const Viewpoint& view, double d_px, Filter filter) {
  const LightField& lf = views_->lf;
  validate(view, lf);
  if (!std::isfinite(d_px)) throw std::invalid_argument("render: the disparity must be finite");
  if (!same_viewpoint(view, last_view_)) {
    positions_ = lattice_positions(chart_, view);
    last_view_ = view;
  }
  std::vector<CameraMap> maps;
  for (const View& camera : views_->cameras) maps.push_back(camera_map(lf, camera, view, d_px));
  const LatticeFilter& lattice_filter = filters_[static_cast<std::size_t>(filter)];
  std::vector<CameraWeight> constant_weights;
  if (positions_.constant) lattice_filter.weights(positions_.p[0], constant_weights);

  FocalPlaneView out{ImageF(view.width, view.height, lf.channels), ImageF(view.width, view.height, 1)};
  parallel_for(view.height, [&](int y) {
    std::vector<CameraWeight> weights = constant_weights;
    for (int x = 0; x < view.width; ++x) {
      const Ray ray = ray_of(view, x, y);
      if (!ray.towards_scene) continue;
      if (!positions_.constant) lattice_filter.weights(positions_.at(view, x, y), weights);
      float sum[3] = {0, 0, 0};
      float sampled = 0;
      for (const CameraWeight& c : weights) {
        const CameraMap& map = maps[static_cast<std::size_t>(c.camera)];
        const float weight = static_cast<float>(c.weight);
        if (map.visible && add_sample(views_->pixels[static_cast<std::size_t>(c.camera)],
                                      map.u0 + map.scale * ray.gx, map.v0 + map.scale * ray.gy, weight, sum))
          sampled += weight;
      }
      if (!(sampled > 0)) continue;
      for (int c = 0; c < lf.channels; ++c) out.colour.at(x, y, c) = sum[c] / sampled;
      out.coverage.at(x, y) = std::min(sampled, 1.0F);
    }
  });
  return out;
}

}  // namespace

std::unique_ptr<FocalPlaneRenderer> make_cpu_renderer(std::shared_ptr<const ViewSet> views) {
  return std::make_unique<CpuRenderer>(std::move(views));
}

Raster<std::uint8_t> inside_hull(const ViewSet& views, const Viewpoint& view) {
  const LatticeChart chart(views.lf.rows, views.lf.cols, views.cameras);
  const LatticePositions positions = lattice_positions(chart, view);
  Raster<std::uint8_t> out(view.width, view.height, 1);
  parallel_for(view.height, [&](int y) {
    for (int x = 0; x < view.width; ++x)
      out.at(x, y) = ray_of(view, x, y).towards_scene && chart.inside_hull(positions.at(view, x, y)) ? 1 : 0;
  });
  return out;
}

}  // namespace stuv
