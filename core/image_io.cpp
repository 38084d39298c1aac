#include "core/image_io.h"

#include <OpenImageIO/filesystem.h>
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cstring>
#include <fstream>
#include <sstream>

#include "core/error.h"
#include "core/files.h"
#include "core/raw_frame.h"

namespace stuv {
namespace {

static_assert(std::endian::native == std::endian::little,
              "PFM is written little endian as it lies in memory");

PixelType from_oiio(const OIIO::TypeDesc& type) {
  switch (type.basetype) {
    case OIIO::TypeDesc::UINT8:
    case OIIO::TypeDesc::INT8:
      return PixelType::u8;
    case OIIO::TypeDesc::UINT16:
    case OIIO::TypeDesc::INT16:
    case OIIO::TypeDesc::UINT32:
      return PixelType::u16;
    case OIIO::TypeDesc::HALF:
      return PixelType::f16;
    default:
      return PixelType::f32;
  }
}

OIIO::TypeDesc to_oiio(PixelType type) {
  switch (type) {
    case PixelType::u8:
      return OIIO::TypeUInt8;
    case PixelType::u16:
      return OIIO::TypeUInt16;
    case PixelType::f16:
      return OIIO::TypeHalf;
    case PixelType::f32:
      break;
  }
  return OIIO::TypeFloat;
}

/// Walks a PNG's chunks: length, type, data, CRC-32 of type and data. Ends with IEND, or it is damaged.
bool png_is_whole(std::string_view bytes) {
  const auto number = [&](std::size_t at) {
    std::uint32_t value = 0;
    for (std::size_t i = at; i < at + 4; ++i) value = value << 8 | static_cast<unsigned char>(bytes[i]);
    return value;
  };
  constexpr std::size_t kFrame = 12;
  for (std::size_t at = 8; bytes.size() >= kFrame && at <= bytes.size() - kFrame;) {
    const std::size_t length = number(at);
    if (length > bytes.size() - kFrame - at) return false;
    const auto* type = reinterpret_cast<const Bytef*>(bytes.data() + at + 4);
    if (crc32(0, type, static_cast<uInt>(length + 4)) != number(at + 8 + length)) return false;
    if (bytes.substr(at + 4, 4) == "IEND") return true;
    at += length + kFrame;
  }
  return false;
}

/// In a JPEG the end marker must stand behind the last scan: a thumbnail has an end marker of its own.
bool jpeg_is_whole(std::string_view bytes) {
  const std::size_t scan = bytes.rfind("\xFF\xDA"), end = bytes.rfind("\xFF\xD9");
  return scan != std::string_view::npos && end != std::string_view::npos && end > scan;
}

/// libjpeg fills what a truncated file lacks with grey and only warns, and libpng prints to stderr: so look
/// before either sees the file.
bool is_damaged(const std::filesystem::path& file) {
  std::array<char, 4> magic{};
  std::ifstream(file, std::ios::binary).read(magic.data(), magic.size());
  const std::string_view begin(magic.data(), magic.size());
  if (begin == "\x89PNG") return !png_is_whole(read_text(file));
  if (begin.substr(0, 3) == "\xFF\xD8\xFF") return !jpeg_is_whole(read_text(file));
  return false;
}

std::unique_ptr<OIIO::ImageInput> open_input(const std::filesystem::path& file) {
  std::error_code ec;
  if (!std::filesystem::exists(file, ec)) throw Error(file.string(), "does not exist", "check the path");
  if (is_damaged(file)) throw Error(file.string(), "is damaged or truncated", "replace it");
  OIIO::ImageSpec config;
  config["oiio:UnassociatedAlpha"] = 1;  // a mask must not darken the colours
  auto input = OIIO::ImageInput::open(file.string(), &config);
  if (!input)
    throw Error(file.string(), fmt::format("is no picture OpenImageIO can open ({})", OIIO::geterror()),
                "replace or convert it");
  return input;
}

bool is_raw(const std::filesystem::path& file) { return file.extension() == ".raw"; }

/// A frame as the camera delivered it; only here it becomes pixels.
Image read_raw(const std::filesystem::path& file) {
  const std::string text = read_text(file);
  const RawFormat format = parse_raw_header(text, file.string());
  const std::size_t begin = std::min(kRawHeaderBytes, text.size());
  return decode_raw(format, std::as_bytes(std::span(text)).subspan(begin), file.string());
}

/// 1 grey, 2 grey and alpha, 3 colour, 4 and more colour and alpha.
int colour_channels(const OIIO::ImageSpec& spec) { return spec.nchannels >= 3 ? 3 : 1; }

/// Takes `channels` of every pixel's `stride` samples, beginning with sample `first`.
std::vector<std::byte> pick(const std::vector<std::byte>& bytes, std::size_t sample, int stride, int first,
                            int channels) {
  const std::size_t pixels = bytes.size() / (sample * stride);
  std::vector<std::byte> out(pixels * sample * channels);
  for (std::size_t i = 0; i < pixels; ++i)
    std::memcpy(&out[i * sample * channels], &bytes[(i * stride + first) * sample], sample * channels);
  return out;
}

Mask mask_from_alpha(const Image& alpha) {
  const ImageF values = to_float(alpha);
  Mask mask(alpha.width, alpha.height, 1);
  for (std::size_t i = 0; i < mask.data.size(); ++i) mask.data[i] = values.data[i] >= 0.5F ? 255 : 0;
  if (std::find(mask.data.begin(), mask.data.end(), 0) == mask.data.end()) return {};
  return mask;
}

/// Appends the mask as an alpha channel of the image's own type.
std::vector<std::byte> with_alpha(const Image& image) {
  ImageF alpha(image.width, image.height, 1);
  for (std::size_t i = 0; i < alpha.data.size(); ++i) alpha.data[i] = image.mask.data[i] != 0 ? 1.0F : 0.0F;
  const Image stored = from_float(alpha, image.type);
  const std::size_t sample = bytes_per_sample(image.type), colour = sample * image.channels;
  std::vector<std::byte> out(image.bytes.size() + stored.bytes.size());
  for (std::size_t i = 0; i < alpha.data.size(); ++i) {
    std::memcpy(&out[i * (colour + sample)], &image.bytes[i * colour], colour);
    std::memcpy(&out[i * (colour + sample) + colour], &stored.bytes[i * sample], sample);
  }
  return out;
}

Image read_all(OIIO::ImageInput& input, const std::string& name) {
  const OIIO::ImageSpec& spec = input.spec();
  if (spec.width <= 0 || spec.height <= 0) throw Error(name, "has no pixels", "replace it");
  Image image;
  image.width = spec.width;
  image.height = spec.height;
  image.channels = colour_channels(spec);
  image.type = from_oiio(spec.format);
  const std::size_t sample = bytes_per_sample(image.type);
  std::vector<std::byte> all(static_cast<std::size_t>(spec.width) * spec.height * spec.nchannels * sample);
  if (!input.read_image(0, 0, 0, spec.nchannels, to_oiio(image.type), all.data()))
    throw Error(name, fmt::format("is damaged or truncated ({})", input.geterror()), "replace it");
  if (spec.nchannels == image.channels) {
    image.bytes = std::move(all);
    return image;
  }
  const Image alpha{
      image.width, image.height, 1, image.type, pick(all, sample, spec.nchannels, image.channels, 1), {}};
  image.mask = mask_from_alpha(alpha);
  image.bytes = pick(all, sample, spec.nchannels, 0, image.channels);
  return image;
}

}  // namespace

ImageInfo read_image_info(const std::filesystem::path& file) {
  if (is_raw(file)) {
    const Image image = read_raw(file);
    return {image.width, image.height, image.channels, image.type};
  }
  const auto input = open_input(file);
  const OIIO::ImageSpec& spec = input->spec();
  return {spec.width, spec.height, colour_channels(spec), from_oiio(spec.format)};
}

Image read_image(const std::filesystem::path& file) {
  if (is_raw(file)) return read_raw(file);
  return read_all(*open_input(file), file.string());
}

Image decode_jpeg(std::span<const std::byte> bytes, const std::string& name) {
  OIIO::Filesystem::IOMemReader memory(bytes.data(), bytes.size());
  auto input = OIIO::ImageInput::create("jpeg");
  OIIO::ImageSpec spec, config;
  void* proxy = &memory;
  config.attribute("oiio:ioproxy", OIIO::TypeDesc::PTR, &proxy);
  if (!input || !input->open("frame.jpg", spec, config))
    throw Error(name, "is no JPEG picture", "check the camera");
  return read_all(*input, name);
}

void write_image(const std::filesystem::path& file, const Image& image) {
  AtomicOutput output(file, AtomicOutput::Kind::file, true);
  auto out = OIIO::ImageOutput::create(output.path().string());
  if (!out)
    throw Error(file.string(), fmt::format("is of no kind OpenImageIO can write ({})", OIIO::geterror()),
                "use .png, .tif or .exr");
  const bool masked = !image.mask.empty();
  OIIO::ImageSpec spec(image.width, image.height, image.channels + (masked ? 1 : 0), to_oiio(image.type));
  if (masked) {
    spec.alpha_channel = image.channels;
    spec.channelnames.back() = "A";
    spec["oiio:UnassociatedAlpha"] = 1;
  }
  spec["png:compressionLevel"] = 4;
  const std::vector<std::byte> joined = masked ? with_alpha(image) : std::vector<std::byte>{};
  const bool written = out->open(output.path().string(), spec) &&
                       out->write_image(to_oiio(image.type), masked ? joined.data() : image.bytes.data()) &&
                       out->close();
  if (!written)
    throw Error(file.string(), fmt::format("cannot be written ({})", out->geterror()),
                "check the folder and the free space");
  output.commit();
}

void write_pfm(const std::filesystem::path& file, const ImageF& image) {
  std::string text =
      fmt::format("{}\n{} {}\n-1.0\n", image.channels == 3 ? "PF" : "Pf", image.width, image.height);
  const std::size_t row_bytes = static_cast<std::size_t>(image.width) * image.channels * sizeof(float);
  for (int y = image.height - 1; y >= 0; --y)
    text.append(reinterpret_cast<const char*>(image.row(y)), row_bytes);
  write_text(file, text);
}

ImageF read_pfm(const std::filesystem::path& file) {
  const std::string text = read_text(file);
  std::istringstream in(text);
  std::string kind;
  int width = 0, height = 0;
  double scale = 0;
  in >> kind >> width >> height >> scale;
  if (!in || (kind != "PF" && kind != "Pf") || width <= 0 || height <= 0 || scale == 0)
    throw Error(file.string(), "is no PFM picture", "replace it");
  if (scale > 0) throw Error(file.string(), "is a big-endian PFM", "convert it to little endian");
  const auto begin = static_cast<std::size_t>(in.tellg()) + 1;
  const int channels = kind == "PF" ? 3 : 1;
  const std::size_t row_bytes = static_cast<std::size_t>(width) * channels * sizeof(float);
  if (begin > text.size() || (text.size() - begin) / row_bytes < static_cast<std::size_t>(height))
    throw Error(file.string(), "is truncated", "replace it");
  ImageF image(width, height, channels);
  for (int y = 0; y < height; ++y)
    std::memcpy(image.row(height - 1 - y), text.data() + begin + static_cast<std::size_t>(y) * row_bytes,
                row_bytes);
  return image;
}

}  // namespace stuv
