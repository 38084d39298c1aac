#include "core/light_field.h"

#include <cmath>

#include "core/error.h"
#include "core/image_io.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;

namespace {

LightField example(const std::filesystem::path& folder, int channels = 3) {
  LightField lf;
  lf.folder = folder;
  lf.width = 150;
  lf.height = 100;
  lf.channels = channels;
  lf.rows = 1;
  lf.cols = 2;
  lf.metric = true;
  lf.focal_px = 200.1;
  lf.convergence_px = 3;
  lf.cx0_px = 74.5;
  lf.cy0_px = 49.5;
  lf.d_min = -1;
  lf.d_max = 7;
  lf.views = {{"a", "views/a.tif", ViewRole::input, 0, 0, -0.1, 0.01, 0.001, 74.2, 49.53},
              {"b", "views/b.tif", ViewRole::input, 0, 1, 0.1, 0, 0, 74.8, 49.5},
              {"c", "views/c.tif", ViewRole::truth, 0, 0, 0.0, 0, 0, 74.5, 49.5}};
  return lf;
}

ImageF texture(int width, int height, int channels) {
  ImageF image(width, height, channels);
  for (std::size_t i = 0; i < image.data.size(); ++i)
    image.data[i] = static_cast<float>((i * 7919) % 256) / 255.0F;
  return image;
}

}  // namespace

TEST_CASE("a manifest survives a round trip") {
  const test::TempFolder folder;
  LightField lf = example(folder.path());
  write_manifest(lf);
  const LightField back = open_light_field(folder.path());
  CHECK(back.focal_px == lf.focal_px);
  CHECK(back.metric);
  CHECK(back.d_max == 7);
  CHECK(back.views.size() == 3);
  CHECK(back.views[0].w == 0.001);
  CHECK(back.views[1].col == 1);
  CHECK(back.views_with(ViewRole::truth) == std::vector<int>{2});
  CHECK(back.inverse_depth(back.disparity(0.25)) == Approx(0.25));
  lf.d_min = lf.d_max = std::nan("");
  write_manifest(lf);
  CHECK_FALSE(open_light_field(folder.path()).has_range());
}

TEST_CASE("manifests that renderers could not rely on are refused") {
  const test::TempFolder folder;
  LightField lf = example(folder.path());
  lf.views[1].col = 0;
  CHECK_THROWS_WITH(write_manifest(lf), Contains("shares row"));
  lf = example(folder.path());
  lf.views[1].col = 2;
  CHECK_THROWS_WITH(write_manifest(lf), Contains("outside"));
  lf = example(folder.path());
  lf.focal_px = 0;
  CHECK_THROWS_AS(write_manifest(lf), Error);
  lf = example(folder.path());
  lf.views[0].s = std::nan("");
  CHECK_THROWS_AS(write_manifest(lf), Error);
  lf.views.clear();
  CHECK_THROWS_WITH(write_manifest(lf), Contains("no input view"));
}

TEST_CASE("view pixels come back exactly, whole and in parts") {
  const test::TempFolder folder;
  for (const int channels : {1, 3}) {
    for (const PixelType type : {PixelType::u8, PixelType::u16, PixelType::f16, PixelType::f32}) {
      LightField lf = example(folder.path(), channels);
      lf.type = type;
      const Image image = from_float(texture(150, 100, channels), type);
      const ImageF expected = to_float(image);
      write_view(lf, lf.views[0], image);
      const LightFieldReader reader(lf);
      const ViewPixels whole = reader.read(0);
      CHECK(whole.mask.empty());
      float worst = 0;
      for (std::size_t i = 0; i < expected.data.size(); ++i)
        worst = std::max(worst, std::abs(expected.data[i] - whole.colour.data[i]));
      CHECK(worst < 1e-6F);
      const ViewPixels part = reader.read(0, 0, 60, 30, 50, 70);
      CHECK(part.colour.at(49, 69, channels - 1) == whole.colour.at(109, 99, channels - 1));
    }
  }
}

TEST_CASE("views are tiled, mip-mapped and open in ordinary programs") {
  const test::TempFolder folder;
  const LightField lf = example(folder.path());
  write_view(lf, lf.views[0], from_float(ImageF(150, 100, 3, 0.5F), PixelType::u8));
  const LightFieldReader reader(lf);
  const ViewPixels level1 = reader.read(0, 1, 0, 0, 75, 50);
  CHECK(level1.colour.at(40, 20, 1) == Approx(128.0 / 255).margin(1.0 / 255));
  CHECK(read_image(folder / "views/a.tif").width == 150);
}

TEST_CASE("missing pixels stay missing and leave the others alone") {
  const test::TempFolder folder;
  const LightField lf = example(folder.path());
  Image image = from_float(texture(150, 100, 3), PixelType::u8);
  image.mask = Mask(150, 100, 1, 255);
  for (int y = 0; y < 100; ++y)
    for (int x = 0; x < 20; ++x) image.mask.at(x, y) = 0;
  write_view(lf, lf.views[0], image);
  const LightFieldReader reader(lf);
  const ViewPixels back = reader.read(0);
  REQUIRE_FALSE(back.mask.empty());
  CHECK(back.mask.at(19, 50) == 0);
  CHECK(back.mask.at(20, 50) == 255);
  CHECK(back.colour.at(19, 50, 0) == 0);
  CHECK(back.colour.at(20, 50, 1) == to_float(image).at(20, 50, 1));
}

TEST_CASE("unreadable views are named") {
  const test::TempFolder folder;
  LightField lf = example(folder.path());
  CHECK_THROWS_WITH(LightFieldReader(lf).read(1), Contains("b.tif"));
  const Image image = from_float(texture(150, 100, 3), PixelType::u8);
  const auto expected = to_float(image).data;
  write_view(lf, lf.views[1], image);
  const auto size = std::filesystem::file_size(folder / "views/b.tif");
  int refused = 0;
  for (int tenth = 9; tenth >= 0; --tenth) {
    // Coarser levels lie behind: while the full size is whole, it may be read. Anything else would be a quiet
    // wrong picture.
    std::filesystem::resize_file(folder / "views/b.tif", size * tenth / 10);
    try {
      const ViewPixels back = LightFieldReader(lf).read(1);
      CHECK(back.colour.data == expected);
    } catch (const Error& e) {
      CHECK_THAT(e.what(), Contains("b.tif"));
      ++refused;
    }
  }
  CHECK(refused >= 1);
  CHECK_THROWS_WITH(write_view(lf, lf.views[0], from_float(texture(10, 10, 3), PixelType::u8)),
                    Contains("a.tif"));
}
