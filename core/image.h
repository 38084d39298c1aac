#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "core/raster.h"

namespace stuv {

enum class PixelType { u8, u16, f16, f32 };

std::size_t bytes_per_sample(PixelType type);
const char* name_of(PixelType type);
PixelType pixel_type_from_name(const std::string& name);

/// One picture as it is stored: 1 or 3 channels, interleaved, and a mask where pixels are missing.
struct Image {
  int width = 0, height = 0, channels = 1;
  PixelType type = PixelType::u8;
  std::vector<std::byte> bytes;
  Mask mask;
};

/// Stored values as float: integers scaled to 0..1, half and float as they are.
ImageF to_float(const Image& image);

/// The inverse of to_float. Integers are clamped to 0..1 and rounded to nearest; NaN becomes 0.
Image from_float(const ImageF& pixels, PixelType type);

}  // namespace stuv
