#include "core/raw_frame.h"

#include "core/error.h"
#include "core/image_io.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;
using Catch::Matchers::Contains;

namespace {

std::vector<std::byte> bytes_of(const std::vector<int>& values) {
  std::vector<std::byte> bytes;
  for (const int value : values) bytes.push_back(static_cast<std::byte>(value));
  return bytes;
}

std::vector<int> pixels_of(const Image& image) {
  std::vector<int> pixels;
  for (std::size_t i = 0; i < image.bytes.size(); i += bytes_per_sample(image.type))
    pixels.push_back(std::to_integer<int>(image.bytes[i]) |
                     (image.type == PixelType::u16 ? std::to_integer<int>(image.bytes[i + 1]) << 8 : 0));
  return pixels;
}

}  // namespace

TEST_CASE("raw: YUV codes become the colours of BT.601 and BT.709") {
  // Red in limited BT.601: 81, 90, 240 (81.481, 90.203, 240 before rounding).
  CHECK(pixels_of(decode_raw({"YUYV", 2, 1, 4}, bytes_of({81, 90, 81, 240}), "a")) ==
        std::vector<int>{254, 0, 0, 254, 0, 0});
  CHECK(pixels_of(decode_raw({"UYVY", 2, 1, 4}, bytes_of({128, 235, 128, 16}), "a")) ==
        std::vector<int>{255, 255, 255, 0, 0, 0});
  // Red in full-range BT.709: y = 0.2126 x 255, cb = 128 - 255 x 0.2126 / 1.8556, cr = 255 (clipped from
  // 255.5).
  const auto red =
      pixels_of(decode_raw({"YUYV", 2, 1, 4, YuvMatrix::bt709, true}, bytes_of({54, 99, 54, 255}), "a"));
  CHECK(red[0] >= 253);
  CHECK(red[1] <= 1);
  CHECK(red[2] <= 1);
  // NV12: chroma between rows weighs 3 : 1.
  const auto nv12 =
      pixels_of(decode_raw({"NV12", 2, 4, 2, YuvMatrix::bt601, true},
                           bytes_of({100, 100, 100, 100, 100, 100, 100, 100, 128, 128, 128, 168}), "a"));
  CHECK(nv12[0] == 100);
  CHECK(nv12[6] == 114);   // 1.402 x 10
  CHECK(nv12[12] == 142);  // 1.402 x 30
  CHECK(nv12[18] == 156);  // 1.402 x 40
}

TEST_CASE("raw: grey codes of 10 and 12 bit fill 16; padding of rows is skipped") {
  CHECK(pixels_of(decode_raw({"Y10 ", 2, 1, 4}, bytes_of({0xFF, 0x03, 0x00, 0x02}), "a")) ==
        std::vector<int>{65535, 32800});
  CHECK(pixels_of(decode_raw({"Y12 ", 1, 2, 4}, bytes_of({0xFF, 0x0F, 9, 9, 0x00, 0x00}), "a")) ==
        std::vector<int>{65535, 0});
  CHECK(pixels_of(decode_raw({"BGR3", 1, 1, 3, YuvMatrix::bt601, true}, bytes_of({1, 2, 3}), "a")) ==
        std::vector<int>{3, 2, 1});
}

TEST_CASE("raw: Bayer orders say where red is") {
  const std::vector<std::pair<const char*, std::vector<int>>> orders = {{"RGGB", {200, 100, 100, 50}},
                                                                        {"GRBG", {100, 200, 50, 100}},
                                                                        {"GBRG", {100, 50, 200, 100}},
                                                                        {"BA81", {50, 100, 100, 200}}};
  for (const auto& [fourcc, block] : orders) {
    CAPTURE(fourcc);
    std::vector<int> codes;
    for (int y = 0; y < 4; ++y)
      for (int x = 0; x < 6; ++x) codes.push_back(block[static_cast<std::size_t>(x % 2 + 2 * (y % 2))]);
    const auto pixels = pixels_of(decode_raw({fourcc, 6, 4, 6}, bytes_of(codes), "a"));
    for (std::size_t i = 0; i < pixels.size(); i += 3) {
      CHECK(pixels[i] == 200);
      CHECK(pixels[i + 1] == 100);
      CHECK(pixels[i + 2] == 50);
    }
  }
}

TEST_CASE("raw: a file says how it is to be read; what lacks is named") {
  const TempFolder folder;
  const RawFormat format{"Y10 ", 3, 2, 8, YuvMatrix::bt709, true};
  const auto header = raw_header(format);
  CHECK(parse_raw_header({header.data(), header.size()}, "a") == format);
  const std::string name = (folder / "a.raw").string();
  const std::string text(header.data(), header.size());
  write_text(name, text + std::string(14, '\1'));
  CHECK(read_image(name).width == 3);
  CHECK(read_image_info(name).type == PixelType::u16);
  write_text(name, text + std::string(13, '\1'));
  CHECK_THROWS_WITH(read_image(name), Contains("a.raw") && Contains("truncated"));
  write_text(name, "stuv.raw 1 fourcc=RGGB width=999999 height=2 stride=1");
  CHECK_THROWS_WITH(read_image(name), Contains("not known"));
  write_text(name, "P6 3 2");
  CHECK_THROWS_AS(read_image(name), Error);
  for (const char* nonsense :
       {"stuv.raw 1", "stuv.raw 1 width", "stuv.raw 1 = fourcc=", "stuv.raw 1 fourcc=YUYV width=-4"})
    CHECK_THROWS_AS(parse_raw_header(nonsense, "a"), Error);
}
