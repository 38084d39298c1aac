#include "render/all_in_focus.h"

#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

namespace {

constexpr double kFar = 2, kNear = 6;

/// Left half far, right half near (as the middle view sees it), one picture a view.
std::shared_ptr<ViewSet> two_planes() {
  auto set = make_views({.rows = 3, .cols = 3, .width = 80, .height = 40});
  for (std::size_t i = 0; i < set->cameras.size(); ++i) {
    const View& view = set->cameras[i];
    const ImageF far = picture_of_plane(set->lf, view, kFar, waves);
    const ImageF near = picture_of_plane(set->lf, view, kNear, waves);
    const double edge_px = set->lf.cx0_px - kNear * (view.s - 1);
    for (int y = 0; y < 40; ++y)
      for (int x = 0; x < 80; ++x) set->pixels[i].colour.at(x, y) = (x > edge_px ? near : far).at(x, y);
  }
  return set;
}

}  // namespace

TEST_CASE("literal finds the planes of a scene of two") {
  const auto set = two_planes();
  const auto renderer = make_cpu_renderer(set);
  RenderOptions options;
  options.planes = 5;  // 0, 2, 4, 6, 8
  options.d_min = 0;
  options.d_max = 8;
  options.window = 3;
  const RenderedView out = all_in_focus(*renderer, default_viewpoint(set->lf, 1.4, 1.5), options);
  int right = 0, all = 0;
  for (int y = 10; y < 30; ++y) {
    for (int x = 12; x < 68; ++x) {
      if (x > 24 && x < 50) continue;  // the edge and what it hides
      ++all;
      right += out.plane.at(x, y) == (x < 38 ? 1 : 3) ? 1 : 0;
      CHECK(out.confidence.at(x, y) >= 0);
      CHECK(out.confidence.at(x, y) <= 1);
    }
  }
  CHECK(right > 0.97 * all);
}

TEST_CASE("Of equal minima the farther plane") {
  const auto set = make_views({});
  paint_constant(*set, 0.5F);
  RenderOptions options;
  // Whole shifts and weights of quarters: no rounding tells the planes apart.
  options.planes = 3;
  options.d_min = -1;
  options.d_max = 1;
  const RenderedView out =
      all_in_focus(*make_cpu_renderer(set), default_viewpoint(set->lf, 1.5, 0.5), options);
  // At the border the farthest plane may lack cameras; inside all planes see all.
  for (int y = 12; y < 28; ++y)
    for (int x = 12; x < 36; ++x) REQUIRE(out.plane.at(x, y) == 0);
}

TEST_CASE("One pixel, one plane, a window of one and a window larger than the picture") {
  for (const int size : {1, 9}) {
    const auto set = make_views({.rows = 2, .cols = 2, .width = size, .height = size});
    paint_constant(*set, 0.5F);
    const auto renderer = make_cpu_renderer(set);
    for (const int planes : {1, 3}) {
      for (const int window : {0, 1000000000}) {
        RenderOptions options;
        options.planes = planes;
        options.window = window;
        options.d_min = options.d_max = 0;
        const RenderedView out = all_in_focus(*renderer, default_viewpoint(set->lf, 0.5, 0.5), options);
        for (const float v : out.colour.data) CHECK(v == Approx(0.5));
        for (const int n : out.plane.data) CHECK(n == 0);
      }
    }
  }
}

TEST_CASE("Far outside the hull: no NaN, confidence 0; where nobody looks: black, plane -1") {
  const auto set = two_planes();
  RenderOptions options;
  options.d_min = 1;
  options.d_max = 8;
  const auto renderer = make_cpu_renderer(set);
  const RenderedView near = all_in_focus(*renderer, default_viewpoint(set->lf, 3.5, 1), options);
  for (std::size_t i = 0; i < near.plane.data.size(); ++i) {
    REQUIRE(std::isfinite(near.colour.data[i]));
    REQUIRE(near.confidence.data[i] == 0);
  }
  const RenderedView away = all_in_focus(*renderer, default_viewpoint(set->lf, 1e5, 1), options);
  for (std::size_t i = 0; i < away.plane.data.size(); ++i) {
    REQUIRE(away.plane.data[i] == -1);
    REQUIRE(away.colour.data[i] == 0);
    REQUIRE(away.confidence.data[i] == 0);
  }
}

TEST_CASE("Options that make no sense are refused") {
  const auto refused = [](auto change) {
    RenderOptions options;
    change(options);
    CHECK_THROWS_AS(validate(options), std::invalid_argument);
  };
  refused([](RenderOptions& o) { o.planes = 0; });
  refused([](RenderOptions& o) { o.window = -1; });
  refused([](RenderOptions& o) { o.a01 = o.a02 = 0; });
  refused([](RenderOptions& o) { o.d_min = std::nan(""); });
  refused([](RenderOptions& o) { o.d_min = 2, o.d_max = 1; });
}
