#include "render/gl/gl_renderer.h"

#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

namespace {

/// Part of the pixels that differ by more than 1/255 in any channel or in coverage.
double differing(const FocalPlaneView& a, const FocalPlaneView& b) {
  const int channels = a.colour.channels;
  REQUIRE(b.colour.channels == channels);
  REQUIRE(b.colour.data.size() == a.colour.data.size());
  std::size_t count = 0;
  for (std::size_t i = 0; i < a.coverage.data.size(); ++i) {
    bool differs = std::abs(a.coverage.data[i] - b.coverage.data[i]) > 1.0F / 255;
    for (std::size_t c = i * channels; c < (i + 1) * channels; ++c)
      differs = differs || std::abs(a.colour.data[c] - b.colour.data[c]) > 1.0F / 255;
    count += differs ? 1 : 0;
  }
  return static_cast<double>(count) / static_cast<double>(a.coverage.data.size());
}

/// Three different channels; values that the type can hold.
void colour_in(ViewSet& set, PixelType type) {
  set.lf.type = type;
  set.lf.channels = 3;
  for (ViewPixels& pixels : set.pixels) {
    ImageF rgb(pixels.colour.width, pixels.colour.height, 3);
    for (std::size_t i = 0; i < pixels.colour.data.size(); ++i) {
      const float grey = pixels.colour.data[i];
      rgb.data[i * 3] = grey;
      rgb.data[i * 3 + 1] = 1 - grey;
      rgb.data[i * 3 + 2] = grey * grey;
    }
    pixels.colour = to_float(from_float(rgb, type));
  }
}

void mask_some(ViewSet& set) {
  for (std::size_t i = 0; i < set.pixels.size(); i += 2) {
    set.pixels[i].mask = Mask(set.lf.width, set.lf.height, 1, 255);
    for (int y = 10; y < 20; ++y)
      for (int x = 5; x < 25; ++x) set.pixels[i].mask.at(x, y) = 0;
  }
}

}  // namespace

TEST_CASE("OpenGL makes the CPU's pictures") {
  std::printf("GL_RENDERER: %s\n",
              gl_renderer_name().c_str());  // throws, and fails the test, without a context
  const std::vector<Lattice> lattices = {
      {.rows = 3, .cols = 3},
      {.rows = 4, .cols = 5, .width = 131, .height = 77, .jitter = 0.2, .off_plane = 0.15},
      {.rows = 1, .cols = 6, .jitter = 0.1},
      {.rows = 4, .cols = 4, .jitter = 0.1, .holes = {{0, 0}, {1, 1}, {2, 1}, {3, 3}}},
      {.rows = 1, .cols = 1},
  };
  int kind = 0;
  for (const bool masked : {false, true}) {
    for (const Lattice& lattice : lattices) {
      const auto set = make_views(lattice);
      set->lf.type = PixelType::f32;
      paint_differently(*set);
      // Grey and float in turn with colour of every type.
      const PixelType types[] = {PixelType::u8, PixelType::u16, PixelType::f16, PixelType::f32};
      if (kind++ % 5 < 4) colour_in(*set, types[kind % 4]);
      if (masked) mask_some(*set);
      const auto cpu = make_cpu_renderer(set);
      const auto gl = make_gl_renderer(set);
      Viewpoint rotated = default_viewpoint(set->lf, 1.2, 0.4, 0.3);
      rotated.view_from_scene = rotation_from_vector({0.1, -0.2, 0.3});
      const View& camera = set->cameras.back();
      for (const Viewpoint& view :
           {default_viewpoint(set->lf, 0.7, 0.6), default_viewpoint(set->lf, camera.s, camera.t, camera.w),
            default_viewpoint(set->lf, 1.3, 1.1, -0.9), rotated,
            resized(default_viewpoint(set->lf, 0.2, 0.9), 67, 91)}) {
        for (const Filter filter : {Filter::normal, Filter::wide, Filter::skipped}) {
          for (const double d : {-1.5, 0.0, 3.21}) {
            INFO(lattice.rows << "x" << lattice.cols << " masked " << masked << " at " << view.s << " "
                              << view.z << " d " << d << " filter " << static_cast<int>(filter));
            CHECK(differing(cpu->render(view, d, filter), gl->render(view, d, filter)) <= 0.001);
          }
        }
      }
    }
  }
}

namespace {

/// Every filter on three focal planes of a scene on disk, a few places between its cameras and on one.
void check_scene(const char* list, const std::string& range) {
  STUV_NEED_SHARED_DATA(data);
  const TempFolder folder;
  const std::string scene = (folder / "scene").string();
  const auto import =
      run_stuv("import '" + (data / list).string() + "' -o " + scene + " --disparity=" + range);
  INFO(import.err);
  REQUIRE(import.exit_code == 0);
  const LightFieldReader reader(open_light_field(scene));
  const LightField& lf = reader.light_field();
  const auto set = load_views(reader);
  const auto cpu = make_cpu_renderer(set);
  const auto gl = make_gl_renderer(set);
  const View &a = set->cameras.front(), &b = set->cameras.back();
  double worst = 0;
  for (const double part : {0.0, 0.37, 0.5}) {
    const Viewpoint view = default_viewpoint(lf, a.s + part * (b.s - a.s), a.t + 0.9 * part * (b.t - a.t));
    for (const double d : {lf.d_min, 0.3 * lf.d_min + 0.7 * lf.d_max, lf.d_max})
      for (const Filter filter : {Filter::normal, Filter::wide, Filter::skipped}) {
        INFO(list << " part " << part << " d " << d << " filter " << static_cast<int>(filter));
        const double part_differing = differing(cpu->render(view, d, filter), gl->render(view, d, filter));
        CHECK(part_differing <= 0.001);
        worst = std::max(worst, part_differing);
      }
  }
  std::printf("%s: at most %.6f of the pixels differ by more than 1/255\n", list, worst);
}

}  // namespace

TEST_CASE("OpenGL makes the CPU's pictures of the knights") { check_scene("knights/views.csv", "-347,231"); }
TEST_CASE("OpenGL makes the CPU's pictures of dino") { check_scene("hci/dino/views.csv", "-2.5,2.5"); }
TEST_CASE("OpenGL makes the CPU's pictures of the shop") { check_scene("shop/views.csv", "0,276"); }
TEST_CASE("OpenGL makes the CPU's pictures of cotton") { check_scene("hci/cotton/views.csv", "-2.5,2.5"); }
