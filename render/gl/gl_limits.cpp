#include "render/gl/gl_limits.h"

#include <chrono>

#include "render/gl/gl_context.h"
#include "render/gl/gl_sources.h"

namespace stuv {

double measure_texel_fetches(double seconds) {
  using Clock = std::chrono::steady_clock;
  constexpr int kSize = 512, kLayers = 16, kFetches = 4 * kLayers;  // as texel_rate.comp has them
  const GlContext context;
  const GLuint program = build_gl_program("render/gl/texel_rate.comp", kTexelRateComp);
  GLuint texture = 0, buffer = 0;
  glCreateTextures(GL_TEXTURE_2D_ARRAY, 1, &texture);
  // The quads reach a little over the picture.
  glTextureStorage3D(texture, 1, GL_RGBA8, kSize + kLayers + 1, kSize + kLayers + 1, kLayers);
  glClearTexImage(texture, 0, GL_RGBA, GL_UNSIGNED_BYTE, nullptr);
  glCreateBuffers(1, &buffer);
  glNamedBufferData(buffer, GLsizeiptr{kSize} * kSize * 16, nullptr, GL_DYNAMIC_COPY);
  glBindTextureUnit(0, texture);
  glBindBufferBase(GL_SHADER_STORAGE_BUFFER, 0, buffer);
  glUseProgram(program);
  const auto run = [&] {
    glDispatchCompute(kSize / 8, kSize / 8, 1);
    glFinish();
  };
  run();  // builds what the driver builds late
  check_gl("measuring texel fetches");
  double done = 0, elapsed = 0;
  const auto start = Clock::now();
  while (elapsed < seconds) {
    run();
    done += static_cast<double>(kSize) * kSize * kFetches;
    elapsed = std::chrono::duration<double>(Clock::now() - start).count();
  }
  return done / elapsed;
}

}  // namespace stuv
