#pragma once

#include <epoxy/gl.h>

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "render/pixel_store.h"

namespace stuv {

/// The cameras' pictures in storage buffers, RGBA with alpha 0 where pixels are missing, as many as a budget
/// allows, the last used kept. Buffers, not textures: neighbouring invocations read neighbouring texels,
/// which a GPU's load units answer several times as fast as its texture units, and a shader blends taps with
/// float weights either way. What is made here goes with the context.
class GlPictures {
 public:
  static constexpr std::size_t kBudget = std::size_t{1} << 30;
  /// A driver bounds the size of a buffer (some at 128 MB): pictures lie in several, at consecutive bindings.
  static constexpr int kBlocks = 4;

  explicit GlPictures(const ViewSet& views);
  GlPictures(const GlPictures&) = delete;
  GlPictures& operator=(const GlPictures&) = delete;

  /// Uploads what is missing of `cameras`; Error if all together exceed the budget.
  void need(PixelStore& store, const std::vector<int>& cameras);
  void bind(GLuint first_binding) const;

  /// Where a camera's picture begins; layer -1: not here.
  struct Place {
    int layer = -1;
    GLint block = 0;
    GLint first_texel = 0;
  };
  Place place_of(int camera) const;
  /// What the shaders need to know: the type of a texel, and how many blocks there may be.
  std::string definitions() const;

 private:
  void grow(std::size_t layers);
  std::size_t free_layer(const std::vector<char>& wanted) const;
  void upload(PixelStore& store, int camera, std::size_t layer);
  template <class T>
  void fill(const StoredView& view, std::size_t layer, T full);

  const LightField& lf_;
  std::size_t layer_bytes_ = 0, layers_a_block_ = 0, most_layers_ = 0, capacity_ = 0;
  std::array<GLuint, kBlocks> buffers_{};
  std::vector<int> layer_of_, camera_of_;
};

}  // namespace stuv
