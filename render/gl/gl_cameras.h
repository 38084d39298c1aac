#pragma once

#include <epoxy/gl.h>

#include <array>
#include <cmath>

#include "render/cpu/sweep.h"
#include "render/ray_geometry.h"

namespace stuv {

/// As the shader's structs (std430).
struct GlCamera {
  std::array<GLint, 2> whole{};
  std::array<float, 2> fraction{};
  float slope = 0;
  GLint visible = 0;
  GLint block = 0;
  GLint first_texel = 0;
};
struct GlStand {
  GLint camera = 0;
  float weight = 0;
};

inline GlCamera gl_camera(const CameraMap& map, const Viewpoint& view, bool parallel) {
  GlCamera out;
  if (!map.visible) return out;
  double u = map.u0, v = map.v0, slope = map.scale;
  if (parallel) {  // u - x = (u0 - k cx) + (k - 1) x with k = scale / f_out
    const double k = map.scale / view.focal_px;
    u -= k * view.cx_px;
    v -= k * view.cy_px;
    slope = k - 1;
  }
  if (!(std::abs(u) < 1e8 && std::abs(v) < 1e8)) return out;
  out.visible = 1;
  // To the nearest, not down: a fraction just below 1 would lose the digits that the snap needs.
  out.whole = {static_cast<GLint>(std::lround(u)), static_cast<GLint>(std::lround(v))};
  out.fraction = {static_cast<float>(u - out.whole[0]), static_cast<float>(v - out.whole[1])};
  out.slope = static_cast<float>(slope);
  return out;
}

/// One offset for all pixels, split by the CPU.
inline GlCamera gl_camera(const CameraShift& shift) {
  GlCamera out;
  if (!shift.visible) return out;
  out.visible = 1;
  out.whole = {shift.dx, shift.dy};
  out.fraction = {shift.ax, shift.ay};
  return out;
}

}  // namespace stuv
