#pragma once

#include <string>

#include "render/focal_plane.h"

namespace stuv {

/// The same pictures in OpenGL 4.5 core, through EGL without a window; within 1/255 of the CPU's. Throws
/// Error where there is no such context, or the views exceed its limits.
std::unique_ptr<FocalPlaneRenderer> make_gl_renderer(std::shared_ptr<const ViewSet> views);

/// GL_RENDERER of the context that make_gl_renderer uses.
std::string gl_renderer_name();

}  // namespace stuv
