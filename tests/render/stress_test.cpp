// Input that ought to break a plane sweep: every method and back end on it.
#include <algorithm>
#include <cmath>

#include "render/cpu/sweep_kernels.h"
#include "render/renderer.h"
#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

namespace {

struct Way {
  Method method;
  Backend backend;
};
constexpr Way kLiteral{Method::literal, Backend::cpu};
constexpr Way kWays[] = {
    kLiteral, {Method::exact, Backend::cpu}, {Method::exact, Backend::gl}, {Method::fast, Backend::cpu}};

std::string name_of(const Way& way) {
  return std::string(stuv::name_of(way.method)) + " on " + stuv::name_of(way.backend);
}

RenderedView picture(const Way& way, const std::shared_ptr<const ViewSet>& set, const Viewpoint& view,
                     const RenderOptions& options) {
  RenderedView out = make_renderer(way.method, way.backend, set)->all_in_focus(view, options);
  const int pixels = view.width * view.height;
  REQUIRE(out.plane.data.size() == static_cast<std::size_t>(pixels));
  bool finite = true, sane = true;
  for (const float v : out.colour.data) finite = finite && std::isfinite(v);
  for (const float c : out.confidence.data) sane = sane && c >= 0 && c <= 1;
  for (const int n : out.plane.data) sane = sane && n >= -1 && n < options.planes;
  CHECK(finite);
  CHECK(sane);
  return out;
}

RenderOptions options_of(double d_min, double d_max, int planes, int window = 2) {
  RenderOptions options;
  options.planes = planes;
  options.window = window;
  options.d_min = d_min;
  options.d_max = d_max;
  return options;
}

double psnr(const ImageF& a, const ImageF& b) {
  REQUIRE(a.data.size() == b.data.size());
  double sum = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) sum += std::pow(a.data[i] - b.data[i], 2);
  return -10 * std::log10(sum / static_cast<double>(a.data.size()) + 1e-20);
}

/// Part of the pixels that are equal.
double agreement(const Raster<int>& a, const Raster<int>& b) {
  double same = 0;
  for (std::size_t i = 0; i < a.data.size(); ++i) same += a.data[i] == b.data[i] ? 1 : 0;
  return same / static_cast<double>(a.data.size());
}

/// The scene with all lengths `k` times as large.
std::shared_ptr<ViewSet> scaled(const ViewSet& set, double k) {
  auto out = std::make_shared<ViewSet>(set);
  for (View& view : out->cameras) view.s *= k, view.t *= k, view.w *= k;
  out->lf.views = out->cameras;
  return out;
}

}  // namespace

TEST_CASE("stress: a focal plane at infinity, beyond, at the cameras' plane and behind it") {
  const auto set = make_views({.rows = 3, .cols = 3, .off_plane = 0.1});
  paint_plane(*set, 2, waves);
  for (const Way& way : kWays) {
    INFO(name_of(way));
    const auto renderer = make_renderer(way.method, way.backend, set);
    const auto literal = make_renderer(Method::literal, Backend::cpu, set);
    for (const double z : {0.0, 0.4, -0.4}) {
      const Viewpoint view = default_viewpoint(set->lf, 1.2, 0.7, z);
      // 1e7 px: a plane that is nowhere but at the cameras; -1e7: as near, behind them.
      for (const double d : {0.0, -3.0, 1e7, 1e300, -1e7, -1e300}) {
        INFO("z " << z << " d " << d);
        const RenderedView a = renderer->focal_plane(view, d, Filter::wide);
        CHECK(psnr(a.colour, literal->focal_plane(view, d, Filter::wide).colour) > 60);
      }
      // All of them among the planes: the one that is real wins.
      const RenderedView found = picture(way, set, view, options_of(-1e6, 1e6, 3));
      CHECK(psnr(found.colour, picture(kLiteral, set, view, options_of(-1e6, 1e6, 3)).colour) > 60);
    }
  }
}

TEST_CASE("stress: the unit of length does not matter, from 1e-6 to 1e6") {
  const auto set = make_views({.rows = 3, .cols = 4, .jitter = 0.1, .off_plane = 0.05});
  paint_plane(*set, 2, waves);
  for (const Way& way : kWays) {
    const RenderedView one =
        picture(way, set, default_viewpoint(set->lf, 1.2, 0.7, 0.3), options_of(0.5, 4, 8));
    for (const double k : {1e-6, 1e-3, 1e6}) {
      INFO(name_of(way) << ", spacing " << k);
      const auto other = scaled(*set, k);
      const RenderedView out = picture(way, other, default_viewpoint(other->lf, 1.2 * k, 0.7 * k, 0.3 * k),
                                       options_of(0.5 / k, 4 / k, 8));
      CHECK(psnr(one.colour, out.colour) > 60);
      CHECK(agreement(one.plane, out.plane) > 0.998);
    }
  }
}

TEST_CASE("stress: a viewpoint on a camera, on a lattice line, just beside it, far outside") {
  const auto set = make_views({.rows = 4, .cols = 4, .width = 60, .height = 50});
  set->lf.type = PixelType::f32;
  paint_plane(*set, 2, waves);
  const RenderOptions options = options_of(0, 4, 9);
  for (const Way& way : kWays) {
    INFO(name_of(way));
    // On a camera the normal filter is that camera, whatever the plane.
    const RenderedView on = picture(way, set, default_viewpoint(set->lf, 2, 1), options);
    CHECK(psnr(on.colour, set->pixels[6].colour) > 90);
    for (const auto& [s, t] : {std::pair(1.5, 1.0), std::pair(2.0, 1.3), std::pair(2.0, 1.0)}) {
      const RenderedView line = picture(way, set, default_viewpoint(set->lf, s, t), options);
      for (const double e : {1e-12, -1e-12, 1e-7}) {
        INFO(s << "," << t << " and " << e);
        const RenderedView beside = picture(way, set, default_viewpoint(set->lf, s + e, t + e), options);
        CHECK(psnr(line.colour, beside.colour) > 50);
      }
    }
    for (const double far : {30.0, 1e4, 1e9, 1e15}) {
      const RenderedView out = picture(way, set, default_viewpoint(set->lf, far, -far), options);
      CHECK(*std::max_element(out.confidence.data.begin(), out.confidence.data.end()) == 0);
    }
    const RenderedView nobody = picture(way, set, default_viewpoint(set->lf, 1e9, 1e9), options_of(1, 4, 5));
    CHECK(*std::max_element(nobody.plane.data.begin(), nobody.plane.data.end()) == -1);
    CHECK(*std::max_element(nobody.colour.data.begin(), nobody.colour.data.end()) == 0);
  }
}

TEST_CASE("stress: where no camera has a pixel, weights sum to zero: black, plane -1, confidence 0") {
  const auto set = make_views({.rows = 3, .cols = 3, .width = 60, .height = 50});
  paint_plane(*set, 2, waves);
  // Missing in every view, wide enough for every plane.
  for (ViewPixels& pixels : set->pixels) {
    pixels.mask = Mask(60, 50, 1, 255);
    for (int y = 0; y < 50; ++y)
      for (int x = 0; x < 40; ++x) pixels.mask.at(x, y) = 0;
  }
  for (const Way& way : kWays) {
    INFO(name_of(way));
    const RenderedView out = picture(way, set, default_viewpoint(set->lf, 1.4, 0.6), options_of(0, 4, 5));
    for (int y = 0; y < 50; ++y)
      for (int x = 0; x < 30; ++x) {
        REQUIRE(out.plane.at(x, y) == -1);
        REQUIRE(out.colour.at(x, y) == 0);
        REQUIRE(out.confidence.at(x, y) == 0);
      }
    CHECK(out.plane.at(52, 25) >= 0);
  }
}

TEST_CASE("stress: one plane, M = 0, M larger than the picture, 1x1 and odd sizes") {
  for (const auto& [width, height] :
       {std::pair(1, 1), std::pair(1, 37), std::pair(131, 1), std::pair(23, 17)}) {
    const auto set = make_views({.rows = 3, .cols = 3, .width = width, .height = height});
    paint_plane(*set, 1, waves);
    const Viewpoint view = default_viewpoint(set->lf, 1.3, 0.8);
    for (const int planes : {1, 4})
      for (const int window : {0, 1, 1000, 1000000000}) {
        const RenderOptions options = options_of(-1, 2, planes, window);
        const RenderedView literal = picture(kLiteral, set, view, options);
        for (const Way& way : kWays) {
          INFO(name_of(way) << " " << width << "x" << height << " N " << planes << " M " << window);
          const RenderedView out = picture(way, set, view, options);
          CHECK(psnr(literal.colour, out.colour) > 60);
          CHECK(agreement(literal.plane, out.plane) == 1);
        }
      }
  }
}

TEST_CASE("stress: 1e4 beside 1e-4") {
  const auto set = make_views({.rows = 3, .cols = 3, .width = 120, .height = 50});
  paint_plane(*set, 2, waves);
  set->lf.type = PixelType::f32;
  // Bright on the left of the scene's plane, dim on the right.
  for (std::size_t i = 0; i < set->cameras.size(); ++i)
    for (int y = 0; y < 50; ++y)
      for (int x = 0; x < 120; ++x)
        set->pixels[i].colour.at(x, y) *= x + 2 * set->cameras[i].s < 60 ? 1e4F : 1e-4F;
  const RenderOptions options = options_of(0, 4, 5);
  const Viewpoint view = default_viewpoint(set->lf, 1.3, 0.8);
  const RenderedView literal = picture(kLiteral, set, view, options);
  for (const Way& way : kWays) {
    INFO(name_of(way));
    const RenderedView out = picture(way, set, view, options);
    int wrong = 0, far_off = 0;
    for (int y = 8; y < 42; ++y)
      for (int x = 12; x < 108; ++x) {
        if (std::abs(x + 2 * view.s - 60) < 12) continue;
        wrong += out.plane.at(x, y) != 2 ? 1 : 0;
        far_off += std::abs(out.colour.at(x, y) / literal.colour.at(x, y) - 1) > 1e-4 ? 1 : 0;
      }
    CHECK(wrong == 0);
    CHECK(far_off == 0);
  }
}

TEST_CASE("stress: constant, NaN and Inf pixels") {
  const auto set = make_views({.rows = 3, .cols = 3, .width = 60, .height = 50});
  set->lf.type = PixelType::f32;
  paint_constant(*set, 0.25F);
  const RenderOptions options = options_of(0, 4, 5);
  const Viewpoint view = default_viewpoint(set->lf, 1.3, 0.8);
  for (const Way& way : kWays) {
    INFO(name_of(way));
    const RenderedView flat = picture(way, set, view, options);
    for (std::size_t i = 0; i < flat.colour.data.size(); ++i)
      if (flat.plane.data[i] >= 0) REQUIRE(flat.colour.data[i] == Approx(0.25));
  }
  // Whole views that are gone, and single pixels: read from the set's source, as from files.
  auto broken = std::make_shared<ViewSet>(*set);
  broken->pixels.clear();
  paint_plane(*set, 2, waves);
  broken->source = [set](int camera, int x, int y, int width, int height) {
    ViewPixels out{ImageF(width, height, 1), Mask(width, height, 1, 255)};
    for (int j = 0; j < height; ++j)
      for (int i = 0; i < width; ++i) {
        const bool gone = camera == 4 || (x + i) * 7 % 11 == (y + j) * 3 % 11;
        out.colour.at(i, j) =
            gone ? 0 : set->pixels[static_cast<std::size_t>(camera)].colour.at(x + i, y + j);
        if (gone) out.mask.at(i, j) = 0;
      }
    return out;
  };
  for (const Way& way : kWays) {
    if (way.method == Method::literal) continue;  // wants all in memory
    INFO(name_of(way));
    const RenderedView out = picture(way, broken, view, options);
    const RenderedView whole = picture(way, set, view, options);
    int off = 0;
    for (int y = 10; y < 40; ++y)
      for (int x = 10; x < 50; ++x)
        off +=
            out.plane.at(x, y) >= 0 && std::abs(out.colour.at(x, y) - whole.colour.at(x, y)) > 0.15 ? 1 : 0;
    CHECK(off < 0.05 * 30 * 40);
  }
}

TEST_CASE("stress: sums over windows do not drift over 1e5 rows") {
  constexpr int kWidth = 16, kRows = 100000, M = 7;
  constexpr int kIn = kWidth + 2 * M + 64;  // vectors reach over the end of a row
  std::vector<float> in(static_cast<std::size_t>(kIn) * (kRows + 2 * M));
  // Rows of 1e4 come by once in a while: what a sliding sum would carry on to the end.
  for (int y = 0; y < kRows + 2 * M; ++y)
    for (int x = 0; x < kIn; ++x)
      in[static_cast<std::size_t>(y) * kIn + x] = waves(x, y) * (y / 40 % 50 == 3 ? 1e4F : 1e-4F);
  const std::vector<float> values = in;
  std::vector<float> out(static_cast<std::size_t>(kWidth) * kRows), scratch;
  kernels::sum_rows(in.data(), kIn, kWidth, kRows + 2 * M, M, scratch);
  kernels::sum_columns(in.data(), kIn, kWidth, kRows, M, out.data(), kWidth);
  double worst = 0;
  for (int y = 0; y < kRows; y += y < kRows - 1000 ? 997 : 1)
    for (int x = 0; x < kWidth; ++x) {
      double sum = 0;
      for (int j = 0; j <= 2 * M; ++j)
        for (int i = 0; i <= 2 * M; ++i) sum += values[static_cast<std::size_t>(y + j) * kIn + x + i];
      worst = std::max(worst, std::abs(out[static_cast<std::size_t>(y) * kWidth + x] / sum - 1));
    }
  CHECK(worst < 1e-5);
}

TEST_CASE("stress: a picture of 1e5 rows has the costs of a short one") {
  const auto tall = make_views({.rows = 2, .cols = 2, .width = 12, .height = 100000});
  const auto low = make_views({.rows = 2, .cols = 2, .width = 12, .height = 200});
  // The same texture every 200 rows.
  const auto paint = [](ViewSet& set) {
    for (std::size_t i = 0; i < set.cameras.size(); ++i)
      for (int y = 0; y < set.lf.height; ++y)
        for (int x = 0; x < set.lf.width; ++x)
          set.pixels[i].colour.at(x, y) = waves(x + 2 * set.cameras[i].s, y % 200 + 2 * set.cameras[i].t);
  };
  paint(*tall);
  paint(*low);
  const RenderOptions options = options_of(0, 4, 3);
  for (const Way& way : kWays) {
    INFO(name_of(way));
    const RenderedView a = picture(way, tall, default_viewpoint(tall->lf, 0.5, 0.4), options);
    const RenderedView b = picture(way, low, default_viewpoint(low->lf, 0.5, 0.4), options);
    int other = 0;
    double off = 0;
    for (int y = 20; y < 180; ++y)
      for (int x = 0; x < 12; ++x) {
        other += a.plane.at(x, 99800 + y) != b.plane.at(x, y) ? 1 : 0;
        off = std::max<double>(off, std::abs(a.colour.at(x, 99800 + y) - b.colour.at(x, y)));
      }
    CHECK(other <= 2);
    CHECK(off < (other > 0 ? 0.2 : 1e-4));
  }
}

TEST_CASE("stress: of equal costs the farther plane, every time") {
  const auto set = make_views({.rows = 3, .cols = 3, .width = 160, .height = 130});
  paint_constant(*set, 0.5F);
  RenderOptions options = options_of(-1, 1, 3);
  for (const Way& way : kWays) {
    INFO(name_of(way));
    const Viewpoint view = default_viewpoint(set->lf, 1.5, 0.5);
    const RenderedView out = picture(way, set, view, options);
    for (int y = 12; y < 118; ++y)
      for (int x = 12; x < 148; ++x) REQUIRE(out.plane.at(x, y) == 0);
    CHECK(picture(way, set, view, options).plane.data == out.plane.data);
  }
  // Stripes that repeat every 4 px: planes that are 4 px apart are equally sharp.
  for (std::size_t i = 0; i < set->cameras.size(); ++i)
    for (int y = 0; y < 130; ++y)
      for (int x = 0; x < 160; ++x) set->pixels[i].colour.at(x, y) = x % 4 < 2 ? 0.25F : 0.75F;
  options = options_of(0, 8, 3);
  const RenderedView literal = picture(kLiteral, set, default_viewpoint(set->lf, 1.5, 0.5), options);
  for (const Way& way : kWays) {
    INFO(name_of(way));
    const RenderedView out = picture(way, set, default_viewpoint(set->lf, 1.5, 0.5), options);
    // At the border `fast` may look at fewer planes than are there.
    if (way.method != Method::fast) CHECK(agreement(out.plane, literal.plane) > 0.99);
    for (int y = 30; y < 100; ++y)
      for (int x = 30; x < 130; ++x) REQUIRE(out.plane.at(x, y) == 0);
  }
}
