#include "render/gl/gl_limits.h"

#include <array>
#include <chrono>

#include "render/gl/gl_context.h"
#include "render/gl/gl_sources.h"

namespace stuv {

double measure_texel_fetches(double seconds) {
  using Clock = std::chrono::steady_clock;
  constexpr int kSize = 512, kLayers = 16, kFetches = 4 * kLayers;  // as texel_rate.comp has them
  // The quads reach a little over the picture.
  constexpr int kStride = kSize + kLayers + 1;
  const GlContext context;
  const GLuint program = build_gl_program("render/gl/texel_rate.comp", kTexelRateComp);
  std::array<GLuint, 2> buffers{};
  glCreateBuffers(2, buffers.data());
  glNamedBufferData(buffers[0], GLsizeiptr{kSize} * kSize * 4, nullptr, GL_DYNAMIC_COPY);
  glNamedBufferData(buffers[1], GLsizeiptr{kStride} * kStride * kLayers * 4, nullptr, GL_STATIC_DRAW);
  glClearNamedBufferData(buffers[1], GL_R32UI, GL_RED_INTEGER, GL_UNSIGNED_INT, nullptr);
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 0, buffers[0]);
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 1, buffers[1]);
  glUseProgram(program);
  // Often enough between two waits that a fast card does not mostly wait.
  const auto run = [&](int times) {
    for (int i = 0; i < times; ++i) glDispatchCompute(kSize / 32, kSize / 4, 1);
    glFinish();
  };
  run(1);  // builds what the driver builds late
  check_gl("measuring texel fetches");
  double done = 0, elapsed = 0;
  int times = 1;
  const auto start = Clock::now();
  while (elapsed < seconds) {
    run(times);
    done += static_cast<double>(times) * kSize * kSize * kFetches;
    const double now = std::chrono::duration<double>(Clock::now() - start).count();
    if (now - elapsed < 0.02 * seconds) times *= 2;
    elapsed = now;
  }
  return done / elapsed;
}

}  // namespace stuv
