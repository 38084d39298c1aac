#pragma once

#include <filesystem>
#include <span>
#include <string>

#include "core/image.h"

namespace stuv {

struct ImageInfo {
  int width = 0, height = 0, channels = 0;
  PixelType type = PixelType::u8;
};

/// Reads the header only.
ImageInfo read_image_info(const std::filesystem::path& file);

/// Reads a whole picture through OpenImageIO, or a camera's raw frame (core/raw_frame.h). An alpha channel
/// becomes the mask (alpha >= half: there); two channels are grey and alpha. Throws Error on a missing,
/// unreadable or truncated file.
Image read_image(const std::filesystem::path& file);

/// A JPEG picture in memory; `name` stands for it in errors. Without Huffman tables (as cameras send them) it
/// has the standard's.
Image decode_jpeg(std::span<const std::byte> bytes, const std::string& name);

/// Writes by the file's extension (png, tif, exr, jpg, ...), whole or not at all. A mask becomes alpha.
void write_image(const std::filesystem::path& file, const Image& image);

/// PFM (which OpenImageIO cannot write): 1 or 3 channels, little endian, bottom row first.
/// Non-finite values are kept: a reader may meet Inf (infinitely far) and NaN (not determined).
void write_pfm(const std::filesystem::path& file, const ImageF& image);
ImageF read_pfm(const std::filesystem::path& file);

}  // namespace stuv
