#include "render/pixel_store.h"

#include <atomic>
#include <thread>

#include "render/renderer.h"
#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

namespace {

std::uint8_t value_at(int camera, int x, int y) {
  return static_cast<std::uint8_t>(camera * 31 + x * 3 + y * 7);
}

/// A grid of cameras whose pixels are made when they are read; `read` counts them.
std::shared_ptr<ViewSet> made_on_demand(int side, int width, int height, std::atomic<std::size_t>& read) {
  auto set = make_views({.rows = side, .cols = side, .width = 2, .height = 2});
  set->pixels.clear();
  LightField& lf = set->lf;
  lf.width = width;
  lf.height = height;
  lf.channels = 3;
  lf.cx0_px = (width - 1) / 2.0;
  lf.cy0_px = (height - 1) / 2.0;
  for (View& view : set->cameras) view.cx_px = lf.cx0_px, view.cy_px = lf.cy0_px;
  lf.views = set->cameras;
  set->source = [&read](int camera, int x0, int y0, int w, int h) {
    ViewPixels out{ImageF(w, h, 3), {}};
    for (int y = 0; y < h; ++y)
      for (int x = 0; x < w; ++x)
        for (int c = 0; c < 3; ++c)
          out.colour.at(x, y, c) = static_cast<float>(value_at(camera, x0 + x, y0 + y)) / 255.0F;
    read += static_cast<std::size_t>(w) * h;
    return out;
  };
  return set;
}

bool is_right(const StoredView& view, int camera, const PixelRect& rect) {
  for (int y = rect.y0; y < rect.y1; ++y)
    for (int x = rect.x0; x < rect.x1; ++x)
      if (view.plane<std::uint8_t>(2)[y * view.width + x] != value_at(camera, x, y)) return false;
  return true;
}

}  // namespace

TEST_CASE("pixel store: only tiles that are asked for are read, and once") {
  std::atomic<std::size_t> read = 0;
  PixelStore store(made_on_demand(3, 150, 100, read));
  CHECK(store.tiles_total() == 9 * 3 * 2);
  const auto view = store.acquire(4, {60, 10, 70, 20});
  CHECK(is_right(*view, 4, {60, 10, 70, 20}));
  CHECK(store.tiles_read() == 2);
  CHECK(read == 2 * 64 * 64);
  store.acquire(4, {0, 0, 128, 64});
  CHECK(store.tiles_read() == 2);
  // Beyond the picture there is nothing to read.
  CHECK(is_right(*store.acquire(4, {-50, -50, 1000, 1000}), 4, {0, 0, 150, 100}));
  CHECK(store.tiles_read() == 6);
  CHECK(read == 150 * 100);
}

TEST_CASE("pixel store: what was not used for longest is dropped, what is held stays") {
  std::atomic<std::size_t> read = 0;
  constexpr int kWidth = 128, kHeight = 64;
  constexpr std::size_t kView = kWidth * kHeight * 3;
  PixelStore store(made_on_demand(3, kWidth, kHeight, read), 3 * kView);
  const PixelRect all{0, 0, kWidth, kHeight};
  const auto held = store.acquire(0, all);
  for (int camera = 1; camera < 9; ++camera) store.acquire(camera, all);
  CHECK(store.tiles_read() == 9 * 2);
  CHECK(is_right(*held, 0, all));
  store.acquire(0, all);  // held: still there
  store.acquire(8, all);  // used last: still there
  CHECK(store.tiles_read() == 9 * 2);
  CHECK(is_right(*store.acquire(1, all), 1, all));  // dropped: read again
  CHECK(store.tiles_read() == 10 * 2);
  // A budget below one view still works, one view at a time.
  PixelStore small(store.shared_views(), 1);
  for (int round = 0; round < 2; ++round)
    for (int camera = 0; camera < 9; ++camera) CHECK(is_right(*small.acquire(camera, all), camera, all));
}

TEST_CASE("pixel store: many threads, little memory, right pixels") {
  std::atomic<std::size_t> read = 0;
  PixelStore store(made_on_demand(4, 200, 130, read), 200 * 130 * 3 * 2);
  std::atomic<int> wrong = 0;
  std::vector<std::thread> threads;
  for (int t = 0; t < 8; ++t)
    threads.emplace_back([&, t] {
      unsigned state = 12345U + static_cast<unsigned>(t);
      for (int i = 0; i < 300; ++i) {
        state = state * 1664525U + 1013904223U;
        const int camera = static_cast<int>(state >> 28), x = static_cast<int>(state >> 8 & 127);
        const int y = static_cast<int>(state >> 15 & 63);
        const PixelRect rect{x, y, x + 60, y + 50};
        if (!is_right(*store.acquire(camera, rect), camera, rect)) ++wrong;
      }
    });
  for (std::thread& thread : threads) thread.join();
  CHECK(wrong == 0);
}

TEST_CASE("Views larger than memory: of 27x27 views one viewpoint reads what its rays reach") {
  std::atomic<std::size_t> read = 0;
  const auto set = made_on_demand(27, 320, 240, read);
  RenderOptions options;
  options.planes = 3;
  options.window = 1;
  options.d_min = -4;
  options.d_max = 4;
  const std::size_t everything = set->cameras.size() * 320 * 240;
  for (const Method method : {Method::exact, Method::fast}) {
    read = 0;
    const RenderedView out = make_renderer(method, Backend::cpu, set)
                                 ->all_in_focus(default_viewpoint(set->lf, 12.4, 13.3), options);
    CHECK(out.plane.at(160, 120) >= 0);
    // 16 of 729 cameras; `fast` looks at them once more for its coarse pass.
    CHECK(read <= everything * (method == Method::exact ? 16 : 32) / 729);
  }
}
