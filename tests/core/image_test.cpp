#include <cmath>
#include <fstream>
#include <limits>

#include "core/error.h"
#include "core/image_io.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;

namespace {

ImageF ramp(int width, int height, int channels) {
  ImageF image(width, height, channels);
  for (std::size_t i = 0; i < image.data.size(); ++i)
    image.data[i] = static_cast<float>((i * 37) % 256) / 255.0F;
  return image;
}

void truncate_to(const std::filesystem::path& file, double fraction) {
  const auto size = std::filesystem::file_size(file);
  std::filesystem::resize_file(file, static_cast<std::uintmax_t>(fraction * static_cast<double>(size)));
}

}  // namespace

TEST_CASE("pictures survive a round trip in every type that their file can hold") {
  const test::TempFolder folder;
  const struct {
    const char* name;
    PixelType type;
  } cases[] = {{"a.png", PixelType::u8},  {"b.png", PixelType::u16}, {"c.tif", PixelType::u8},
               {"d.tif", PixelType::f32}, {"e.exr", PixelType::f16}, {"f.exr", PixelType::f32}};
  for (const auto& c : cases) {
    for (const int channels : {1, 3}) {
      INFO(c.name << ", " << channels << " channels");
      const Image image = from_float(ramp(31, 17, channels), c.type);
      write_image(folder / c.name, image);
      const Image back = read_image(folder / c.name);
      CHECK(back.type == c.type);
      CHECK(back.channels == channels);
      CHECK(back.bytes == image.bytes);
      CHECK(back.mask.empty());
      const ImageInfo info = read_image_info(folder / c.name);
      CHECK(info.width == 31);
      CHECK(info.height == 17);
    }
  }
}

TEST_CASE("a mask becomes alpha and comes back without touching the colours") {
  const test::TempFolder folder;
  for (const char* name : {"a.png", "a.tif"}) {
    for (const int channels : {1, 3}) {
      Image image = from_float(ramp(16, 8, channels), PixelType::u8);
      image.mask = Mask(16, 8, 1, 255);
      image.mask.at(3, 2) = 0;
      write_image(folder / name, image);
      const Image back = read_image(folder / name);
      CHECK(back.channels == channels);
      CHECK(back.mask.data == image.mask.data);
      CHECK(back.bytes == image.bytes);
    }
  }
}

TEST_CASE("conversion clamps, rounds and has an answer for NaN") {
  ImageF image(5, 1, 1);
  image.data = {-1.0F, 0.5F, 2.0F, std::nanf(""), std::numeric_limits<float>::infinity()};
  const Image stored = from_float(image, PixelType::u8);
  CHECK(std::to_integer<int>(stored.bytes[0]) == 0);
  CHECK(std::to_integer<int>(stored.bytes[1]) == 128);
  CHECK(std::to_integer<int>(stored.bytes[2]) == 255);
  CHECK(std::to_integer<int>(stored.bytes[3]) == 0);
  CHECK(std::to_integer<int>(stored.bytes[4]) == 255);
}

TEST_CASE("damaged pictures are named") {
  const test::TempFolder folder;
  CHECK_THROWS_WITH(read_image(folder / "none.png"), Contains("none.png") && Contains("does not exist"));
  std::ofstream(folder / "text.png") << "no picture";
  CHECK_THROWS_WITH(read_image(folder / "text.png"), Contains("text.png"));
  for (const char* name : {"a.png", "a.jpg", "a.tif", "a.exr"}) {
    INFO(name);
    write_image(folder / name,
                from_float(ramp(200, 150, 3), std::string(name) == "a.exr" ? PixelType::f16 : PixelType::u8));
    CHECK_NOTHROW(read_image(folder / name));
    truncate_to(folder / name, 0.6);
    CHECK_THROWS_WITH(read_image(folder / name), Contains(name));
  }
}

TEST_CASE("a picture is not written to where it cannot be") {
  const test::TempFolder folder;
  const Image image = from_float(ramp(4, 4, 1), PixelType::u8);
  CHECK_THROWS_WITH(write_image(folder / "nowhere/a.png", image), Contains("nowhere"));
  CHECK_THROWS_WITH(write_image(folder / "a.unknown", image), Contains("a.unknown"));
  CHECK(std::filesystem::is_empty(folder.path()));
}

TEST_CASE("PFM keeps values, order and what is not finite") {
  const test::TempFolder folder;
  for (const int channels : {1, 3}) {
    ImageF image = ramp(7, 5, channels);
    image.at(0, 0) = std::numeric_limits<float>::infinity();
    write_pfm(folder / "a.pfm", image);
    CHECK(read_pfm(folder / "a.pfm").data == image.data);
  }
  // OpenImageIO reads PFM: an independent check of the row order.
  write_pfm(folder / "b.pfm", ramp(7, 5, 1));
  CHECK(to_float(read_image(folder / "b.pfm")).data == ramp(7, 5, 1).data);
  truncate_to(folder / "a.pfm", 0.9);
  CHECK_THROWS_WITH(read_pfm(folder / "a.pfm"), Contains("truncated"));
  write_text(folder / "c.pfm", "PF\n-3 4\n-1.0\n");
  CHECK_THROWS_AS(read_pfm(folder / "c.pfm"), Error);
}

TEST_CASE("a flipped byte in a PNG is found before libpng prints about it") {
  const test::TempFolder folder;
  write_image(folder / "a.png", from_float(ramp(200, 150, 3), PixelType::u8));
  std::string bytes = read_text(folder / "a.png");
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 0x55);
  write_text(folder / "a.png", bytes);
  CHECK_THROWS_WITH(read_image(folder / "a.png"), Contains("a.png") && Contains("damaged"));
  CHECK_THROWS_AS(read_image_info(folder / "a.png"), Error);
}
