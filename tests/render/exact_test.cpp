#include <tbb/global_control.h>

#include <cmath>

#include "core/image_io.h"
#include "render/all_in_focus.h"
#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

namespace {

/// 1 where the cost of literal's best plane leads the second best by more than 1e-5 of full scale, on any of
/// the others 0.
Raster<std::uint8_t> clear_leads(const std::shared_ptr<const ViewSet>& set, const Viewpoint& view,
                                 const RenderOptions& options) {
  const auto planes = make_cpu_renderer(set);
  Raster<double> best(view.width, view.height, 1, INFINITY), second = best;
  for (int n = 0; n < options.planes; ++n) {
    const Raster<double> E = focus_cost(*planes, view, options, n);
    for (std::size_t i = 0; i < E.data.size(); ++i) {
      if (E.data[i] < best.data[i]) {
        second.data[i] = best.data[i];
        best.data[i] = E.data[i];
      } else {
        second.data[i] = std::min(second.data[i], E.data[i]);
      }
    }
  }
  Raster<std::uint8_t> out(view.width, view.height, 1);
  for (std::size_t i = 0; i < out.data.size(); ++i)
    out.data[i] = best.data[i] < INFINITY && second.data[i] - best.data[i] > 1e-5 ? 1 : 0;
  return out;
}

/// The contract of `exact`: pixels that differ by more than 1/255, planes that differ among clear leads.
struct Difference {
  double colour = 0, plane = 0;  ///< parts
  double count = 0;              ///< pixels that `colour` is of
};

/// `all`: of all pixels; else the colour, too, of those with clear leads: of equal costs any may be chosen.
Difference difference(const RenderedView& a, const RenderedView& b, const Raster<std::uint8_t>& clear,
                      bool all) {
  REQUIRE(a.colour.data.size() == b.colour.data.size());
  const std::size_t channels = static_cast<std::size_t>(a.colour.channels), pixels = a.plane.data.size();
  Difference out;
  double leads = 0;
  for (std::size_t i = 0; i < pixels; ++i) {
    if (clear.data[i]) {
      ++leads;
      out.plane += a.plane.data[i] != b.plane.data[i] ? 1 : 0;
    }
    if (!all && !clear.data[i]) continue;
    bool differs = false;
    for (std::size_t c = i * channels; c < (i + 1) * channels; ++c)
      differs = differs || !(std::abs(a.colour.data[c] - b.colour.data[c]) <= 1.0F / 255);
    out.colour += differs ? 1 : 0;
    ++out.count;
  }
  out.colour /= std::max(out.count, 1.0);
  out.plane /= std::max(leads, 1.0);
  return out;
}

/// The two methods on one scene in memory, on a viewpoint.
Difference literal_against_exact(const std::shared_ptr<ViewSet>& set, const Viewpoint& view,
                                 const RenderOptions& options, Backend backend) {
  const RenderedView literal = make_renderer(Method::literal, Backend::cpu, set)->all_in_focus(view, options);
  const RenderedView exact = make_renderer(Method::exact, backend, set)->all_in_focus(view, options);
  for (const float v : exact.colour.data) REQUIRE(std::isfinite(v));
  const Raster<std::uint8_t> clear = clear_leads(set, view, options);
  int unsure = 0;
  for (std::size_t i = 0; i < literal.plane.data.size(); ++i)
    if (clear.data[i] && literal.plane.data[i] == exact.plane.data[i])
      unsure += std::abs(literal.confidence.data[i] - exact.confidence.data[i]) > 2e-3F ? 1 : 0;
  // Where a filter keeps just half its weight, a plane may count or not.
  CHECK(unsure <= 2);
  return difference(literal, exact, clear, false);
}

/// A textured plane in other colours for every channel, with gaps.
std::shared_ptr<ViewSet> scene_of(const Lattice& lattice, PixelType type, int channels, bool masked) {
  auto set = make_views(lattice);
  paint_plane(*set, 2.3, waves);
  set->lf.type = type;
  set->lf.channels = channels;
  for (std::size_t i = 0; i < set->pixels.size(); ++i) {
    ViewPixels& pixels = set->pixels[i];
    ImageF colour(pixels.colour.width, pixels.colour.height, channels);
    for (std::size_t k = 0; k < pixels.colour.data.size(); ++k)
      for (int c = 0; c < channels; ++c)
        colour.data[k * channels + c] =
            c == 1 ? 1 - pixels.colour.data[k]
                   : std::pow(pixels.colour.data[k], 1.0F + 0.5F * static_cast<float>(c));
    pixels.colour = to_float(from_float(colour, type));
    if (!masked || i % 2 == 0) continue;
    pixels.mask = Mask(colour.width, colour.height, 1, 255);
    for (int y = 10; y < 20; ++y)
      for (int x = 5; x < 25; ++x) pixels.mask.at(x, y) = 0;
  }
  return set;
}

void check_every_viewpoint(Backend backend) {
  const std::vector<Lattice> lattices = {
      {.rows = 3, .cols = 3},
      {.rows = 4, .cols = 5, .width = 131, .height = 77, .jitter = 0.2, .off_plane = 0.15},
      {.rows = 4, .cols = 4, .jitter = 0.1},
      {.rows = 4, .cols = 4, .width = 150, .height = 60, .jitter = 0.1, .off_plane = 0.02},
      {.rows = 1, .cols = 6, .jitter = 0.1},
      {.rows = 6, .cols = 1},
      {.rows = 4, .cols = 4, .jitter = 0.1, .holes = {{0, 0}, {1, 1}, {2, 1}, {3, 3}}},
      {.rows = 1, .cols = 1},
  };
  const PixelType types[] = {PixelType::u8, PixelType::u16, PixelType::f16, PixelType::f32};
  int kind = 0;
  Difference worst;
  for (const bool masked : {false, true}) {
    for (const Lattice& lattice : lattices) {
      const auto set = scene_of(lattice, types[kind % 4], kind % 3 == 0 ? 1 : 3, masked);
      ++kind;
      Viewpoint rotated = default_viewpoint(set->lf, 1.2, 0.4, 0.3);
      rotated.view_from_scene = rotation_from_vector({0.1, -0.2, 0.3});
      Viewpoint zoomed = default_viewpoint(set->lf, 0.7, 0.6);
      zoomed.focal_px *= 1.7;
      const View& camera = set->cameras.back();
      const double surface = camera_surface_z(set->lf, 0.9, 0.6);
      for (const Viewpoint& view :
           {default_viewpoint(set->lf, 0.7, 0.6), default_viewpoint(set->lf, camera.s, camera.t, camera.w),
            default_viewpoint(set->lf, 0.9, 0.6, surface), default_viewpoint(set->lf, 1, 1.3),
            default_viewpoint(set->lf, 1.3, 1.1, -0.9), default_viewpoint(set->lf, 40, 1), rotated, zoomed,
            resized(default_viewpoint(set->lf, 0.2, 0.9), 67, 91)}) {
        RenderOptions options;
        options.planes = 7;
        options.window = 2;
        options.d_min = -1;
        options.d_max = 5.3;
        if (kind % 2 == 0) options.a12 = 0.5;
        options.k = static_cast<Filter>(kind % 3);
        INFO(lattice.rows << "x" << lattice.cols << " type " << (kind - 1) % 4 << " masked " << masked
                          << " at " << view.s << " " << view.t << " " << view.z << " f " << view.focal_px
                          << " " << view.width);
        const Difference d = literal_against_exact(set, view, options, backend);
        // Of so few pixels one or two may stand between two planes.
        CHECK(d.colour * d.count <= 2);
        CHECK(d.plane <= 1e-3);
        worst.colour = std::max(worst.colour, d.colour);
        worst.plane = std::max(worst.plane, d.plane);
      }
    }
  }
  std::printf("%s: at most %.6f of the pixels differ by more than 1/255, %.4f in plane\n", name_of(backend),
              worst.colour, worst.plane);
}

/// The contract on a real light field, between cameras, on one, and beside them.
void check_scene(const char* list, const std::string& range, int planes, int window, Backend backend) {
  STUV_NEED_SHARED_DATA(data);
  const TempFolder folder;
  const std::string scene = (folder / "scene").string();
  const auto import =
      run_stuv("import '" + (data / list).string() + "' -o " + scene + " --disparity=" + range);
  INFO(import.err);
  REQUIRE(import.exit_code == 0);
  const LightFieldReader reader(open_light_field(scene));
  const LightField& lf = reader.light_field();
  RenderOptions options;
  options.planes = planes;
  options.window = window;
  options.d_min = lf.d_min;
  options.d_max = lf.d_max;
  const auto set = load_views(reader);
  const auto literal = make_renderer(Method::literal, Backend::cpu, set);
  const auto exact = make_renderer(Method::exact, backend, reader);
  const auto inputs = lf.views_with(ViewRole::input);
  const View &a = lf.views[static_cast<std::size_t>(inputs.front())],
             &b = lf.views[static_cast<std::size_t>(inputs.back())];
  for (const double part : {0.43, 0.0, 1.1}) {
    const Viewpoint view = default_viewpoint(lf, a.s + part * (b.s - a.s), a.t + 0.9 * part * (b.t - a.t));
    const Difference d = difference(literal->all_in_focus(view, options), exact->all_in_focus(view, options),
                                    clear_leads(set, view, options), true);
    std::printf("%s, %s, part %.2f: %.6f of the pixels differ by more than 1/255, %.6f in plane\n", list,
                name_of(backend), part, d.colour, d.plane);
    CHECK(d.colour <= 1e-4);
    CHECK(d.plane <= 1e-3);
  }
}

}  // namespace

TEST_CASE("exact is the picture of literal from every viewpoint, lattice and type: CPU") {
  check_every_viewpoint(Backend::cpu);
}

TEST_CASE("exact is the picture of literal from every viewpoint, lattice and type: OpenGL") {
  check_every_viewpoint(Backend::gl);
}

TEST_CASE("exact is the picture of literal where pictures fill more than one buffer of OpenGL") {
  // 16 MB each as floats; Mesa's buffers hold 128 MB.
  const auto set = scene_of({.rows = 4, .cols = 4, .width = 1024, .height = 1024}, PixelType::f32, 1, false);
  Viewpoint crop = default_viewpoint(set->lf, 1.4, 1.7);
  crop.width = 80;
  crop.height = 60;
  crop.cx_px -= 480;
  crop.cy_px -= 490;
  Viewpoint behind = crop;
  behind.z = -0.3;
  RenderOptions options;
  options.planes = 5;
  options.window = 2;
  options.d_min = 0;
  options.d_max = 5;
  for (const Viewpoint& view : {crop, behind, resized(default_viewpoint(set->lf, 1.4, 1.7), 80, 60)}) {
    INFO("z " << view.z << " f " << view.focal_px);
    const Difference d = literal_against_exact(set, view, options, Backend::gl);
    CHECK(d.count > 1000);
    CHECK(d.colour <= 1e-4);
    CHECK(d.plane <= 1e-3);
  }
}

TEST_CASE("exact is the picture of literal: knights, OpenGL") {
  check_scene("knights/views.csv", "-347,231", 13, 3, Backend::gl);
}
TEST_CASE("exact is the picture of literal: dino, OpenGL") {
  check_scene("hci/dino/views.csv", "-2.5,2.5", 11, 3, Backend::gl);
}
TEST_CASE("exact is the picture of literal: knights, CPU") {
  check_scene("knights/views.csv", "-347,231", 13, 3, Backend::cpu);
}
TEST_CASE("exact is the picture of literal: dino, CPU") {
  check_scene("hci/dino/views.csv", "-2.5,2.5", 11, 3, Backend::cpu);
}
TEST_CASE("exact is the picture of literal: the shop, CPU") {
  check_scene("shop/views.csv", "0,276", 13, 4, Backend::cpu);
}

TEST_CASE("exact does not depend on the number of threads") {
  const auto set =
      scene_of({.rows = 4, .cols = 4, .width = 300, .height = 201, .jitter = 0.1}, PixelType::u8, 3, true);
  RenderOptions options;
  options.planes = 9;
  options.window = 3;
  options.d_min = 0;
  options.d_max = 4;
  for (const double z : {0.0, 0.2}) {
    const Viewpoint view = default_viewpoint(set->lf, 1.4, 1.7, z);
    RenderedView pictures[2];
    for (const int threads : {1, 8}) {
      const tbb::global_control limit(tbb::global_control::max_allowed_parallelism,
                                      static_cast<std::size_t>(threads));
      pictures[threads == 1 ? 0 : 1] =
          make_renderer(Method::exact, Backend::cpu, set)->all_in_focus(view, options);
    }
    CHECK(pictures[0].colour.data == pictures[1].colour.data);
    CHECK(pictures[0].plane.data == pictures[1].plane.data);
    CHECK(pictures[0].confidence.data == pictures[1].confidence.data);
  }
}
