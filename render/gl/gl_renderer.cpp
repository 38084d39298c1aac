#include <epoxy/egl.h>
#include <epoxy/gl.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "core/error.h"
#include "render/gl/focal_plane_comp.h"
#include "render/gl/gl_renderer.h"
#include "render/lattice_positions.h"

namespace stuv {
namespace {

/// A headless OpenGL 4.5 core context; frees it and what was made in it.
class Context {
 public:
  Context() {
    display_ = eglGetPlatformDisplayEXT(EGL_PLATFORM_SURFACELESS_MESA, EGL_DEFAULT_DISPLAY, nullptr);
    if (!eglInitialize(display_, nullptr, nullptr)) {
      display_ = eglGetDisplay(EGL_DEFAULT_DISPLAY);
      if (!eglInitialize(display_, nullptr, nullptr)) fail("no display");
    }
    const EGLint config_attributes[] = {EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE,
                                        EGL_OPENGL_BIT, EGL_NONE};
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
  ~Context() {
    eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT);
    eglDestroyContext(display_, context_);
  }
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;

  void make_current() {
    if (!eglMakeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, context_)) fail("cannot be made current");
  }

 private:
  [[noreturn]] static void fail(const std::string& what) {
    throw Error("OpenGL", fmt::format("{} (EGL error 0x{:04x})", what, eglGetError()),
                "install a driver with OpenGL 4.5 (Mesa has one in software), or use --backend cpu");
  }
  EGLDisplay display_ = EGL_NO_DISPLAY;
  EGLContext context_ = EGL_NO_CONTEXT;
};

GLuint build_program() {
  const auto check = [](GLuint object, auto get, auto log, GLenum what) {
    GLint good = 0;
    get(object, what, &good);
    if (good) return;
    std::array<char, 2000> text{};
    log(object, static_cast<GLsizei>(text.size()), nullptr, text.data());
    throw Error("render/gl/focal_plane.comp", fmt::format("does not build: {}", text.data()),
                "use --backend cpu, and report the driver");
  };
  const GLuint shader = glCreateShader(GL_COMPUTE_SHADER);
  glShaderSource(shader, 1, &kFocalPlaneComp, nullptr);
  glCompileShader(shader);
  check(shader, glGetShaderiv, glGetShaderInfoLog, GL_COMPILE_STATUS);
  const GLuint program = glCreateProgram();
  glAttachShader(program, shader);
  glLinkProgram(program);
  check(program, glGetProgramiv, glGetProgramInfoLog, GL_LINK_STATUS);
  glDeleteShader(shader);
  return program;
}

/// As the shader's structs (std430).
struct GlCamera {
  std::array<GLint, 2> whole{};
  std::array<float, 2> fraction{};
  float slope = 0;
  GLint visible = 0;
  std::array<GLint, 2> pad{};
};
struct GlStand {
  GLint camera = 0;
  float weight = 0;
};

GlCamera gl_camera(const CameraMap& map, const Viewpoint& view, bool parallel) {
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

class GlRenderer : public FocalPlaneRenderer {
 public:
  explicit GlRenderer(std::shared_ptr<const ViewSet> views)
      : views_(std::move(views)), chart_(views_->lf.rows, views_->lf.cols, views_->cameras) {
    for (const Filter filter : {Filter::normal, Filter::wide, Filter::skipped})
      filters_.emplace_back(views_->lf.rows, views_->lf.cols, views_->cameras, filter);
    program_ = build_program();
    glCreateBuffers(static_cast<GLsizei>(buffers_.size()), buffers_.data());
    upload_pictures();
  }

  FocalPlaneView render(const Viewpoint& view, double d_px, Filter filter) override;
  const ViewSet& views() const override { return *views_; }
  const char* name() const override { return "gl"; }

 private:
  void upload_pictures();
  void upload_filter(const LatticeFilter& filter);
  void upload_positions(const Viewpoint& view);
  template <class T>
  void upload(GLuint slot, const std::vector<T>& data) {
    glNamedBufferData(buffers_[slot], static_cast<GLsizeiptr>(data.size() * sizeof(T)), data.data(),
                      GL_STREAM_DRAW);
    glBindBufferBase(GL_SHADER_STORAGE_BUFFER, slot, buffers_[slot]);
  }
  GLint uniform(const char* name) const { return glGetUniformLocation(program_, name); }

  Context context_;
  std::shared_ptr<const ViewSet> views_;
  LatticeChart chart_;
  std::vector<LatticeFilter> filters_;
  GLuint program_ = 0, texture_ = 0;
  std::array<GLuint, 5> buffers_{};
  Viewpoint last_view_;
  bool constant_ = false;
};

void GlRenderer::upload_pictures() {
  const LightField& lf = views_->lf;
  GLint max_layers = 0, max_size = 0;
  glGetIntegerv(GL_MAX_ARRAY_TEXTURE_LAYERS, &max_layers);
  glGetIntegerv(GL_MAX_TEXTURE_SIZE, &max_size);
  const auto layers = static_cast<GLsizei>(views_->pixels.size());
  if (layers > max_layers || std::max(lf.width, lf.height) > max_size)
    throw Error(lf.folder.string(),
                fmt::format("has {} views of {}x{}, this OpenGL takes {} of {}", layers, lf.width, lf.height,
                            max_layers, max_size),
                "use --backend cpu");
  const GLenum formats[] = {GL_RGBA8, GL_RGBA16, GL_RGBA16F, GL_RGBA32F};
  glCreateTextures(GL_TEXTURE_2D_ARRAY, 1, &texture_);
  glTextureStorage3D(texture_, 1, formats[static_cast<int>(lf.type)], lf.width, lf.height, layers);
  for (GLsizei i = 0; i < layers; ++i) {
    const ViewPixels& view = views_->pixels[static_cast<std::size_t>(i)];
    ImageF rgba(lf.width, lf.height, 4);
    for (std::size_t k = 0; k < rgba.data.size() / 4; ++k) {
      for (std::size_t c = 0; c < 3; ++c)
        rgba.data[k * 4 + c] = view.colour.data[k * lf.channels + (lf.channels == 3 ? c : 0)];
      rgba.data[k * 4 + 3] = view.mask.empty() || view.mask.data[k] ? 1.0F : 0.0F;
    }
    glTextureSubImage3D(texture_, 0, 0, 0, i, lf.width, lf.height, 1, GL_RGBA, GL_FLOAT, rgba.data.data());
  }
  if (glGetError() != GL_NO_ERROR)
    throw Error(lf.folder.string(), "does not fit into the memory of OpenGL", "use --backend cpu");
}

void GlRenderer::upload_filter(const LatticeFilter& filter) {
  std::vector<GLint> starts;
  std::vector<GlStand> stands;
  for (const auto& bridge : filter.bridges()) {
    starts.push_back(static_cast<GLint>(stands.size()));
    for (const CameraWeight& c : bridge) stands.push_back({c.camera, static_cast<float>(c.weight)});
  }
  starts.push_back(static_cast<GLint>(stands.size()));
  upload(2, starts);
  upload(3, stands);
  glUniform2i(uniform("full_lattice"), views_->lf.cols, views_->lf.rows);
  glUniform2i(uniform("lattice"), filter.thinned_cols(), filter.thinned_rows());
  glUniform1f(uniform("stride"), static_cast<float>(filter.stride()));
  glUniform1f(uniform("half_width"), static_cast<float>(filter.half_width()));
}

void GlRenderer::upload_positions(const Viewpoint& view) {
  const LatticePositions positions = lattice_positions(chart_, view);
  std::vector<std::array<float, 2>> p;
  for (const Eigen::Vector2d& at : positions.p)
    p.push_back({static_cast<float>(at.x()), static_cast<float>(at.y())});
  upload(1, p);
  constant_ = positions.constant;
  last_view_ = view;
}

FocalPlaneView GlRenderer::render(const Viewpoint& view, double d_px, Filter filter) {
  const LightField& lf = views_->lf;
  validate(view, lf);
  if (!std::isfinite(d_px)) throw std::invalid_argument("render: the disparity must be finite");
  const std::size_t pixels = static_cast<std::size_t>(view.width) * view.height;
  context_.make_current();
  GLint64 max_block = 0;
  glGetInteger64v(GL_MAX_SHADER_STORAGE_BLOCK_SIZE, &max_block);
  if (static_cast<GLint64>(pixels * 16) > max_block)
    throw Error("OpenGL", fmt::format("cannot make a picture of {}x{}", view.width, view.height),
                "use a smaller --size or --backend cpu");
  glUseProgram(program_);
  if (!same_viewpoint(view, last_view_)) upload_positions(view);
  const bool parallel = is_parallel(view);
  std::vector<GlCamera> cameras;
  for (const View& c : views_->cameras)
    cameras.push_back(gl_camera(camera_map(lf, c, view, d_px), view, parallel));
  upload(0, cameras);
  upload_filter(filters_[static_cast<std::size_t>(filter)]);
  glNamedBufferData(buffers_[4], static_cast<GLsizeiptr>(pixels * 16), nullptr, GL_STREAM_READ);
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 4, buffers_[4]);
  glBindTextureUnit(0, texture_);
  Eigen::Matrix3d K_inverse = Eigen::Matrix3d::Identity();
  K_inverse(0, 0) = K_inverse(1, 1) = 1 / view.focal_px;
  K_inverse(0, 2) = -view.cx_px / view.focal_px;
  K_inverse(1, 2) = -view.cy_px / view.focal_px;
  const Eigen::Matrix3f ray_from_pixel = (view.view_from_scene.transpose() * K_inverse).cast<float>();
  glUniformMatrix3fv(uniform("ray_from_pixel"), 1, GL_FALSE, ray_from_pixel.data());
  glUniform2i(uniform("size"), view.width, view.height);
  glUniform1i(uniform("constant_position"), constant_);
  glUniform1i(uniform("parallel_view"), parallel);
  glUniform1f(uniform("snap_px"), static_cast<float>(kSnap_px));
  glDispatchCompute(static_cast<GLuint>(view.width + 7) / 8, static_cast<GLuint>(view.height + 7) / 8, 1);
  glMemoryBarrier(GL_BUFFER_UPDATE_BARRIER_BIT);
  std::vector<float> result(pixels * 4);
  glGetNamedBufferSubData(buffers_[4], 0, static_cast<GLsizeiptr>(pixels * 16), result.data());
  if (const GLenum error = glGetError(); error != GL_NO_ERROR)
    throw Error("OpenGL", fmt::format("rendering failed (error 0x{:04x})", error), "use --backend cpu");

  FocalPlaneView out{ImageF(view.width, view.height, lf.channels), ImageF(view.width, view.height, 1)};
  for (std::size_t i = 0; i < pixels; ++i) {
    for (int c = 0; c < lf.channels; ++c) out.colour.data[i * lf.channels + c] = result[i * 4 + c];
    out.coverage.data[i] = result[i * 4 + 3];
  }
  return out;
}

}  // namespace

std::unique_ptr<FocalPlaneRenderer> make_gl_renderer(std::shared_ptr<const ViewSet> views) {
  return std::make_unique<GlRenderer>(std::move(views));
}

std::string gl_renderer_name() {
  const Context context;
  return reinterpret_cast<const char*>(glGetString(GL_RENDERER));
}

}  // namespace stuv
