#include <tbb/global_control.h>

#include <cmath>
#include <cstdint>
#include <cstdio>

#include "render/renderer.h"
#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

namespace {

double psnr(const ImageF& a, const ImageF& b) {
  REQUIRE(a.data.size() == b.data.size());
  double sum = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) sum += std::pow(a.data[i] - b.data[i], 2);
  return -10 * std::log10(sum / static_cast<double>(a.data.size()) + 1e-20);
}

double skipped(const RenderedView& view, const std::string& reason) {
  for (const Skipped& s : view.statistics.skipped)
    if (s.reason == reason) return s.fraction;
  FAIL("no reason " << reason);
  return 0;
}

/// A far plane, a near one before its right half; the lower part is of one colour.
std::shared_ptr<ViewSet> scene() {
  auto set = make_views({.rows = 4, .cols = 4, .width = 200, .height = 160});
  for (std::size_t i = 0; i < set->cameras.size(); ++i) {
    const View& view = set->cameras[i];
    const ImageF far = picture_of_plane(set->lf, view, 2, waves);
    const ImageF near = picture_of_plane(set->lf, view, 6, waves);
    const double edge_px = set->lf.cx0_px - 6 * (view.s - 1);
    for (int y = 0; y < 160; ++y)
      for (int x = 0; x < 200; ++x)
        set->pixels[i].colour.at(x, y) = y > 90 ? 0.5F : (x > edge_px ? near : far).at(x, y);
  }
  return set;
}

/// Nothing is skipped.
Skips nothing() {
  Skips s;
  s.empty_planes = s.tile_planes = s.flat_tiles = s.tile_margins = s.colour_costs = false;
  s.idle_cameras = s.second_filter = s.unread_tiles = s.previous_view = false;
  return s;
}

RenderOptions options_of() {
  RenderOptions options;
  options.planes = 17;
  options.window = 3;
  options.d_min = 0;
  options.d_max = 8;
  return options;
}

}  // namespace

TEST_CASE("fast is close to exact, and says what it left out") {
  const auto set = scene();
  const RenderOptions options = options_of();
  const Viewpoint view = default_viewpoint(set->lf, 1.4, 1.5);
  const RenderedView exact = make_renderer(Method::exact, Backend::cpu, set)->all_in_focus(view, options);
  const RenderedView fast = make_renderer(Method::fast, Backend::cpu, set)->all_in_focus(view, options);
  CHECK(psnr(exact.colour, fast.colour) > 40);
  CHECK(fast.statistics.evaluated_fraction < 0.6);
  CHECK(skipped(fast, "planes not near the tile") > 0.05);
  CHECK(skipped(fast, "flat tiles") > 0.1);
}

TEST_CASE("fast leaves out planes on which there is nothing") {
  const auto set = make_views({.rows = 4, .cols = 4, .width = 200, .height = 160});
  paint_plane(*set, 2, waves);
  RenderOptions options = options_of();
  options.d_max = 32;
  const Viewpoint view = default_viewpoint(set->lf, 1.4, 1.5);
  const RenderedView fast = make_renderer(Method::fast, Backend::cpu, set)->all_in_focus(view, options);
  CHECK(skipped(fast, "empty planes") > 0.1);
  const RenderedView exact = make_renderer(Method::exact, Backend::cpu, set)->all_in_focus(view, options);
  CHECK(psnr(exact.colour, fast.colour) > 35);
}

TEST_CASE("Each skip of fast can be switched off alone") {
  const auto set = scene();
  const Viewpoint view = default_viewpoint(set->lf, 1.4, 1.5);
  const RenderedView exact =
      make_renderer(Method::exact, Backend::cpu, set)->all_in_focus(view, options_of());
  const auto render = [&](auto change) {
    RenderOptions options = options_of();
    change(options.skips);
    const RenderedView out = make_renderer(Method::fast, Backend::cpu, set)->all_in_focus(view, options);
    CHECK(psnr(exact.colour, out.colour) > 40);
    return out;
  };
  CHECK(skipped(render([](Skips& s) { s.empty_planes = false; }), "empty planes") == 0);
  CHECK(skipped(render([](Skips& s) { s.tile_planes = false; }), "planes not near the tile") ==
        Approx(0).margin(1e-9));
  CHECK(skipped(render([](Skips& s) { s.flat_tiles = false; }), "flat tiles") == 0);
  CHECK(skipped(render([](Skips& s) { s.tile_margins = false; }), "pixels beside tiles") == 0);
  CHECK(skipped(render([](Skips& s) { s.colour_costs = false; }), "colour in costs") == 0);
  CHECK(skipped(render([](Skips& s) { s.idle_cameras = false; }), "idle cameras") == 0);
  CHECK(skipped(render([](Skips& s) { s.second_filter = false; }), "second filter") == 0);
  CHECK(skipped(render([](Skips& s) { s.unread_tiles = false; }), "unread tiles of the database") == 0);
  // With nothing left out, it is exact.
  const RenderedView all = render([](Skips& s) { s = nothing(); });
  // But for rounding: other blocks, other sums.
  CHECK(psnr(all.colour, exact.colour) > 120);
  CHECK(all.plane.data == exact.plane.data);
  // Where many planes are looked at, the second filter rules some out, and changes nothing.
  const RenderedView ruled = render([](Skips& s) {
    s = nothing();
    s.second_filter = s.idle_cameras = s.unread_tiles = true;
  });
  CHECK(skipped(ruled, "second filter") > 0);
  CHECK(psnr(ruled.colour, exact.colour) > 120);
  CHECK(ruled.plane.data == exact.plane.data);
}

TEST_CASE("fast uses the picture before, and the same pictures in the same order are the same") {
  const auto set = scene();
  const RenderOptions options = options_of();
  const auto renderer = make_renderer(Method::fast, Backend::cpu, set);
  std::vector<RenderedView> path[2];
  for (const int threads : {1, 8}) {
    const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                    static_cast<std::size_t>(threads));
    renderer->forget();
    for (int i = 0; i < 6; ++i)
      path[threads == 1 ? 0 : 1].push_back(
          renderer->all_in_focus(default_viewpoint(set->lf, 1.2 + 0.1 * i, 1.5), options));
  }
  const auto exact = make_renderer(Method::exact, Backend::cpu, set);
  for (std::size_t i = 0; i < path[0].size(); ++i) {
    CHECK(path[0][i].colour.data == path[1][i].colour.data);
    CHECK(path[0][i].plane.data == path[1][i].plane.data);
    CHECK(skipped(path[0][i], "coarse pass") == (i == 0 ? 0 : 1));
    CHECK(
        psnr(path[0][i].colour,
             exact->all_in_focus(default_viewpoint(set->lf, 1.2 + 0.1 * static_cast<double>(i), 1.5), options)
                 .colour) > 35);
  }
}

TEST_CASE("fast: every kind of viewpoint and lattice") {
  for (const Lattice& lattice : {Lattice{.rows = 1, .cols = 5, .width = 61, .height = 47, .jitter = 0.1},
                                 Lattice{.rows = 4, .cols = 3, .width = 61, .height = 47, .off_plane = 0.1},
                                 Lattice{.rows = 1, .cols = 1, .width = 1, .height = 1}}) {
    const auto set = make_views(lattice);
    paint_plane(*set, 2, waves);
    const auto exact = make_renderer(Method::exact, Backend::cpu, set);
    const auto fast = make_renderer(Method::fast, Backend::cpu, set);
    for (const double z : {0.0, 0.3}) {
      Viewpoint view = default_viewpoint(set->lf, 0.4, 0.3, z);
      if (z > 0) view.view_from_scene = rotation_from_vector({0.02, 0.1, -0.05});
      RenderOptions options = options_of();
      CHECK(psnr(exact->all_in_focus(view, options).colour, fast->all_in_focus(view, options).colour) > 34);
      options.planes = 1;
      CHECK(psnr(exact->all_in_focus(view, options).colour, fast->all_in_focus(view, options).colour) > 34);
    }
  }
}

TEST_CASE("fast tells planes apart whose texture is in colour alone") {
  const auto set = make_views({.rows = 4, .cols = 4, .width = 200, .height = 160});
  paint_plane(*set, 3, waves);
  set->lf.channels = 3;
  for (ViewPixels& pixels : set->pixels) {
    ImageF colour(200, 160, 3);
    for (std::size_t i = 0; i < pixels.colour.data.size(); ++i) {
      // (R + 2G + B) / 4 is the same everywhere.
      colour.data[3 * i] = pixels.colour.data[i];
      colour.data[3 * i + 1] = 0.5F;
      colour.data[3 * i + 2] = 1 - pixels.colour.data[i];
    }
    pixels.colour = colour;
  }
  const Viewpoint view = default_viewpoint(set->lf, 1.4, 1.5);
  const RenderedView exact =
      make_renderer(Method::exact, Backend::cpu, set)->all_in_focus(view, options_of());
  const RenderedView fast = make_renderer(Method::fast, Backend::cpu, set)->all_in_focus(view, options_of());
  CHECK(skipped(fast, "colour in costs") == 0);
  CHECK(psnr(exact.colour, fast.colour) > 40);
}

namespace {

/// Green bars at disparity 6 before a wall at 2 whose blue tiles are as bright as they are; below, all is
/// grey.
ImageF bars_before_tiles(const LightField& lf, const View& view) {
  ImageF out(lf.width, lf.height, 3);
  for (int y = 0; y < lf.height; ++y)
    for (int x = 0; x < lf.width; ++x) {
      const double u = x - view.cx_px, v = y - view.cy_px;
      const double near_x = u + 6 * view.s, near_y = v + 6 * view.t;
      const double far_x = u + 2 * view.s, far_y = v + 2 * view.t;
      const bool near = std::sin(0.3 * near_x) > 0.5;
      const float w = near ? waves(near_x, near_y) : waves(far_x, far_y);
      float* rgb = &out.at(x, y);
      if (y > 90)
        rgb[0] = rgb[1] = rgb[2] = w;
      else if (near)
        rgb[0] = 0.2F * w, rgb[1] = 0.6F, rgb[2] = 0.2F - 0.2F * w;
      else
        rgb[0] = 0.4F * w, rgb[1] = 0.25F, rgb[2] = 0.9F - 0.4F * w;
    }
  return out;
}

}  // namespace

TEST_CASE("fast loses at most 0.1 dB where things differ in colour alone") {
  const auto set = make_views({.rows = 4, .cols = 4, .width = 200, .height = 160});
  set->lf.channels = 3;
  for (std::size_t i = 0; i < set->cameras.size(); ++i)
    set->pixels[i].colour = bars_before_tiles(set->lf, set->cameras[i]);
  const auto exact = make_renderer(Method::exact, Backend::cpu, set);
  const auto fast = make_renderer(Method::fast, Backend::cpu, set);
  // The second and third picture expect what they do from the one before.
  for (const double s : {1.3, 1.4, 1.5}) {
    const Viewpoint view = default_viewpoint(set->lf, s, 1.5);
    View here = set->cameras.front();
    here.s = view.s;
    here.t = view.t;
    const ImageF truth = bars_before_tiles(set->lf, here);
    const RenderedView picture = fast->all_in_focus(view, options_of());
    CHECK(psnr(truth, picture.colour) > psnr(truth, exact->all_in_focus(view, options_of()).colour) - 0.1);
    CHECK(skipped(picture, "colour in costs") > 0.1);
    CHECK(skipped(picture, "colour in costs") < 0.6);
  }
}

namespace {

/// Noise of lattice values `size` px apart, blended; 0 to 1.
double noise(double x, double y, double size, unsigned seed) {
  const auto value = [&](double i, double j) {
    std::uint32_t h = static_cast<std::uint32_t>(static_cast<int>(i)) * 0x9e3779b1U ^
                      static_cast<std::uint32_t>(static_cast<int>(j)) * 0x85ebca77U ^ seed * 0xc2b2ae3dU;
    h = (h ^ h >> 15) * 0x2c1b3c6dU;
    h = (h ^ h >> 12) * 0x297a2d39U;
    return static_cast<double>(h ^ h >> 15) / 4294967296.0;
  };
  const double i = std::floor(x / size), j = std::floor(y / size), a = x / size - i, b = y / size - j;
  return (1 - b) * ((1 - a) * value(i, j) + a * value(i + 1, j)) +
         b * ((1 - a) * value(i, j + 1) + a * value(i + 1, j + 1));
}

/// Three finely textured layers, the nearer two in patches.
ImageF layers(const LightField& lf, const View& view) {
  ImageF out(lf.width, lf.height, 1);
  for (int y = 0; y < lf.height; ++y)
    for (int x = 0; x < lf.width; ++x) {
      unsigned layer = 0;
      for (const double d : {2.0, 9.3, 17.6}) {
        const double u = x - view.cx_px + d * view.s, v = y - view.cy_px + d * view.t;
        if (layer++ > 0 && noise(u, v, 40, 10 + layer) < 0.55) continue;
        double sum = 0;
        for (const double size : {2.0, 4.0, 8.0, 16.0}) sum += noise(u, v, size, layer) / 4;
        out.at(x, y) = static_cast<float>(sum);
      }
    }
  return out;
}

}  // namespace

TEST_CASE("fast loses at most 0.1 dB of layers, however large the window") {
  const auto set = make_views({.rows = 4, .cols = 4, .width = 480, .height = 360});
  for (std::size_t i = 0; i < set->cameras.size(); ++i)
    set->pixels[i].colour = layers(set->lf, set->cameras[i]);
  const Viewpoint view = default_viewpoint(set->lf, 1.4, 1.5);
  View here = set->cameras.front();
  here.s = view.s;
  here.t = view.t;
  const ImageF truth = layers(set->lf, here);
  for (const int window : {3, 4, 5, 7, 8}) {
    RenderOptions options = options_of();
    options.planes = 32;
    options.window = window;
    options.d_min = 1;
    options.d_max = 19;
    const double exact =
        psnr(truth, make_renderer(Method::exact, Backend::cpu, set)->all_in_focus(view, options).colour);
    const double fast =
        psnr(truth, make_renderer(Method::fast, Backend::cpu, set)->all_in_focus(view, options).colour);
    std::printf("M %d: exact %.2f dB, fast %.2f dB\n", window, exact, fast);
    CHECK(fast > exact - 0.1);
  }
}

TEST_CASE("fast has a plane wherever exact has one") {
  // Cameras off their plane and masks: of a pixel at the border some planes are seen and others are not.
  for (const double missing : {0.0, 7.0}) {
    const auto set = make_views({.rows = 4, .cols = 4, .width = 200, .height = 160, .off_plane = 0.1});
    paint_plane(*set, 6, waves);
    if (missing > 0)
      for (std::size_t i = 0; i < set->pixels.size(); ++i) {
        Mask mask(200, 160, 1, 255);
        for (int y = 0; y < 160; ++y)
          for (int x = 0; x < 200; ++x)
            if (x + y < missing * static_cast<double>(1 + i % 3) || y > 150 + static_cast<int>(i % 4))
              mask.at(x, y) = 0;
        set->pixels[i].mask = mask;
      }
    for (const auto& [s, t] : {std::pair(0.1, 0.05), {2.9, 2.95}, {1.4, 3.1}}) {
      const Viewpoint view = default_viewpoint(set->lf, s, t);
      const RenderedView exact =
          make_renderer(Method::exact, Backend::cpu, set)->all_in_focus(view, options_of());
      const RenderedView fast =
          make_renderer(Method::fast, Backend::cpu, set)->all_in_focus(view, options_of());
      int lacking = 0;
      for (std::size_t i = 0; i < exact.plane.data.size(); ++i)
        lacking += exact.plane.data[i] >= 0 && fast.plane.data[i] < 0 ? 1 : 0;
      CHECK(lacking == 0);
    }
  }
}
