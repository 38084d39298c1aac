#pragma once

#include <array>
#include <string>

#include "core/light_field.h"
#include "core/view.h"
#include "render/renderer.h"

namespace stuv {

/// What is laid over the picture.
enum class Overlay { none, depth, confidence };

/// Everything that the viewer's switches and the mouse change.
struct ViewerState {
  double s = 0, t = 0, z = 0;  ///< of the viewpoint, in the scene's unit
  double yaw = 0, pitch = 0;   ///< to the right and up [rad]
  double zoom = 1;             ///< of the focal length
  bool all_in_focus = true;    ///< else one focal plane
  double focus_px = 0;         ///< its disparity
  RenderOptions options;
  Method method = Method::fast;
  Backend backend = Backend::cpu;
  Overlay overlay = Overlay::none;
};

/// Where the mouse may move the viewpoint: a quarter of the cameras' box beyond it, and along z as near to
/// the nearest plane as nine tenths of the way, as far back as that plane is away. Without metres z and the
/// angles stay 0.
struct ViewerReach {
  double s_low = 0, s_high = 0, t_low = 0, t_high = 0, z_low = 0, z_high = 0;
  double s_span = 0, t_span = 0;  ///< moved by a drag over the whole picture
  bool metric = false;
};
ViewerReach reach_of(const LightField& lf, const RenderOptions& options);

/// The mouse moved by parts of the picture's width and height: the scene follows it, the viewpoint goes the
/// other way.
void drag(ViewerState& state, const ViewerReach& reach, double dx, double dy);
/// Wheel: clicks > 0 go towards the scene, a fortieth of the range each.
void step_along_z(ViewerState& state, const ViewerReach& reach, double clicks);
/// Looks around, at most 0.7 rad to each side.
void turn(ViewerState& state, const ViewerReach& reach, double dx, double dy);
/// clicks > 0 zoom in by a tenth each, between a quarter and eight times.
void zoom(ViewerState& state, double clicks);

/// At 1/`shrink` of the views' size.
Viewpoint viewpoint_of(const ViewerState& state, const LightField& lf, int shrink);

/// How much smaller a picture must be (1, 2, 4 or 8 times along each side) to be made within `limit_ms`, if
/// the last full one took `full_ms`.
int shrink_for(double full_ms, double limit_ms);

/// 8-bit colour for the screen, with the overlay; depth from blue (far) to red (near).
Raster<std::uint8_t> screen_picture(const RenderedView& view, const ViewerState& state);

}  // namespace stuv
