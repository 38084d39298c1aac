#include <limits>

#include "render/focal_plane.h"
#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

namespace {

const std::vector<Filter> kFilters = {Filter::normal, Filter::wide, Filter::skipped};

const std::vector<Lattice> kLattices = {
    {.rows = 3, .cols = 3},
    {.rows = 4, .cols = 5, .jitter = 0.2, .off_plane = 0.15},
    {.rows = 1, .cols = 6, .jitter = 0.1, .off_plane = 0.1},
    {.rows = 5, .cols = 1},
    {.rows = 4, .cols = 4, .jitter = 0.1, .holes = {{0, 0}, {1, 1}, {2, 1}, {3, 3}}},
    {.rows = 1, .cols = 1},
};

}  // namespace

TEST_CASE("A viewpoint on a camera gives its picture back wherever the focal plane is") {
  for (const Lattice& lattice : kLattices) {
    const auto set = make_views(lattice);
    paint_differently(*set);
    const auto renderer = make_cpu_renderer(set);
    for (const double d : {-3.0, 0.0, 2.7, 9.0}) {
      for (std::size_t i = 0; i < set->cameras.size(); ++i) {
        const View& camera = set->cameras[i];
        const FocalPlaneView out =
            renderer->render(default_viewpoint(set->lf, camera.s, camera.t, camera.w), d, Filter::normal);
        float worst = 0;
        for (std::size_t k = 0; k < out.colour.data.size(); ++k)
          worst = std::max(worst, std::abs(out.colour.data[k] - set->pixels[i].colour.data[k]));
        INFO("camera " << camera.name << " of " << lattice.rows << "x" << lattice.cols << ", d " << d);
        CHECK(worst < 1e-5F);
      }
    }
  }
}

TEST_CASE("A constant scene gives the constant, or black where nothing is seen") {
  for (const Lattice& lattice : kLattices) {
    const auto set = make_views(lattice);
    paint_constant(*set, 0.375F);
    const auto renderer = make_cpu_renderer(set);
    Viewpoint rotated = default_viewpoint(set->lf, 0.7, 0.4, 0.3);
    rotated.view_from_scene = rotation_from_vector({0.2, -0.3, 0.1});
    for (const Viewpoint& view :
         {default_viewpoint(set->lf, 0.7, 0.4), default_viewpoint(set->lf, -30, 50, -4),
          default_viewpoint(set->lf, 1.1, 0.9, 1.5), rotated}) {
      for (const Filter filter : kFilters) {
        for (const double d : {-2.0, 0.0, 3.3}) {
          const FocalPlaneView out = renderer->render(view, d, filter);
          for (std::size_t k = 0; k < out.colour.data.size(); ++k) {
            const float coverage = out.coverage.data[k];
            REQUIRE((coverage >= 0 && coverage <= 1));
            REQUIRE(out.colour.data[k] == Approx(coverage > 0 ? 0.375F : 0.0F).margin(1e-6));
          }
        }
      }
    }
  }
}

TEST_CASE("A plane in focus looks as a camera would see it, on and off the camera plane, turned too") {
  const auto set = make_views({.rows = 4, .cols = 4, .jitter = 0.15, .off_plane = 0.1});
  const Texture slow = [](double x, double y) { return waves(0.3 * x, 0.3 * y); };
  paint_plane(*set, 4, slow);
  const auto renderer = make_cpu_renderer(set);
  for (const double z : {0.0, 0.8, -0.6}) {
    View camera = set->cameras[0];
    camera.s = 1.4, camera.t = 1.7, camera.w = z;
    const ImageF truth = picture_of_plane(set->lf, camera, 4, slow);
    for (const Filter filter : kFilters) {
      const FocalPlaneView out = renderer->render(default_viewpoint(set->lf, 1.4, 1.7, z), 4, filter);
      for (int y = 8; y < 32; ++y)
        for (int x = 8; x < 40; ++x) REQUIRE(out.colour.at(x, y) == Approx(truth.at(x, y)).margin(0.004));
    }
  }
}

TEST_CASE("Infinity is a focal plane as any other: nothing moves") {
  const auto set = make_views({.rows = 2, .cols = 2});
  for (ViewPixels& pixels : set->pixels)
    for (int x = 0; x < set->lf.width; ++x)
      for (int y = 0; y < set->lf.height; ++y) pixels.colour.at(x, y) = waves(x, y);
  const FocalPlaneView out =
      make_cpu_renderer(set)->render(default_viewpoint(set->lf, 0.3, 0.6), 0, Filter::normal);
  for (int y = 0; y < set->lf.height; ++y)
    for (int x = 0; x < set->lf.width; ++x)
      REQUIRE(out.colour.at(x, y) == Approx(set->pixels[0].colour.at(x, y)).margin(1e-5));
}

TEST_CASE("Missing and non-finite pixels leave the sums") {
  const auto set = make_views({.rows = 1, .cols = 2});
  paint_constant(*set, 0.25F);
  set->pixels[1].mask = Mask(set->lf.width, set->lf.height, 1, 255);
  set->pixels[1].mask.at(10, 10) = 0;
  set->pixels[1].colour.at(10, 10) = 1;
  const FocalPlaneView out =
      make_cpu_renderer(set)->render(default_viewpoint(set->lf, 0.25, 0), 0, Filter::normal);
  CHECK(out.colour.at(10, 10) == Approx(0.25));
  CHECK(out.coverage.at(10, 10) == Approx(0.75));
  CHECK(out.coverage.at(11, 10) == Approx(1));
}

TEST_CASE("A scene without metres has no viewpoints off its plane") {
  const auto set = make_views({});
  set->lf.metric = false;
  const auto renderer = make_cpu_renderer(set);
  CHECK_THROWS_AS(renderer->render(default_viewpoint(set->lf, 0, 0, 0.1), 0, Filter::normal),
                  std::invalid_argument);
  CHECK_THROWS_AS(renderer->render(default_viewpoint(set->lf, 0, 0), std::nan(""), Filter::normal),
                  std::invalid_argument);
}

TEST_CASE("Outside the hull is outside, its boundary inside") {
  const auto set = make_views({.rows = 2, .cols = 3});
  const auto inside = [&](double s, double t) {
    return inside_hull(*set, default_viewpoint(set->lf, s, t)).at(0, 0) != 0;
  };
  CHECK(inside(1, 0.5));
  CHECK(inside(2, 1));
  CHECK(inside(0, 0.3));
  CHECK_FALSE(inside(2.01, 0.5));
  CHECK_FALSE(inside(1, -0.01));
}
