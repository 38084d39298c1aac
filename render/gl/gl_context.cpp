#include "render/gl/gl_context.h"

#include <epoxy/egl.h>
#include <fmt/format.h>

#include <array>
#include <cstring>

#include "core/error.h"

namespace stuv {
namespace {

[[noreturn]] void fail(const std::string& what) {
  throw Error("OpenGL", fmt::format("{} (EGL error 0x{:04x})", what, eglGetError()),
              "install a driver with OpenGL 4.5 (Mesa has one in software), or use --backend cpu");
}

/// A display of a graphics card that needs no window system; EGL_NO_DISPLAY if there is no card.
EGLDisplay card_display() {
  const char* client = eglQueryString(EGL_NO_DISPLAY, EGL_EXTENSIONS);
  if (client == nullptr || std::strstr(client, "EGL_EXT_device_enumeration") == nullptr)
    return EGL_NO_DISPLAY;
  std::array<EGLDeviceEXT, 16> devices{};
  EGLint count = 0;
  if (!eglQueryDevicesEXT(static_cast<EGLint>(devices.size()), devices.data(), &count)) return EGL_NO_DISPLAY;
  for (std::size_t i = 0; i < static_cast<std::size_t>(count); ++i) {
    const char* is = eglQueryDeviceStringEXT(devices[i], EGL_EXTENSIONS);
    if (is == nullptr || std::strstr(is, "software") != nullptr) continue;
    const EGLDisplay display = eglGetPlatformDisplayEXT(EGL_PLATFORM_DEVICE_EXT, devices[i], nullptr);
    if (display != EGL_NO_DISPLAY && eglInitialize(display, nullptr, nullptr)) return display;
  }
  return EGL_NO_DISPLAY;
}

}  // namespace

GlContext::GlContext() {
  display_ = card_display();
  if (display_ == EGL_NO_DISPLAY) {
    display_ = eglGetPlatformDisplayEXT(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr);
    if (!eglInitialize(display_, nullptr, nullptr)) {
      display_ = eglGetDisplay(EGL_DEFAULT_DISPLAY);
      if (!eglInitialize(display_, nullptr, nullptr)) fail("no display");
    }
  }
  const EGLint config_attributes[] = {EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT,
                                      EGL_NONE};
  EGLConfig config = nullptr;
  EGLint count = 0;
  if (!eglBindAPI(EGL_OPENGL_API) || !eglChooseConfig(display_, config_attributes, &config, 1, &count) ||
      count == 0)
    fail("no configuration");
  const EGLint attributes[] = {EGL_CONTEXT_MAJOR_VERSION,
                               4,
                               EGL_CONTEXT_MINOR_VERSION,
                               5,
                               EGL_CONTEXT_OPENGL_PROFILE_MASK,
                               EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT,
                               EGL_NONE};
  context_ = eglCreateContext(display_, config, EGL_NO_CONTEXT, attributes);
  if (context_ == EGL_NO_CONTEXT) fail("no 4.5 core context");
  make_current();
}

GlContext::~GlContext() {
  eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
  eglDestroyContext(display_, context_);
}

void GlContext::make_current() const {
  if (!eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, context_)) fail("cannot be made current");
}

GLuint build_gl_program(const std::string& name, const char* source) {
  const auto check = [&](GLuint object, auto get, auto log, GLenum what) {
    GLint good = 0;
    get(object, what, &good);
    if (good) return;
    std::array<char, 2000> text{};
    log(object, static_cast<GLsizei>(text.size()), nullptr, text.data());
    throw Error(name, fmt::format("does not build: {}", text.data()),
                "use --backend cpu, and report the driver");
  };
  const GLuint shader = glCreateShader(GL_COMPUTE_SHADER);
  glShaderSource(shader, 1, &source, nullptr);
  glCompileShader(shader);
  check(shader, glGetShaderiv, glGetShaderInfoLog, GL_COMPILE_STATUS);
  const GLuint program = glCreateProgram();
  glAttachShader(program, shader);
  glLinkProgram(program);
  check(program, glGetProgramiv, glGetProgramInfoLog, GL_LINK_STATUS);
  glDeleteShader(shader);
  return program;
}

void check_gl(const char* what) {
  if (const GLenum error = glGetError(); error != GL_NO_ERROR)
    throw Error("OpenGL", fmt::format("{} failed (error 0x{:04x})", what, error), "use --backend cpu");
}

}  // namespace stuv
