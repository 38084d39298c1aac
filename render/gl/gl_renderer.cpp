#include <epoxy/gl.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>

#include "core/error.h"
#include "render/gl/gl_cameras.h"
#include "render/gl/gl_context.h"
#include "render/gl/gl_renderer.h"
#include "render/gl/gl_sources.h"
#include "render/lattice_positions.h"

namespace stuv {
namespace {

class GlRenderer : public FocalPlaneRenderer {
 public:
  explicit GlRenderer(std::shared_ptr<const ViewSet> views)
      : views_(std::move(views)), chart_(views_->lf.rows, views_->lf.cols, views_->cameras) {
    for (const Filter filter : {Filter::normal, Filter::wide, Filter::skipped})
      filters_.emplace_back(views_->lf.rows, views_->lf.cols, views_->cameras, filter);
    program_ = build_gl_program("render/gl/focal_plane.comp", kFocalPlaneComp);
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

  GlContext context_;
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
  const GlContext context;
  return reinterpret_cast<const char*>(glGetString(GL_RENDERER));
}

}  // namespace stuv
