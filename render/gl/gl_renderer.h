#pragma once

#include <string>

#include "render/focal_plane.h"
#include "render/renderer.h"

namespace stuv {

/// The same pictures in OpenGL 4.5 core, through EGL without a window; within 1/255 of the CPU's. Throws
/// Error where there is no such context, or the views exceed its limits.
std::unique_ptr<FocalPlaneRenderer> make_gl_renderer(std::shared_ptr<const ViewSet> views);

/// GL_RENDERER of the context that make_gl_renderer uses.
std::string gl_renderer_name();

/// Method `exact` with all five steps on the GPU: nothing is read back but the result. Pictures of the
/// cameras in use stay in buffers of at most 1 GB; statistics hold the times that the GPU took.
/// Throws Error if there is no OpenGL 4.5, or a viewpoint needs more than the budget.
std::unique_ptr<Renderer> make_gl_exact_renderer(std::shared_ptr<const ViewSet> views);

}  // namespace stuv
