#include "app/viewer/view_controls.h"

#include <algorithm>
#include <cmath>

#include "render/view_set.h"

namespace stuv {
namespace {

constexpr double kBeyond = 0.25;  ///< of the cameras' box, that the viewpoint may leave it by
constexpr double kMostTurn = 0.7;

/// Blue, green, red over 0..1.
std::array<float, 3> ramp(float x) {
  const auto hat = [&](float centre) { return std::clamp(1.5F - std::abs(4 * x - centre), 0.0F, 1.0F); };
  return {hat(3), hat(2), hat(1)};
}

}  // namespace

ViewerReach reach_of(const LightField& lf, const RenderOptions& options) {
  ViewerReach out;
  out.metric = lf.metric;
  double s0 = INFINITY, s1 = -INFINITY, t0 = INFINITY, t1 = -INFINITY;
  for (const int i : lf.views_with(ViewRole::input)) {
    const View& view = lf.views[static_cast<std::size_t>(i)];
    s0 = std::min(s0, view.s), s1 = std::max(s1, view.s);
    t0 = std::min(t0, view.t), t1 = std::max(t1, view.t);
  }
  // A row has no height of its own, a single camera neither.
  const double spacing = std::max((s1 - s0) / std::max(lf.cols - 1, 1), (t1 - t0) / std::max(lf.rows - 1, 1));
  const double least = spacing > 0 ? spacing : 1;
  out.s_span = std::max(s1 - s0, least);
  out.t_span = std::max(t1 - t0, least);
  out.s_low = s0 - kBeyond * out.s_span, out.s_high = s1 + kBeyond * out.s_span;
  out.t_low = t0 - kBeyond * out.t_span, out.t_high = t1 + kBeyond * out.t_span;
  if (const double nearest = lf.inverse_depth(options.d_max); lf.metric && nearest > 0) {
    out.z_low = -1 / nearest;
    out.z_high = 0.9 / nearest;
  }
  return out;
}

void drag(ViewerState& state, const ViewerReach& reach, double dx, double dy) {
  state.s = std::clamp(state.s - dx * reach.s_span, reach.s_low, reach.s_high);
  state.t = std::clamp(state.t - dy * reach.t_span, reach.t_low, reach.t_high);
}

void step_along_z(ViewerState& state, const ViewerReach& reach, double clicks) {
  state.z = std::clamp(state.z + clicks * (reach.z_high - reach.z_low) / 40, reach.z_low, reach.z_high);
}

void turn(ViewerState& state, const ViewerReach& reach, double dx, double dy) {
  if (!reach.metric) return;
  state.yaw = std::clamp(state.yaw - dx, -kMostTurn, kMostTurn);
  state.pitch = std::clamp(state.pitch + dy, -kMostTurn, kMostTurn);
}

void zoom(ViewerState& state, double clicks) {
  state.zoom = std::clamp(state.zoom * std::pow(1.1, clicks), 0.25, 8.0);
}

Viewpoint viewpoint_of(const ViewerState& state, const LightField& lf, int shrink) {
  // z counts from the surface through the cameras, which stand a little off their plane.
  Viewpoint view = default_viewpoint(lf, state.s, state.t, camera_surface_z(lf, state.s, state.t) + state.z);
  view.focal_px *= state.zoom;
  if (state.yaw != 0 || state.pitch != 0)
    view.view_from_scene =
        rotation_from_vector({-state.pitch, 0, 0}) * rotation_from_vector({0, -state.yaw, 0});
  return shrink == 1 ? view
                     : resized(view, std::max(view.width / shrink, 1), std::max(view.height / shrink, 1));
}

int shrink_for(double full_ms, double limit_ms) {
  int shrink = 1;
  while (shrink < 8 && full_ms / (shrink * shrink) > limit_ms) shrink *= 2;
  return shrink;
}

Raster<std::uint8_t> screen_picture(const RenderedView& view, const ViewerState& state) {
  const int channels = view.colour.channels;
  const double range = std::max(state.options.d_max - state.options.d_min, 1e-12);
  Raster<std::uint8_t> out(view.colour.width, view.colour.height, 3);
  for (std::size_t i = 0; i < view.plane.data.size(); ++i) {
    std::array<float, 3> colour;
    for (std::size_t c = 0; c < 3; ++c) colour[c] = view.colour.data[i * channels + (channels == 3 ? c : 0)];
    if (state.overlay == Overlay::depth && view.plane.data[i] >= 0) {
      const std::array<float, 3> depth =
          ramp(static_cast<float>((view.disparity.data[i] - state.options.d_min) / range));
      for (std::size_t c = 0; c < 3; ++c) colour[c] = 0.35F * colour[c] + 0.65F * depth[c];
    } else if (state.overlay == Overlay::confidence) {
      // What is not to be trusted turns magenta.
      const float sure = view.confidence.data[i];
      colour[0] = sure * colour[0] + (1 - sure);
      colour[1] *= sure;
      colour[2] = sure * colour[2] + (1 - sure);
    }
    for (std::size_t c = 0; c < 3; ++c)
      out.data[3 * i + c] = static_cast<std::uint8_t>(std::lround(255 * std::clamp(colour[c], 0.0F, 1.0F)));
  }
  return out;
}

}  // namespace stuv
