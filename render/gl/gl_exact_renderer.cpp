#include <epoxy/gl.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <stdexcept>

#include "core/error.h"
#include "core/parallel.h"
#include "render/all_in_focus.h"
#include "render/cpu/sweep_blocks.h"
#include "render/gl/gl_cameras.h"
#include "render/gl/gl_context.h"
#include "render/gl/gl_renderer.h"
#include "render/gl/gl_sources.h"

namespace stuv {
namespace {

using Clock = std::chrono::steady_clock;

/// Pictures of cameras in the layers of one texture array, as many as a budget allows, the last used kept.
/// What is made here goes with the context.
class TextureArray {
 public:
  static constexpr std::size_t kBudget = std::size_t{1} << 30;

  explicit TextureArray(const ViewSet& views) : lf_(views.lf) {
    GLint layers = 0, size = 0;
    glGetIntegerv(GL_MAX_ARRAY_TEXTURE_LAYERS, &layers);
    glGetIntegerv(GL_MAX_TEXTURE_SIZE, &size);
    if (std::max(lf_.width, lf_.height) > size)
      throw Error(lf_.folder.string(),
                  fmt::format("has views of {}x{}, this OpenGL takes {}", lf_.width, lf_.height, size),
                  "use --backend cpu");
    const std::size_t layer_bytes =
        static_cast<std::size_t>(lf_.width) * lf_.height * 4 * bytes_per_sample(lf_.type);
    most_layers_ =
        std::min(static_cast<std::size_t>(layers), std::max<std::size_t>(1, kBudget / layer_bytes));
    layer_of_.assign(views.cameras.size(), -1);
  }
  TextureArray(const TextureArray&) = delete;
  TextureArray& operator=(const TextureArray&) = delete;

  /// Uploads what is missing of `cameras`; Error if all together exceed the budget.
  void need(PixelStore& store, const std::vector<int>& cameras) {
    if (cameras.size() > most_layers_)
      throw Error(lf_.folder.string(),
                  fmt::format("this viewpoint needs {} views at once, the texture budget of {} MB holds {}",
                              cameras.size(), kBudget >> 20, most_layers_),
                  "use --backend cpu, or a viewpoint nearer to the cameras' plane");
    if (cameras.size() > capacity_) grow(std::min(most_layers_, std::max(cameras.size(), 2 * capacity_)));
    std::vector<char> wanted(layer_of_.size(), 0);
    for (const int c : cameras) wanted[static_cast<std::size_t>(c)] = 1;
    for (const int c : cameras)
      if (layer_of_[static_cast<std::size_t>(c)] < 0) upload(store, c, free_layer(wanted));
  }
  int layer_of(int camera) const { return layer_of_[static_cast<std::size_t>(camera)]; }
  GLuint texture() const { return texture_; }

 private:
  void grow(std::size_t layers) {
    glDeleteTextures(1, &texture_);
    constexpr GLenum kFormats[] = {GL_RGBA8, GL_RGBA16, GL_RGBA16F, GL_RGBA32F};
    glCreateTextures(GL_TEXTURE_2D_ARRAY, 1, &texture_);
    glTextureStorage3D(texture_, 1, kFormats[static_cast<int>(lf_.type)], lf_.width, lf_.height,
                       static_cast<GLsizei>(layers));
    if (glGetError() != GL_NO_ERROR)
      throw Error(lf_.folder.string(), "does not fit into the memory of OpenGL", "use --backend cpu");
    capacity_ = layers;
    std::fill(layer_of_.begin(), layer_of_.end(), -1);
    camera_of_.assign(layers, -1);
  }

  /// A layer that holds nothing, or nothing that is wanted.
  std::size_t free_layer(const std::vector<char>& wanted) const {
    for (std::size_t i = 0; i < camera_of_.size(); ++i)
      if (camera_of_[i] < 0) return i;
    for (std::size_t i = 0; i < camera_of_.size(); ++i)
      if (!wanted[static_cast<std::size_t>(camera_of_[i])]) return i;
    throw std::logic_error("TextureArray: no layer is free");
  }

  template <class T>
  void fill(const StoredView& view, std::size_t layer, GLenum type, T full) {
    std::vector<T> rgba(static_cast<std::size_t>(view.width) * view.height * 4);
    const std::uint8_t* mask = view.mask_plane();
    for (std::size_t i = 0; i < rgba.size() / 4; ++i) {
      for (int c = 0; c < 3; ++c) rgba[4 * i + c] = view.plane<T>(view.channels == 3 ? c : 0)[i];
      rgba[4 * i + 3] = mask == nullptr || mask[i] ? full : T{0};
    }
    glTextureSubImage3D(texture_, 0, 0, 0, static_cast<GLint>(layer), view.width, view.height, 1, GL_RGBA,
                        type, rgba.data());
  }

  void upload(PixelStore& store, int camera, std::size_t layer) {
    const auto view = store.acquire(camera, {0, 0, lf_.width, lf_.height});
    if (view->type == PixelType::u8)
      fill<std::uint8_t>(*view, layer, GL_UNSIGNED_BYTE, 255);
    else if (view->type == PixelType::u16)
      fill<std::uint16_t>(*view, layer, GL_UNSIGNED_SHORT, 65535);
    else
      fill<float>(*view, layer, GL_FLOAT, 1);
    if (camera_of_[layer] >= 0) layer_of_[static_cast<std::size_t>(camera_of_[layer])] = -1;
    camera_of_[layer] = camera;
    layer_of_[static_cast<std::size_t>(camera)] = static_cast<int>(layer);
  }

  const LightField& lf_;
  std::size_t most_layers_ = 0, capacity_ = 0;
  GLuint texture_ = 0;
  std::vector<int> layer_of_, camera_of_;
};

/// Buffers of common.glsl, by binding.
enum Slot { kCameras, kPositions, kStarts, kStands, kCosts, kRows, kBest, kOutput, kMembers, kSlots };

class GlExactRenderer : public Renderer {
 public:
  explicit GlExactRenderer(const std::shared_ptr<const ViewSet>& views)
      : lattice_(*views), store_(views), textures_(*views) {
    const auto build = [](const char* name, const char* source) {
      return build_gl_program(name, (std::string(kCommonGlsl) + source).c_str());
    };
    difference_ = build("render/gl/difference.comp", kDifferenceComp);
    rows_ = build("render/gl/window_rows.comp", kWindowRowsComp);
    minimum_ = build("render/gl/minimum.comp", kMinimumComp);
    colour_ = build("render/gl/colour.comp", kColourComp);
    glCreateBuffers(kSlots, buffers_.data());
    glCreateQueries(GL_TIMESTAMP, static_cast<GLsizei>(queries_.size()), queries_.data());
    upload_lattice();
  }

  RenderedView all_in_focus(const Viewpoint& view, const RenderOptions& options,
                            const Reporter& reporter) override {
    validate(options);
    return render(view, options, true, reporter);
  }
  RenderedView focal_plane(const Viewpoint& view, double d_px, Filter filter) override {
    return render(view, focal_plane_options(d_px, filter), false, {});
  }
  void load(const Viewpoint& view, const RenderOptions& options) override {
    context_.make_current();
    prepare(Sweep(store_, lattice_, view, options));
  }

 private:
  RenderedView render(const Viewpoint& view, const RenderOptions& options, bool search,
                      const Reporter& reporter);
  void prepare(const Sweep& sweep);
  void upload_lattice();
  void upload_cameras(const Sweep& sweep);
  void upload_members(const Sweep& sweep, const std::vector<int>& cameras);
  void set_uniforms(GLuint program, const Sweep& sweep) const;
  void dispatch(GLuint program, const Viewpoint& view) const {
    glUseProgram(program);
    glDispatchCompute(static_cast<GLuint>(view.width + 7) / 8, static_cast<GLuint>(view.height + 7) / 8, 1);
    glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT);
  }
  template <class T>
  void upload(Slot slot, const std::vector<T>& data) {
    glNamedBufferData(buffers_[slot], static_cast<GLsizeiptr>(data.size() * sizeof(T)), data.data(),
                      GL_DYNAMIC_DRAW);
  }
  void reserve(Slot slot, std::size_t bytes) {
    if (bytes == reserved_[slot]) return;
    glNamedBufferData(buffers_[slot], static_cast<GLsizeiptr>(bytes), nullptr, GL_DYNAMIC_COPY);
    reserved_[slot] = bytes;
  }
  static GLint at(GLuint program, const char* name) { return glGetUniformLocation(program, name); }

  GlContext context_;
  SweepLattice lattice_;
  PixelStore store_;
  TextureArray textures_;
  GLuint difference_ = 0, rows_ = 0, minimum_ = 0, colour_ = 0;
  std::array<GLuint, kSlots> buffers_{};
  std::array<std::size_t, kSlots> reserved_{};
  std::array<GLuint, 3> queries_{};
  int second_lattice_ = 0, camera_count_ = 0;
};

void GlExactRenderer::upload_lattice() {
  std::vector<GLint> starts;
  std::vector<GlStand> stands;
  // Normal and wide have the same nodes. Each lattice closes with the end of its last node.
  for (const Filter filter : {Filter::wide, Filter::skipped}) {
    second_lattice_ = static_cast<int>(starts.size());
    for (const auto& bridge : lattice_.stands(static_cast<int>(filter))) {
      starts.push_back(static_cast<GLint>(stands.size()));
      for (const CameraWeight& c : bridge) stands.push_back({c.camera, static_cast<float>(c.weight)});
    }
    starts.push_back(static_cast<GLint>(stands.size()));
  }
  upload(kStarts, starts);
  upload(kStands, stands);
}

void GlExactRenderer::upload_cameras(const Sweep& sweep) {
  const ViewSet& set = store_.views();
  std::vector<GlCamera> cameras;
  cameras.reserve(sweep.disparities.size() * set.cameras.size());
  for (const double d : sweep.disparities)
    for (std::size_t c = 0; c < set.cameras.size(); ++c) {
      GlCamera camera;
      const int layer = textures_.layer_of(static_cast<int>(c));
      if (layer >= 0)
        camera = gl_camera(camera_map(set.lf, set.cameras[c], sweep.view, d), sweep.view, sweep.parallel);
      camera.layer = layer;
      cameras.push_back(camera);
    }
  upload(kCameras, cameras);
}

void GlExactRenderer::upload_members(const Sweep& sweep, const std::vector<int>& cameras) {
  struct Member {
    GLint camera;
    std::array<float, 3> weight;
  };
  std::vector<Member> members(cameras.size());
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    members[i] = {cameras[i], {0, 0, 0}};
    for (std::size_t k = 0; k < 3; ++k)
      for (const CameraWeight& c : sweep.constant[k])
        if (c.camera == cameras[i]) members[i].weight[k] = static_cast<float>(c.weight);
  }
  upload(kMembers, members);
}

void GlExactRenderer::set_uniforms(GLuint program, const Sweep& sweep) const {
  const LightField& lf = store_.views().lf;
  const Viewpoint& view = sweep.view;
  Eigen::Matrix3d K_inverse = Eigen::Matrix3d::Identity();
  K_inverse(0, 0) = K_inverse(1, 1) = 1 / view.focal_px;
  K_inverse(0, 2) = -view.cx_px / view.focal_px;
  K_inverse(1, 2) = -view.cy_px / view.focal_px;
  const Eigen::Matrix3f ray_from_pixel = (view.view_from_scene.transpose() * K_inverse).cast<float>();
  const LatticeFilter& thinned = lattice_.filters[static_cast<std::size_t>(Filter::skipped)];
  const kernels::PairWeights a = sweep.pair_weights();
  const float colour = lf.channels == 3 ? 1.0F : 0.0F;
  glProgramUniform2i(program, at(program, "size"), view.width, view.height);
  glProgramUniform1i(program, at(program, "constant_position"), sweep.positions.constant);
  glProgramUniform1i(program, at(program, "parallel_view"), sweep.parallel);
  glProgramUniformMatrix3fv(program, at(program, "ray_from_pixel"), 1, GL_FALSE, ray_from_pixel.data());
  glProgramUniform2i(program, at(program, "full_lattice"), lf.cols, lf.rows);
  glProgramUniform2i(program, at(program, "thinned_lattice"), thinned.thinned_cols(), thinned.thinned_rows());
  glProgramUniform1i(program, at(program, "second_lattice"), second_lattice_);
  glProgramUniform1i(program, at(program, "member_count"), camera_count_);
  glProgramUniform1i(program, at(program, "camera_count"), static_cast<GLint>(store_.views().cameras.size()));
  glProgramUniform1f(program, at(program, "snap_px"), static_cast<float>(FocalPlaneRenderer::kSnap_px));
  glProgramUniform1f(program, at(program, "least_coverage"), FocalPlaneRenderer::kLeastCoverage);
  glProgramUniform3f(program, at(program, "pair_weights"), a.a01, a.a02, a.a12);
  glProgramUniform3f(program, at(program, "channel_sum"), 1, colour, colour);
  glProgramUniform1i(program, at(program, "k"), static_cast<GLint>(sweep.options.k));
  glProgramUniform1i(program, at(program, "M"), std::max(sweep.M_x, sweep.M_y));
  glProgramUniform1f(program, at(program, "tie"), sweep.tie);
}

/// Everything of a viewpoint that the shaders read.
void GlExactRenderer::prepare(const Sweep& sweep) {
  const SweepBlock whole(sweep, {0, 0, sweep.view.width, sweep.view.height});
  textures_.need(store_, whole.cameras());
  camera_count_ = whole.camera_count();
  upload_cameras(sweep);
  upload_members(sweep, whole.cameras());
  std::vector<std::array<float, 2>> positions;
  for (const Eigen::Vector2d& p : sweep.positions.p)
    positions.push_back({static_cast<float>(p.x()), static_cast<float>(p.y())});
  upload(kPositions, positions);
  const std::size_t pixels = static_cast<std::size_t>(sweep.view.width) * sweep.view.height;
  GLint64 most = 0;
  glGetInteger64v(GL_MAX_SHADER_STORAGE_BLOCK_SIZE, &most);
  if (static_cast<GLint64>(pixels * 32) > most)
    throw Error("OpenGL", fmt::format("cannot make a picture of {}x{}", sweep.view.width, sweep.view.height),
                "use a smaller --size or --backend cpu");
  reserve(kCosts, pixels * 16);
  reserve(kRows, pixels * 8);
  reserve(kBest, pixels * 16);
  reserve(kOutput, pixels * 32);
  for (const GLuint program : {difference_, rows_, minimum_, colour_}) set_uniforms(program, sweep);
  for (GLuint slot = 0; slot < kSlots; ++slot)
    glBindBufferBase(GL_SHADER_STORAGE_BUFFER, slot, buffers_[slot]);
  glBindTextureUnit(0, textures_.texture());
}

RenderedView GlExactRenderer::render(const Viewpoint& view, const RenderOptions& options, bool search,
                                     const Reporter& reporter) {
  validate(view, store_.views().lf);
  const auto start = Clock::now();
  context_.make_current();
  const Sweep sweep(store_, lattice_, view, options);
  prepare(sweep);
  glQueryCounter(queries_[0], GL_TIMESTAMP);
  for (int n = 0; n < options.planes; ++n) {
    glProgramUniform1i(difference_, at(difference_, "n"), n);
    glProgramUniform1i(minimum_, at(minimum_, "n"), n);
    dispatch(difference_, view);
    dispatch(rows_, view);
    dispatch(minimum_, view);
    reporter.at("planes", static_cast<std::size_t>(n) + 1, static_cast<std::size_t>(options.planes));
  }
  glQueryCounter(queries_[1], GL_TIMESTAMP);
  dispatch(colour_, view);
  glQueryCounter(queries_[2], GL_TIMESTAMP);
  glMemoryBarrier(GL_BUFFER_UPDATE_BARRIER_BIT);
  const std::size_t pixels = static_cast<std::size_t>(view.width) * view.height;
  std::vector<float> result(pixels * 8);
  glGetNamedBufferSubData(buffers_[kOutput], 0, static_cast<GLsizeiptr>(pixels * 32), result.data());
  check_gl("rendering");

  RenderedView out = empty_picture(view, store_.views().lf.channels);
  parallel_for(view.height, [&](int y) {
    for (int x = 0; x < view.width; ++x) {
      const float* r = &result[8 * (static_cast<std::size_t>(y) * view.width + x)];
      const int n = static_cast<int>(r[4]);
      out.plane.at(x, y) = n;
      if (n < 0) continue;
      for (int c = 0; c < out.colour.channels; ++c) out.colour.at(x, y, c) = r[c];
      out.disparity.at(x, y) = static_cast<float>(sweep.disparities[static_cast<std::size_t>(n)]);
      if (lattice_.chart.inside_hull(sweep.positions.at(view, x, y)))
        out.confidence.at(x, y) = search ? r[3] * r[5] : r[3];
    }
  });
  std::array<GLuint64, 3> ns{};
  for (std::size_t i = 0; i < ns.size(); ++i) glGetQueryObjectui64v(queries_[i], GL_QUERY_RESULT, &ns[i]);
  // Each camera of the aperture is sampled once a plane, by four texels.
  out.statistics.texels = 4.0 * camera_count_ * static_cast<double>(pixels) * (options.planes + 1);
  out.statistics.stages_ms = {{"planes on the GPU", static_cast<double>(ns[1] - ns[0]) * 1e-6},
                              {"colour on the GPU", static_cast<double>(ns[2] - ns[1]) * 1e-6}};
  out.statistics.milliseconds = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
  return out;
}

}  // namespace

std::unique_ptr<Renderer> make_gl_exact_renderer(std::shared_ptr<const ViewSet> views) {
  return std::make_unique<GlExactRenderer>(views);
}

}  // namespace stuv
