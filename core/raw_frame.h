#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <string>
#include <string_view>

#include "core/image.h"

namespace stuv {

/// How Y'CbCr code values relate to R'G'B'.
enum class YuvMatrix { bt601, bt709, bt2020 };

/// How the bytes of an uncompressed frame are to be read.
struct RawFormat {
  /// V4L2's four characters: YUYV, UYVY, NV12, RGB3 (RGB24), BGR3, GREY, "Y10 ", "Y12 ", "Y16 ", and Bayer in
  /// its first row's order: BA81 GBRG GRBG RGGB (8 bit), BG10 GB10 BA10 RG10, BG12 GB12 BA12 RG12, BG14 GB14
  /// GR14 RG14, BYR2 GB16 GR16 RG16. More than 8 bit lie in 16, little endian, in the low bits.
  std::string fourcc;
  int width = 0, height = 0;
  int stride = 0;  ///< bytes from one row to the next (of the first plane)
  YuvMatrix matrix = YuvMatrix::bt601;
  bool full_range = false;  ///< code values 0..255 instead of 16..235 (chroma 16..240); YUV and RGB only

  bool operator==(const RawFormat&) const = default;
};

/// Whether decode_raw knows the four characters.
bool is_raw_fourcc(std::string_view fourcc);
/// Bytes that a frame takes; 0 if the format is unknown or its numbers make no sense.
std::size_t raw_size(const RawFormat& format);
/// Bytes of a row without padding.
int least_stride(std::string_view fourcc, int width);

/// Pixels of a raw frame: Bayer, RGB and YUV become RGB, the grey formats one channel; 8-bit codes become u8,
/// longer ones u16 with the largest code as 65535.
///
///   R' = Y + 2 (1 - kr) Cr,  B' = Y + 2 (1 - kb) Cb,  G' = (Y - kr R' - kb B') / (1 - kr - kb)
///
/// with Y = (y - 16) / 219, C = (c - 128) / 224, in full range y / 255 and (c - 128) / 255; rounded to
/// nearest, clamped. (kr, kb) = (0.299, 0.114), (0.2126, 0.0722), (0.2627, 0.0593). Source: ITU-R BT.601-7,
/// BT.709-6, BT.2020-2. Chroma lies on even columns and, in NV12, between rows; in between it is interpolated
/// linearly. Bayer: each missing colour is the mean of its neighbours among the 3x3 around. Throws Error
/// naming `file` if bytes lack.
Image decode_raw(const RawFormat& format, std::span<const std::byte> bytes, const std::string& file);

// A .raw file is 128 bytes of text, padded with blanks and a line end, and then the frame as the camera
// delivered it:
//
//   stuv.raw 1 fourcc=YUYV width=640 height=360 stride=1280 matrix=bt601 range=limited
inline constexpr std::size_t kRawHeaderBytes = 128;
std::array<char, kRawHeaderBytes> raw_header(const RawFormat& format);
/// Throws Error naming `file` if this is no such header.
RawFormat parse_raw_header(std::string_view text, const std::string& file);

}  // namespace stuv
