#pragma once

#include <memory>

#include "core/raster.h"
#include "core/view.h"
#include "render/view_set.h"

namespace stuv {

/// One reconstruction of the light field, focused on one plane.
struct FocalPlaneView {
  ImageF colour;    ///< 0 where no camera sees the point
  ImageF coverage;  ///< 0..1, the part of the filter's weight that could be sampled
};

/// Light field rendering on one focal plane, the paper's LFR. An output pixel (x, y) has the ray
///
///   (s, t, z) + l r,   r = view_from_scene^T ((x - cx) / f_out, (y - cy) / f_out, 1),   g = r / r.z,
///
/// which meets the plane of inverse depth rho = (d + q) / f at a point that camera c at (s_c, t_c, w_c) sees
/// at
///
///   u = cx_c + f ((s - s_c) rho + (1 - z rho) g.x) / (1 - w_c rho),   v alike with t, g.y.
///
/// The picture is sum_c a_c L_c(u, v) / sum_c a_c with the filter's weights a_c at the ray's place on the
/// lattice (lattice_chart.h) and L_c bilinear. rho = 0 is infinity, rho < 0 lies beyond; both are ordinary. A
/// sample leaves both sums if the ray does not look towards the scene (r.z > 0), if the plane lies behind the
/// viewpoint or the camera (1 - z rho > 0, 1 - w_c rho > 0), or if a tap of weight > 0 lies outside the
/// picture or on a missing pixel. d: disparity [px per unit of s]. Source: Takahashi, Kubota, Naemura, ICAT
/// 2003, figure 7.
class FocalPlaneRenderer {
 public:
  /// u, v closer than this to whole pixels count as whole [px], so that rounding loses no pixel at a border.
  static constexpr double kSnap_px = 1e-4;
  /// A filter that keeps less of its weight cannot be compared: half of it, less rounding.
  static constexpr float kLeastCoverage = 0.5F - 1e-4F;

  virtual ~FocalPlaneRenderer() = default;
  /// Throws std::invalid_argument for a viewpoint that is not valid (view_set.h) or a d that is not finite.
  virtual FocalPlaneView render(const Viewpoint& view, double d_px, Filter filter) = 0;
  virtual const ViewSet& views() const = 0;
  virtual const char* name() const = 0;
};

/// The plain reference: double geometry, float pixels, parallel over rows, the same whatever the number of
/// threads.
std::unique_ptr<FocalPlaneRenderer> make_cpu_renderer(std::shared_ptr<const ViewSet> views);

/// 1 where a pixel's ray crosses the hull of the cameras, else 0.
Raster<std::uint8_t> inside_hull(const ViewSet& views, const Viewpoint& view);

}  // namespace stuv
