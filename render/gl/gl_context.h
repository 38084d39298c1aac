#pragma once

#include <epoxy/gl.h>

#include <string>

namespace stuv {

/// A headless OpenGL 4.5 core context; frees it and what was made in it. Throws Error where there is none.
class GlContext {
 public:
  GlContext();
  ~GlContext();
  GlContext(const GlContext&) = delete;
  GlContext& operator=(const GlContext&) = delete;
  void make_current() const;

 private:
  // EGLDisplay and EGLContext, without their header.
  void *display_ = nullptr, *context_ = nullptr;
};

/// A program of one compute shader. Throws Error with the driver's log if it does not build.
GLuint build_gl_program(const std::string& name, const char* source);

/// Throws Error if an OpenGL call has failed.
void check_gl(const char* what);

}  // namespace stuv
