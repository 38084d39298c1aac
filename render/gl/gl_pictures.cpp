#include "render/gl/gl_pictures.h"

#include <fmt/format.h>

#include <algorithm>
#include <stdexcept>

#include "core/error.h"

namespace stuv {
namespace {

/// Half floats are stored as floats.
bool whole_floats(PixelType type) { return type == PixelType::f16 || type == PixelType::f32; }

std::size_t texel_bytes(PixelType type) { return whole_floats(type) ? 16 : 4 * bytes_per_sample(type); }

}  // namespace

GlPictures::GlPictures(const ViewSet& views) : lf_(views.lf) {
  GLint64 largest = 0;
  glGetInteger64v(GL_MAX_SHADER_STORAGE_BLOCK_SIZE, &largest);
  const std::size_t block_bytes = std::min(kBudget, static_cast<std::size_t>(largest));
  layer_bytes_ = static_cast<std::size_t>(lf_.width) * lf_.height * texel_bytes(lf_.type);
  layers_a_block_ = block_bytes / layer_bytes_;
  if (layers_a_block_ == 0)
    throw Error(lf_.folder.string(),
                fmt::format("has views of {} MB, a buffer of this OpenGL holds {}", layer_bytes_ >> 20,
                            block_bytes >> 20),
                "use --backend cpu");
  most_layers_ = std::min(kBudget / layer_bytes_, kBlocks * layers_a_block_);
  layer_of_.assign(views.cameras.size(), -1);
}

void GlPictures::need(PixelStore& store, const std::vector<int>& cameras) {
  if (cameras.size() > most_layers_)
    throw Error(lf_.folder.string(),
                fmt::format("this viewpoint needs {} views at once, the budget of {} MB holds {}",
                            cameras.size(), most_layers_ * layer_bytes_ >> 20, most_layers_),
                "use --backend cpu, or a viewpoint nearer to the cameras' plane");
  if (cameras.size() > capacity_) grow(std::min(most_layers_, std::max(cameras.size(), 2 * capacity_)));
  std::vector<char> wanted(layer_of_.size(), 0);
  for (const int c : cameras) wanted[static_cast<std::size_t>(c)] = 1;
  for (const int c : cameras)
    if (layer_of_[static_cast<std::size_t>(c)] < 0) upload(store, c, free_layer(wanted));
}

void GlPictures::grow(std::size_t layers) {
  glDeleteBuffers(kBlocks, buffers_.data());
  glCreateBuffers(kBlocks, buffers_.data());
  std::size_t left = layers;
  for (const GLuint buffer : buffers_) {
    const std::size_t here = std::min(left, layers_a_block_);
    left -= here;
    // A binding that is not used must hold something all the same.
    glNamedBufferData(buffer, static_cast<GLsizeiptr>(std::max<std::size_t>(here * layer_bytes_, 16)),
                      nullptr, GL_STATIC_DRAW);
  }
  if (glGetError() != GL_NO_ERROR)
    throw Error(lf_.folder.string(), "does not fit into the memory of OpenGL", "use --backend cpu");
  capacity_ = layers;
  std::fill(layer_of_.begin(), layer_of_.end(), -1);
  camera_of_.assign(layers, -1);
}

void GlPictures::bind(GLuint first_binding) const {
  for (GLuint i = 0; i < kBlocks; ++i)
    glBindBufferBase(GL_SHADER_STORAGE_BUFFER, first_binding + i, buffers_[i]);
}

GlPictures::Place GlPictures::place_of(int camera) const {
  const int layer = layer_of_[static_cast<std::size_t>(camera)];
  if (layer < 0) return {};
  const auto l = static_cast<std::size_t>(layer);
  return {layer, static_cast<GLint>(l / layers_a_block_),
          static_cast<GLint>(l % layers_a_block_ * static_cast<std::size_t>(lf_.width) * lf_.height)};
}

std::string GlPictures::definitions() const {
  const std::size_t most = std::min(most_layers_, layer_of_.size());
  return fmt::format("#define TEXEL_{}\n#define BLOCKS {}\n",
                     whole_floats(lf_.type)      ? "FLOAT"
                     : lf_.type == PixelType::u8 ? "U8"
                                                 : "U16",
                     (most + layers_a_block_ - 1) / layers_a_block_);
}

std::size_t GlPictures::free_layer(const std::vector<char>& wanted) const {
  for (std::size_t i = 0; i < camera_of_.size(); ++i)
    if (camera_of_[i] < 0) return i;
  for (std::size_t i = 0; i < camera_of_.size(); ++i)
    if (!wanted[static_cast<std::size_t>(camera_of_[i])]) return i;
  throw std::logic_error("GlPictures: no layer is free");
}

template <class T>
void GlPictures::fill(const StoredView& view, std::size_t layer, T full) {
  std::vector<T> rgba(static_cast<std::size_t>(view.width) * view.height * 4);
  const std::uint8_t* mask = view.mask_plane();
  for (std::size_t i = 0; i < rgba.size() / 4; ++i) {
    for (int c = 0; c < 3; ++c) rgba[4 * i + c] = view.plane<T>(view.channels == 3 ? c : 0)[i];
    rgba[4 * i + 3] = mask == nullptr || mask[i] ? full : T{0};
  }
  glNamedBufferSubData(buffers_[layer / layers_a_block_],
                       static_cast<GLintptr>(layer % layers_a_block_ * layer_bytes_),
                       static_cast<GLsizeiptr>(rgba.size() * sizeof(T)), rgba.data());
}

void GlPictures::upload(PixelStore& store, int camera, std::size_t layer) {
  const auto view = store.acquire(camera, {0, 0, lf_.width, lf_.height});
  if (view->type == PixelType::u8)
    fill<std::uint8_t>(*view, layer, 255);
  else if (view->type == PixelType::u16)
    fill<std::uint16_t>(*view, layer, 65535);
  else
    fill<float>(*view, layer, 1);
  if (camera_of_[layer] >= 0) layer_of_[static_cast<std::size_t>(camera_of_[layer])] = -1;
  camera_of_[layer] = camera;
  layer_of_[static_cast<std::size_t>(camera)] = static_cast<int>(layer);
}

}  // namespace stuv
