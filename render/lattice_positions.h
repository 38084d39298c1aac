#pragma once

#include <cmath>
#include <vector>

#include "core/parallel.h"
#include "render/lattice_chart.h"
#include "render/ray_geometry.h"

namespace stuv {

inline bool same_viewpoint(const Viewpoint& a, const Viewpoint& b) {
  return a.s == b.s && a.t == b.t && a.z == b.z && a.view_from_scene == b.view_from_scene &&
         a.focal_px == b.focal_px && a.cx_px == b.cx_px && a.cy_px == b.cy_px && a.width == b.width &&
         a.height == b.height;
}

/// Where each pixel's ray crosses the lattice. One place for the whole picture where that is so: of a
/// viewpoint on the surface through the cameras' centres.
struct LatticePositions {
  bool constant = false;
  std::vector<Eigen::Vector2d> p;  ///< one, or one a pixel, row by row

  const Eigen::Vector2d& at(const Viewpoint& view, int x, int y) const {
    return p[constant ? 0 : static_cast<std::size_t>(y) * view.width + x];
  }
};

inline LatticePositions lattice_positions(const LatticeChart& chart, const Viewpoint& view) {
  const Eigen::Vector3d o(view.s, view.t, view.z);
  LatticePositions out;
  const Eigen::Vector2d straight = chart.position(o, 0, 0);
  // As camera_surface_z finds z, but for rounding.
  out.constant = std::abs(chart.surface_w(straight) - view.z) <= 1e-9 * std::abs(view.z);
  if (out.constant) {
    out.p.push_back(straight);
    return out;
  }
  out.p.resize(static_cast<std::size_t>(view.width) * view.height);
  parallel_for(view.height, [&](int y) {
    for (int x = 0; x < view.width; ++x) {
      const Ray ray = ray_of(view, x, y);
      out.p[static_cast<std::size_t>(y) * view.width + x] = chart.position(o, ray.gx, ray.gy);
    }
  });
  return out;
}

}  // namespace stuv
