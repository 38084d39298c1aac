#include "render/gl/gl_renderer.h"

#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

namespace {

/// Part of the pixels that differ by more than 1/255 in colour or in coverage.
double differing(const FocalPlaneView& a, const FocalPlaneView& b) {
  std::size_t count = 0;
  for (std::size_t i = 0; i < a.coverage.data.size(); ++i)
    if (std::abs(a.colour.data[i] - b.colour.data[i]) > 1.0F / 255 ||
        std::abs(a.coverage.data[i] - b.coverage.data[i]) > 1.0F / 255)
      ++count;
  return static_cast<double>(count) / static_cast<double>(a.coverage.data.size());
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
  for (const bool masked : {false, true}) {
    for (const Lattice& lattice : lattices) {
      const auto set = make_views(lattice);
      set->lf.type = PixelType::f32;
      paint_differently(*set);
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
