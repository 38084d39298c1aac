#include "core/raw_frame.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <map>
#include <sstream>

#include "core/error.h"

namespace stuv {
namespace {

enum class Layout { yuyv, uyvy, nv12, rgb, bgr, grey, bayer };

struct FormatInfo {
  const char* fourcc;
  Layout layout;
  int bits;
  int red = 0;  ///< Bayer: where the red pixel of a 2x2 block is, x + 2 y; blue is diagonally opposite
};

constexpr FormatInfo kFormats[] = {
    {"YUYV", Layout::yuyv, 8},      {"UYVY", Layout::uyvy, 8},      {"NV12", Layout::nv12, 8},
    {"RGB3", Layout::rgb, 8},       {"BGR3", Layout::bgr, 8},       {"GREY", Layout::grey, 8},
    {"Y10 ", Layout::grey, 10},     {"Y12 ", Layout::grey, 12},     {"Y16 ", Layout::grey, 16},
    {"BA81", Layout::bayer, 8, 3},  {"GBRG", Layout::bayer, 8, 2},  {"GRBG", Layout::bayer, 8, 1},
    {"RGGB", Layout::bayer, 8, 0},  {"BG10", Layout::bayer, 10, 3}, {"GB10", Layout::bayer, 10, 2},
    {"BA10", Layout::bayer, 10, 1}, {"RG10", Layout::bayer, 10, 0}, {"BG12", Layout::bayer, 12, 3},
    {"GB12", Layout::bayer, 12, 2}, {"BA12", Layout::bayer, 12, 1}, {"RG12", Layout::bayer, 12, 0},
    {"BG14", Layout::bayer, 14, 3}, {"GB14", Layout::bayer, 14, 2}, {"GR14", Layout::bayer, 14, 1},
    {"RG14", Layout::bayer, 14, 0}, {"BYR2", Layout::bayer, 16, 3}, {"GB16", Layout::bayer, 16, 2},
    {"GR16", Layout::bayer, 16, 1}, {"RG16", Layout::bayer, 16, 0},
};

const FormatInfo* find_format(std::string_view fourcc) {
  const auto* found = std::find_if(std::begin(kFormats), std::end(kFormats),
                                   [&](const FormatInfo& info) { return fourcc == info.fourcc; });
  return found == std::end(kFormats) ? nullptr : found;
}

constexpr int kMostPixels = 1 << 16;  ///< a side, so that a damaged header asks for no absurd memory

/// Code values of one colour channel to R'G'B' of 8 bit.
struct YuvToRgb {
  double y_offset, y_scale, c_scale, red_from_cr, blue_from_cb, kr, kb;

  explicit YuvToRgb(const RawFormat& format)
      : y_offset(format.full_range ? 0 : 16),
        y_scale(format.full_range ? 1.0 : 255.0 / 219),
        c_scale(format.full_range ? 1.0 : 255.0 / 224) {
    constexpr double coefficients[3][2] = {{0.299, 0.114}, {0.2126, 0.0722}, {0.2627, 0.0593}};
    kr = coefficients[static_cast<int>(format.matrix)][0];
    kb = coefficients[static_cast<int>(format.matrix)][1];
    red_from_cr = 2 * (1 - kr) * c_scale;
    blue_from_cb = 2 * (1 - kb) * c_scale;
  }

  static std::byte to_byte(double value) {
    return static_cast<std::byte>(std::clamp(static_cast<int>(value + 0.5), 0, 255));
  }
  void convert(double y, double cb, double cr, std::byte* rgb) const {
    const double luma = (y - y_offset) * y_scale;
    const double red = luma + red_from_cr * (cr - 128), blue = luma + blue_from_cb * (cb - 128);
    rgb[0] = to_byte(red);
    rgb[1] = to_byte((luma - kr * red - kb * blue) / (1 - kr - kb));
    rgb[2] = to_byte(blue);
  }
};

/// One row of samples: `luma` with a step of 1 or 2 bytes; `chroma` of (width + 1) / 2 pairs (cb, cr).
void convert_row(const YuvToRgb& to_rgb, const std::uint8_t* luma, int step,
                 const std::vector<std::array<double, 2>>& chroma, int width, std::byte* out) {
  for (int x = 0; x < width; ++x) {
    const auto& left = chroma[static_cast<std::size_t>(x / 2)];
    const auto& right = chroma[std::min(static_cast<std::size_t>((x + 1) / 2), chroma.size() - 1)];
    to_rgb.convert(luma[x * step], (left[0] + right[0]) / 2, (left[1] + right[1]) / 2, out + 3 * x);
  }
}

Image rgb_image(const RawFormat& format, PixelType type) {
  Image image{format.width, format.height, 3, type, {}, {}};
  image.bytes.resize(static_cast<std::size_t>(format.width) * format.height * 3 * bytes_per_sample(type));
  return image;
}

Image decode_packed_yuv(const RawFormat& format, const std::uint8_t* bytes, bool luma_first) {
  Image image = rgb_image(format, PixelType::u8);
  const YuvToRgb to_rgb(format);
  std::vector<std::array<double, 2>> chroma(static_cast<std::size_t>(format.width + 1) / 2);
  for (int y = 0; y < format.height; ++y) {
    const std::uint8_t* row = bytes + static_cast<std::size_t>(y) * format.stride;
    const std::uint8_t* first_chroma = row + (luma_first ? 1 : 0);
    for (std::size_t i = 0; i < chroma.size(); ++i)
      chroma[i] = {static_cast<double>(first_chroma[4 * i]), static_cast<double>(first_chroma[4 * i + 2])};
    convert_row(to_rgb, row + (luma_first ? 0 : 1), 2, chroma, format.width,
                &image.bytes[static_cast<std::size_t>(y) * format.width * 3]);
  }
  return image;
}

Image decode_nv12(const RawFormat& format, const std::uint8_t* bytes) {
  Image image = rgb_image(format, PixelType::u8);
  const YuvToRgb to_rgb(format);
  const int chroma_rows = (format.height + 1) / 2;
  const std::uint8_t* plane = bytes + static_cast<std::size_t>(format.height) * format.stride;
  std::vector<std::array<double, 2>> chroma(static_cast<std::size_t>(format.width + 1) / 2);
  for (int y = 0; y < format.height; ++y) {
    const int near = y / 2, far = std::clamp(y % 2 == 0 ? near - 1 : near + 1, 0, chroma_rows - 1);
    const std::uint8_t* a = plane + static_cast<std::size_t>(near) * format.stride;
    const std::uint8_t* b = plane + static_cast<std::size_t>(far) * format.stride;
    for (std::size_t i = 0; i < chroma.size(); ++i)
      chroma[i] = {0.75 * a[2 * i] + 0.25 * b[2 * i], 0.75 * a[2 * i + 1] + 0.25 * b[2 * i + 1]};
    convert_row(to_rgb, bytes + static_cast<std::size_t>(y) * format.stride, 1, chroma, format.width,
                &image.bytes[static_cast<std::size_t>(y) * format.width * 3]);
  }
  return image;
}

Image decode_rgb(const RawFormat& format, const std::uint8_t* bytes, bool blue_first) {
  Image image = rgb_image(format, PixelType::u8);
  const std::size_t row_bytes = static_cast<std::size_t>(format.width) * 3;
  for (int y = 0; y < format.height; ++y) {
    const std::uint8_t* row = bytes + static_cast<std::size_t>(y) * format.stride;
    std::byte* out = &image.bytes[static_cast<std::size_t>(y) * row_bytes];
    for (std::size_t i = 0; i < row_bytes; ++i) {
      const std::uint8_t code = row[blue_first ? i + 2 - 2 * (i % 3) : i];
      out[i] =
          format.full_range ? static_cast<std::byte>(code) : YuvToRgb::to_byte((code - 16) * 255.0 / 219);
    }
  }
  return image;
}

/// Reads codes of one channel, row by row.
template <class T>
class Codes {
 public:
  Codes(const RawFormat& format, const std::uint8_t* bytes) : bytes_(bytes), stride_(format.stride) {}
  T at(int x, int y) const {
    T value;  // memcpy: a device's rows need not be aligned
    std::memcpy(&value,
                bytes_ + static_cast<std::size_t>(y) * stride_ + static_cast<std::size_t>(x) * sizeof(T),
                sizeof(T));
    return value;
  }

 private:
  const std::uint8_t* bytes_;
  std::size_t stride_;
};

/// The largest code of `bits` as the largest value of T.
template <class T>
T to_full_scale(double code, int bits) {
  const double largest = (1 << bits) - 1,
               scale = static_cast<double>(std::numeric_limits<T>::max()) / largest;
  return static_cast<T>(std::min(code, largest) * scale + 0.5);
}

template <class T>
Image decode_grey(const RawFormat& format, int bits, const std::uint8_t* bytes) {
  Image image{format.width, format.height, 1, sizeof(T) == 1 ? PixelType::u8 : PixelType::u16, {}, {}};
  image.bytes.resize(static_cast<std::size_t>(format.width) * format.height * sizeof(T));
  const Codes<T> codes(format, bytes);
  std::byte* out = image.bytes.data();
  for (int y = 0; y < format.height; ++y)
    for (int x = 0; x < format.width; ++x, out += sizeof(T)) {
      const T value = to_full_scale<T>(codes.at(x, y), bits);
      std::memcpy(out, &value, sizeof(T));
    }
  return image;
}

template <class T>
Image decode_bayer(const RawFormat& format, const FormatInfo& info, const std::uint8_t* bytes) {
  Image image = rgb_image(format, sizeof(T) == 1 ? PixelType::u8 : PixelType::u16);
  const Codes<T> codes(format, bytes);
  const auto channel_at = [&](int x, int y) {
    const int place = (x & 1) + 2 * (y & 1);
    return place == info.red ? 0 : place == 3 - info.red ? 2 : 1;
  };
  std::byte* out = image.bytes.data();
  for (int y = 0; y < format.height; ++y)
    for (int x = 0; x < format.width; ++x) {
      double sum[3] = {0, 0, 0}, count[3] = {0, 0, 0};
      for (int j = std::max(y - 1, 0); j <= std::min(y + 1, format.height - 1); ++j)
        for (int i = std::max(x - 1, 0); i <= std::min(x + 1, format.width - 1); ++i) {
          const int c = channel_at(i, j);
          sum[c] += codes.at(i, j);
          ++count[c];
        }
      const int own = channel_at(x, y);
      sum[own] = codes.at(x, y);
      count[own] = 1;
      for (int c = 0; c < 3; ++c, out += sizeof(T)) {
        const T value = to_full_scale<T>(count[c] > 0 ? sum[c] / count[c] : 0, info.bits);
        std::memcpy(out, &value, sizeof(T));
      }
    }
  return image;
}

const char* name_of(YuvMatrix matrix) {
  return matrix == YuvMatrix::bt601 ? "bt601" : matrix == YuvMatrix::bt709 ? "bt709" : "bt2020";
}

/// Blanks would part the words of the header.
std::string with_blanks_as(std::string text, char from, char to) {
  std::replace(text.begin(), text.end(), from, to);
  return text;
}

}  // namespace

bool is_raw_fourcc(std::string_view fourcc) { return find_format(fourcc) != nullptr; }

int least_stride(std::string_view fourcc, int width) {
  const FormatInfo* info = find_format(fourcc);
  if (info == nullptr) return 0;
  switch (info->layout) {
    case Layout::yuyv:
    case Layout::uyvy:
      return (width + 1) / 2 * 4;
    case Layout::nv12:
      return (width + 1) / 2 * 2;
    case Layout::rgb:
    case Layout::bgr:
      return 3 * width;
    case Layout::grey:
    case Layout::bayer:
      break;
  }
  return info->bits > 8 ? 2 * width : width;
}

std::size_t raw_size(const RawFormat& format) {
  const FormatInfo* info = find_format(format.fourcc);
  if (info == nullptr || format.width < 1 || format.height < 1 || format.width > kMostPixels ||
      format.height > kMostPixels || format.stride < least_stride(format.fourcc, format.width) ||
      format.stride > 16 * kMostPixels)
    return 0;
  const int rows = info->layout == Layout::nv12 ? format.height + (format.height + 1) / 2 : format.height;
  // The last row need not be padded.
  return static_cast<std::size_t>(rows - 1) * format.stride + least_stride(format.fourcc, format.width);
}

Image decode_raw(const RawFormat& format, std::span<const std::byte> bytes, const std::string& file) {
  const std::size_t size = raw_size(format);
  if (size == 0)
    throw Error(file,
                fmt::format("has a frame of {} {}x{} with rows of {} bytes, which cannot be read",
                            format.fourcc, format.width, format.height, format.stride),
                "replace it");
  if (bytes.size() < size)
    throw Error(file, fmt::format("is truncated: {} of {} bytes are there", bytes.size(), size),
                "replace it");
  const FormatInfo& info = *find_format(format.fourcc);
  const auto* data = reinterpret_cast<const std::uint8_t*>(bytes.data());
  switch (info.layout) {
    case Layout::yuyv:
      return decode_packed_yuv(format, data, true);
    case Layout::uyvy:
      return decode_packed_yuv(format, data, false);
    case Layout::nv12:
      return decode_nv12(format, data);
    case Layout::rgb:
      return decode_rgb(format, data, false);
    case Layout::bgr:
      return decode_rgb(format, data, true);
    case Layout::grey:
      return info.bits > 8 ? decode_grey<std::uint16_t>(format, info.bits, data)
                           : decode_grey<std::uint8_t>(format, info.bits, data);
    case Layout::bayer:
      break;
  }
  return info.bits > 8 ? decode_bayer<std::uint16_t>(format, info, data)
                       : decode_bayer<std::uint8_t>(format, info, data);
}

std::array<char, kRawHeaderBytes> raw_header(const RawFormat& format) {
  std::array<char, kRawHeaderBytes> header;
  header.fill(' ');
  header.back() = '\n';
  fmt::format_to_n(header.data(), header.size() - 1,
                   "stuv.raw 1 fourcc={} width={} height={} stride={} matrix={} range={}",
                   with_blanks_as(format.fourcc, ' ', '_'), format.width, format.height, format.stride,
                   name_of(format.matrix), format.full_range ? "full" : "limited");
  return header;
}

RawFormat parse_raw_header(std::string_view text, const std::string& file) {
  std::istringstream in{std::string(text.substr(0, kRawHeaderBytes))};
  std::string magic, version, word;
  in >> magic >> version;
  if (magic != "stuv.raw" || version != "1") throw Error(file, "is no raw frame of stuv", "replace it");
  std::map<std::string, std::string> values;
  while (in >> word) {
    const std::size_t equals = std::min(word.find('='), word.size() - 1);
    values[word.substr(0, equals)] = word.substr(equals + 1);
  }
  const auto number = [&](const char* key) { return std::atoi(values[key].c_str()); };
  RawFormat format{with_blanks_as(values["fourcc"], '_', ' '), number("width"), number("height"),
                   number("stride")};
  for (const YuvMatrix matrix : {YuvMatrix::bt601, YuvMatrix::bt709, YuvMatrix::bt2020})
    if (values["matrix"] == name_of(matrix)) format.matrix = matrix;
  format.full_range = values["range"] == "full";
  if (raw_size(format) == 0) throw Error(file, "is a raw frame of a format that is not known", "replace it");
  return format;
}

}  // namespace stuv
