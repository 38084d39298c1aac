#include "core/image.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

#include "core/error.h"

namespace stuv {
namespace {

template <class T>
void integers_to_float(const std::byte* bytes, decltype(ImageF::data)& out) {
  constexpr float scale = 1.0F / static_cast<float>(std::numeric_limits<T>::max());
  const T* values = reinterpret_cast<const T*>(bytes);
  for (std::size_t i = 0; i < out.size(); ++i) out[i] = static_cast<float>(values[i]) * scale;
}

template <class T>
void float_to_integers(const decltype(ImageF::data)& in, std::byte* bytes) {
  constexpr float top = static_cast<float>(std::numeric_limits<T>::max());
  T* values = reinterpret_cast<T*>(bytes);
  for (std::size_t i = 0; i < in.size(); ++i) {
    // A NaN fails both comparisons of clamp and would be undefined as an integer.
    const float value = std::isnan(in[i]) ? 0.0F : std::clamp(in[i], 0.0F, 1.0F);
    values[i] = static_cast<T>(std::lrint(value * top));
  }
}

}  // namespace

std::size_t bytes_per_sample(PixelType type) {
  switch (type) {
    case PixelType::u8:
      return 1;
    case PixelType::u16:
    case PixelType::f16:
      return 2;
    case PixelType::f32:
      return 4;
  }
  return 0;
}

const char* name_of(PixelType type) {
  switch (type) {
    case PixelType::u8:
      return "u8";
    case PixelType::u16:
      return "u16";
    case PixelType::f16:
      return "f16";
    case PixelType::f32:
      return "f32";
  }
  return "";
}

PixelType pixel_type_from_name(const std::string& name) {
  for (const PixelType type : {PixelType::u8, PixelType::u16, PixelType::f16, PixelType::f32})
    if (name == name_of(type)) return type;
  throw Error("pixel type '" + name + "'", "is not known", "use u8, u16, f16 or f32");
}

ImageF to_float(const Image& image) {
  ImageF out(image.width, image.height, image.channels);
  switch (image.type) {
    case PixelType::u8:
      integers_to_float<std::uint8_t>(image.bytes.data(), out.data);
      break;
    case PixelType::u16:
      integers_to_float<std::uint16_t>(image.bytes.data(), out.data);
      break;
    case PixelType::f16: {
      const auto* values = reinterpret_cast<const Eigen::half*>(image.bytes.data());
      for (std::size_t i = 0; i < out.data.size(); ++i) out.data[i] = static_cast<float>(values[i]);
      break;
    }
    case PixelType::f32:
      std::memcpy(out.data.data(), image.bytes.data(), image.bytes.size());
      break;
  }
  return out;
}

Image from_float(const ImageF& pixels, PixelType type) {
  Image out;
  out.width = pixels.width;
  out.height = pixels.height;
  out.channels = pixels.channels;
  out.type = type;
  out.bytes.resize(pixels.data.size() * bytes_per_sample(type));
  switch (type) {
    case PixelType::u8:
      float_to_integers<std::uint8_t>(pixels.data, out.bytes.data());
      break;
    case PixelType::u16:
      float_to_integers<std::uint16_t>(pixels.data, out.bytes.data());
      break;
    case PixelType::f16: {
      auto* values = reinterpret_cast<Eigen::half*>(out.bytes.data());
      for (std::size_t i = 0; i < pixels.data.size(); ++i)
        values[i] = static_cast<Eigen::half>(pixels.data[i]);
      break;
    }
    case PixelType::f32:
      std::memcpy(out.bytes.data(), pixels.data.data(), out.bytes.size());
      break;
  }
  return out;
}

}  // namespace stuv
