#include <epoxy/gl.h>
#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <limits>

#include "core/error.h"
#include "core/parallel.h"
#include "render/all_in_focus.h"
#include "render/cpu/sweep_blocks.h"
#include "render/gl/gl_cameras.h"
#include "render/gl/gl_context.h"
#include "render/gl/gl_pictures.h"
#include "render/gl/gl_renderer.h"
#include "render/gl/gl_sources.h"

namespace stuv {
namespace {

using Clock = std::chrono::steady_clock;

/// Buffers of common.glsl, by binding; the pictures follow.
enum Slot { kCameras, kPositions, kStarts, kStands, kCosts, kRows, kBest, kOutput, kMembers, kSlots };

/// As colour.comp packs a pixel without a plane.
constexpr int kNoPlane = 0x1ffff;

/// Invocations of a group, as common.glsl has them.
constexpr int kGroupWidth = 32, kGroupHeight = 4;
/// Pixels that an invocation of difference_shifted.comp makes, one above the other.
constexpr int kColumn = 4;

/// Planes that one dispatch evaluates: large enough to keep a GPU busy with small pictures, and as few as fit
/// beside the pictures.
int planes_at_once(std::size_t pixels, int planes) {
  constexpr std::size_t kCosts_bytes = 8, kMost_bytes = std::size_t{64} << 20;
  const auto fit = static_cast<int>(std::max<std::size_t>(1, kMost_bytes / (pixels * kCosts_bytes)));
  return std::min({planes, fit, 16});
}

class GlExactRenderer : public Renderer {
 public:
  explicit GlExactRenderer(const std::shared_ptr<const ViewSet>& views)
      : lattice_(*views), store_(views), pictures_(*views) {
    const auto build = [&](const char* name, const char* source) {
      const std::string text = "#version 450 core\n" + pictures_.definitions() + kCommonGlsl + source;
      return build_gl_program(name, text.c_str());
    };
    difference_ = build("render/gl/difference.comp", kDifferenceComp);
    difference_shifted_ = build("render/gl/difference_shifted.comp", kDifferenceShiftedComp);
    rows_ = build("render/gl/window_rows.comp", kWindowRowsComp);
    minimum_ = build("render/gl/minimum.comp", kMinimumComp);
    colour_ = build("render/gl/colour.comp", kColourComp);
    glCreateBuffers(kSlots, buffers_.data());
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
  void upload_members(const std::vector<CameraPart>& parts);
  void set_uniforms(GLuint program, const Sweep& sweep) const;
  GLuint difference_in_use() const { return shifted_ ? difference_shifted_ : difference_; }
  void dispatch(GLuint program, const Viewpoint& view, int planes = 1, int column = 1) const {
    glUseProgram(program);
    const int rows = kGroupHeight * column;
    glDispatchCompute(static_cast<GLuint>((view.width + kGroupWidth - 1) / kGroupWidth),
                      static_cast<GLuint>((view.height + rows - 1) / rows), static_cast<GLuint>(planes));
    glMemoryBarrier(GL_SHADER_STORAGE_BARRIER_BIT);
  }
  const std::uint32_t* read_back(std::size_t bytes);
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
  GlPictures pictures_;
  GLuint difference_ = 0, difference_shifted_ = 0, rows_ = 0, minimum_ = 0, colour_ = 0;
  std::array<GLuint, kSlots> buffers_{};
  std::array<std::size_t, kSlots> reserved_{};
  std::vector<GLuint> queries_;
  int second_lattice_ = 0, camera_count_ = 0, batch_ = 1;
  bool shifted_ = false;  ///< meet_at_one_offset
  GLuint staging_ = 0;    ///< what the host reads, mapped for good
  std::size_t staging_bytes_ = 0;
  const std::uint32_t* staged_ = nullptr;
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
      const auto place = pictures_.place_of(static_cast<int>(c));
      GlCamera camera;
      if (place.layer >= 0 && shifted_)
        camera = gl_camera(sweep.shifts[cameras.size()]);
      else if (place.layer >= 0)
        camera = gl_camera(camera_map(set.lf, set.cameras[c], sweep.view, d), sweep.view, sweep.parallel);
      camera.block = place.block;
      camera.first_texel = place.first_texel;
      cameras.push_back(camera);
    }
  upload(kCameras, cameras);
}

void GlExactRenderer::upload_members(const std::vector<CameraPart>& parts) {
  struct Member {
    GLint camera;
    std::array<float, 3> weight;
  };
  std::vector<Member> members;
  for (const CameraPart& part : parts) {
    const auto& w = part.weight;
    members.push_back(
        {part.camera, {static_cast<float>(w[0]), static_cast<float>(w[1]), static_cast<float>(w[2])}});
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
  glProgramUniform2i(program, at(program, "picture_size"), lf.width, lf.height);
  glProgramUniform1i(program, at(program, "shifted"), shifted_);
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
  const std::vector<CameraPart> parts = cameras_in(sweep, {0, 0, sweep.view.width, sweep.view.height});
  std::vector<int> in_use;
  for (const CameraPart& part : parts) in_use.push_back(part.camera);
  pictures_.need(store_, in_use);
  camera_count_ = static_cast<int>(in_use.size());
  shifted_ = meet_at_one_offset(sweep, in_use);
  upload_cameras(sweep);
  upload_members(parts);
  std::vector<std::array<float, 2>> positions;
  for (const Eigen::Vector2d& p : sweep.positions.p)
    positions.push_back({static_cast<float>(p.x()), static_cast<float>(p.y())});
  upload(kPositions, positions);
  const std::size_t pixels = static_cast<std::size_t>(sweep.view.width) * sweep.view.height;
  GLint64 most = 0;
  glGetInteger64v(GL_MAX_SHADER_STORAGE_BLOCK_SIZE, &most);
  // An OpenGL need not take more than 65535 groups in a row or column.
  constexpr int kMostGroups = 65535;
  if (static_cast<GLint64>(pixels * 16) > most || sweep.view.height > kMostGroups * kGroupHeight)
    throw Error("OpenGL", fmt::format("cannot make a picture of {}x{}", sweep.view.width, sweep.view.height),
                "use a smaller --size or --backend cpu");
  batch_ = planes_at_once(pixels, sweep.options.planes);
  const std::size_t batch_bytes = static_cast<std::size_t>(batch_) * pixels * 8;
  reserve(kCosts, batch_bytes);
  reserve(kRows, batch_bytes);
  reserve(kBest, pixels * 16);
  reserve(kOutput, pixels * 16);
  for (const GLuint program : {difference_in_use(), rows_, minimum_, colour_}) set_uniforms(program, sweep);
  for (GLuint slot = 0; slot < kSlots; ++slot)
    glBindBufferBase(GL_SHADER_STORAGE_BUFFER, slot, buffers_[slot]);
  pictures_.bind(kSlots);
}

/// The output, in memory that the GPU writes by itself.
const std::uint32_t* GlExactRenderer::read_back(std::size_t bytes) {
  if (staging_bytes_ != bytes) {
    glDeleteBuffers(1, &staging_);
    glCreateBuffers(1, &staging_);
    constexpr GLbitfield kMapped = GL_MAP_READ_BIT | GL_MAP_PERSISTENT_BIT | GL_MAP_COHERENT_BIT;
    const auto size = static_cast<GLsizeiptr>(bytes);
    glNamedBufferStorage(staging_, size, nullptr, kMapped | GL_CLIENT_STORAGE_BIT);
    staged_ = static_cast<const std::uint32_t*>(glMapNamedBufferRange(staging_, 0, size, kMapped));
    staging_bytes_ = staged_ != nullptr ? bytes : 0;
  }
  glMemoryBarrier(GL_BUFFER_UPDATE_BARRIER_BIT);
  if (staged_ != nullptr)
    glCopyNamedBufferSubData(buffers_[kOutput], staging_, 0, 0, static_cast<GLsizeiptr>(bytes));
  glFinish();
  check_gl("rendering");
  return staged_;
}

RenderedView GlExactRenderer::render(const Viewpoint& view, const RenderOptions& options, bool search,
                                     const Reporter& reporter) {
  validate(view, store_.views().lf);
  const auto start = Clock::now();
  context_.make_current();
  const Sweep sweep(store_, lattice_, view, options);
  prepare(sweep);
  const GLuint difference = difference_in_use();
  std::vector<GLuint> times;
  const auto timestamp = [&] {
    if (times.size() == queries_.size()) {
      queries_.push_back(0);
      glCreateQueries(GL_TIMESTAMP, 1, &queries_.back());
    }
    times.push_back(queries_[times.size()]);
    glQueryCounter(times.back(), GL_TIMESTAMP);
  };
  for (int n = 0; n < options.planes; n += batch_) {
    const int batch = std::min(batch_, options.planes - n);
    for (const GLuint program : {difference, minimum_})
      glProgramUniform1i(program, at(program, "first_plane"), n);
    glProgramUniform1i(minimum_, at(minimum_, "batch"), batch);
    timestamp();
    dispatch(difference, view, batch, shifted_ ? kColumn : 1);
    timestamp();
    dispatch(rows_, view, batch);
    dispatch(minimum_, view);
    reporter.at("planes", static_cast<std::size_t>(n + batch), static_cast<std::size_t>(options.planes));
  }
  glProgramUniform1i(colour_, at(colour_, "search"), search);
  timestamp();
  dispatch(colour_, view);
  timestamp();
  const std::size_t pixels = static_cast<std::size_t>(view.width) * view.height;
  const std::uint32_t* result = read_back(pixels * 16);

  RenderedView out = unset_picture(view, store_.views().lf.channels);
  parallel_for(view.height, [&](int y) {
    const bool constant = sweep.positions.constant;
    const bool all_inside = constant && lattice_.chart.inside_hull(sweep.positions.p[0]);
    for (int x = 0; x < view.width; ++x) {
      const std::uint32_t* r = &result[4 * (static_cast<std::size_t>(y) * view.width + x)];
      const auto n = static_cast<int>(r[3] >> 15);
      const bool chosen = n != kNoPlane;
      for (int c = 0; c < out.colour.channels; ++c) out.colour.at(x, y, c) = std::bit_cast<float>(r[c]);
      out.plane.at(x, y) = chosen ? n : -1;
      out.disparity.at(x, y) = chosen ? static_cast<float>(sweep.disparities[static_cast<std::size_t>(n)])
                                      : std::numeric_limits<float>::quiet_NaN();
      const bool inside = constant ? all_inside : lattice_.chart.inside_hull(sweep.positions.at(view, x, y));
      out.confidence.at(x, y) = inside ? static_cast<float>(r[3] & 0x7fffU) / 0x7fff : 0;
    }
  });
  // Differences begin at even times and end at odd ones.
  std::array<double, 3> stages_ms{};
  GLuint64 before = 0, now = 0;
  for (std::size_t i = 0; i < times.size(); ++i, before = now) {
    glGetQueryObjectui64v(times[i], GL_QUERY_RESULT, &now);
    const std::size_t stage = i + 1 == times.size() ? 2 : (i + 1) % 2;
    if (i > 0) stages_ms[stage] += static_cast<double>(now - before) * 1e-6;
  }
  // Each camera of the aperture is sampled once a plane, by four texels.
  out.statistics.texels = 4.0 * camera_count_ * static_cast<double>(pixels) * (options.planes + 1);
  out.statistics.stages_ms = {{"differences on the GPU", stages_ms[0]},
                              {"windows on the GPU", stages_ms[1]},
                              {"colour on the GPU", stages_ms[2]}};
  out.statistics.milliseconds = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
  return out;
}

}  // namespace

std::unique_ptr<Renderer> make_gl_exact_renderer(std::shared_ptr<const ViewSet> views) {
  return std::make_unique<GlExactRenderer>(views);
}

}  // namespace stuv
