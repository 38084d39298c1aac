#include <chrono>
#include <cmath>
#include <thread>

#include "app/viewer/render_worker.h"
#include "app/viewer/view_controls.h"
#include "core/image_io.h"
#include "render/view_set.h"
#include "tests/render/scenes.h"
#include "tests/support/support.h"
#include "tests/support/virtual_display.h"

using namespace stuv;
using namespace stuv::test;

namespace {

ViewerState state_of(const LightField& lf) {
  ViewerState state;
  const Viewpoint middle = middle_viewpoint(lf);
  state.s = middle.s;
  state.t = middle.t;
  state.options.planes = 5;
  state.options.window = 1;
  state.options.d_min = 0;
  state.options.d_max = 4;
  return state;
}

RenderWorker::Result wait_for(RenderWorker& worker) {
  for (int i = 0; i < 1000; ++i) {
    if (auto result = worker.take()) return *std::move(result);
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  FAIL("no picture within 10 s");
  return {};
}

}  // namespace

TEST_CASE("viewer: the mouse moves the viewpoint, within reach") {
  const LightField lf = make_views({.rows = 3, .cols = 5})->lf;
  ViewerState state = state_of(lf);
  const ViewerReach reach = reach_of(lf, state.options);
  // The scene follows the mouse: to the right is a step to the left.
  drag(state, reach, 0.25, 0);
  CHECK(state.s == Approx(1));
  CHECK(state.t == Approx(1));
  drag(state, reach, 0, -0.5);
  CHECK(state.t == Approx(2));
  drag(state, reach, -100, 100);
  CHECK(state.s == Approx(5));
  CHECK(state.t == Approx(-0.5));
  // f = 40 px: disparity 4 is 10 away.
  step_along_z(state, reach, 1000);
  CHECK(state.z == Approx(9));
  step_along_z(state, reach, -1e9);
  CHECK(state.z == Approx(-10));
  turn(state, reach, -0.1, 0.2);
  const Viewpoint view = viewpoint_of(state, lf, 1);
  const Eigen::Vector3d axis = view.view_from_scene.transpose() * Eigen::Vector3d::UnitZ();
  CHECK(std::atan2(axis.x(), axis.z()) == Approx(0.1));  // right
  CHECK(std::asin(-axis.y()) == Approx(0.2));            // up
  zoom(state, 1e3);
  CHECK(viewpoint_of(state, lf, 1).focal_px == Approx(8 * 40));
  const Viewpoint small = viewpoint_of(state, lf, 4);
  CHECK(small.width == lf.width / 4);
  CHECK(small.focal_px == Approx(2 * 40));
}

TEST_CASE("viewer: rows, single cameras and scenes without metres") {
  LightField row = make_views({.rows = 1, .cols = 5})->lf;
  ViewerState state = state_of(row);
  drag(state, reach_of(row, state.options), 0, 10);
  CHECK(state.t == Approx(-0.25));
  const LightField one = make_views({.rows = 1, .cols = 1})->lf;
  state = state_of(one);
  drag(state, reach_of(one, state.options), 0.1, 0.1);
  CHECK(std::isfinite(state.s));
  row.metric = false;
  state = state_of(row);
  const ViewerReach flat = reach_of(row, state.options);
  step_along_z(state, flat, 5);
  turn(state, flat, 0.1, 0.1);
  CHECK(state.z == 0);
  CHECK(state.yaw == 0);
  CHECK_NOTHROW(validate(viewpoint_of(state, row, 1), row));
}

TEST_CASE("viewer: pictures are made smaller while the mouse moves, as far as needed") {
  CHECK(shrink_for(20, 60) == 1);
  CHECK(shrink_for(200, 60) == 2);
  CHECK(shrink_for(900, 60) == 4);
  CHECK(shrink_for(1e9, 60) == 8);
  CHECK(shrink_for(0, 60) == 1);
}

TEST_CASE("viewer: overlays") {
  RenderedView view;
  view.colour = ImageF(2, 1, 1, 0.5F);
  view.disparity = ImageF(2, 1, 1);
  view.disparity.data = {0, 4};
  view.plane = Raster<int>(2, 1, 1, 0);
  view.confidence = ImageF(2, 1, 1);
  view.confidence.data = {1, 0};
  ViewerState state;
  state.options.d_max = 4;
  CHECK(screen_picture(view, state).data == decltype(Mask::data)(6, 128));
  state.overlay = Overlay::depth;
  const auto depth = screen_picture(view, state);
  CHECK(depth.at(0, 0, 2) > depth.at(0, 0, 0) + 50);  // far: blue
  CHECK(depth.at(1, 0, 0) > depth.at(1, 0, 2) + 50);  // near: red
  state.overlay = Overlay::confidence;
  const auto trust = screen_picture(view, state);
  CHECK(trust.at(0, 0, 1) == 128);
  CHECK(trust.at(1, 0, 1) == 0);
}

TEST_CASE("viewer: of requests that wait the newest is rendered, the picture of its method") {
  const TempFolder folder;
  const LightField lf =
      write_scene(folder / "scene", PixelType::u8, true, {.rows = 4, .cols = 4, .width = 160, .height = 140});
  const LightFieldReader reader(open_light_field(lf.folder));
  RenderWorker worker(reader);
  CHECK(worker.idle());
  ViewerState state = state_of(lf);
  for (int i = 0; i < 20; ++i) {
    state.s = 1 + 0.05 * i;
    worker.submit({state, 1});
  }
  RenderWorker::Result last = wait_for(worker);
  while (last.request.state.s < state.s) last = wait_for(worker);
  CHECK(last.problem.empty());
  CHECK(worker.idle());
  for (const Backend backend : {Backend::cpu, Backend::gl}) {
    state.method = Method::exact;
    state.backend = backend;
    worker.submit({state, 2});
    const RenderWorker::Result exact = wait_for(worker);
    INFO(exact.problem);
    CHECK(exact.view.colour.width == 80);
    const RenderedView same = make_renderer(Method::exact, Backend::cpu, reader)
                                  ->all_in_focus(viewpoint_of(state, reader.light_field(), 2), state.options);
    double off = 0;
    for (std::size_t i = 0; i < same.colour.data.size(); ++i)
      off = std::max<double>(off, std::abs(same.colour.data[i] - exact.view.colour.data[i]));
    CHECK(off < 0.02);
  }
  // A method that was left is made anew.
  state.method = Method::fast;
  state.backend = Backend::cpu;
  worker.submit({state, 4});
  CHECK(wait_for(worker).view.colour.width == 40);
  // What cannot be rendered is said, and the next picture comes all the same.
  state.options.planes = 0;
  worker.submit({state, 1});
  CHECK_FALSE(wait_for(worker).problem.empty());
  state.options.planes = 3;
  worker.submit({state, 1});
  CHECK(wait_for(worker).problem.empty());
}

TEST_CASE("stuv view: without a display one line says what to do") {
  const TempFolder folder;
  const LightField lf = write_scene(folder / "scene", PixelType::u8, true);
  const std::string line = std::string("env -u DISPLAY -u WAYLAND_DISPLAY ") + STUV_PROGRAM + " view " +
                           lf.folder.string() + " --disparity 0,4 2>" + (folder / "err").string();
  CHECK(WEXITSTATUS(std::system(line.c_str())) == 1);
  const std::string said = read_text(folder / "err");
  CHECK(line_count(said) == 1);
  CHECK(said.find("xvfb-run") != std::string::npos);
  CHECK(run_stuv("view " + lf.folder.string() + " --method fast --backend gl").exit_code == 2);
}

TEST_CASE("stuv view: a picture that cannot be made is an error once the window closes by itself") {
  const VirtualDisplay display;
  if (!display.prefix()) STUV_SKIP("Xvfb does not start");
  const TempFolder folder;
  const LightField lf = write_scene(folder / "scene", PixelType::u8, true);
  // Mesa then has OpenGL 3.3 for the window, and no 4.5 for the renderer.
  const std::string line = *display.prefix() + "MESA_GL_VERSION_OVERRIDE=3.3 timeout 100 " + STUV_PROGRAM +
                           " view " + lf.folder.string() +
                           " --disparity 0,4 --method exact --backend gl --frames 2 2>" +
                           (folder / "said").string();
  CHECK(WEXITSTATUS(std::system(line.c_str())) == 1);
  const std::string said = read_text(folder / "said");
  INFO(said);
  CHECK(said.find("--backend cpu") != std::string::npos);
}

TEST_CASE("stuv view: opens under Xvfb and shows the picture beside its switches") {
  const VirtualDisplay display;
  if (!display.prefix()) STUV_SKIP("Xvfb does not start");
  const TempFolder folder;
  const LightField lf =
      write_scene(folder / "scene", PixelType::u8, true, {.rows = 4, .cols = 4, .width = 160, .height = 140});
  const auto shot = [&](const std::string& flags) {
    const auto file = folder / "shot.png";
    const std::string line =
        *display.prefix() + "timeout 100 " + STUV_PROGRAM + " view " + lf.folder.string() +
        " --disparity 0,4 --planes 5 --frames 3 --force --screenshot " + file.string() + " " + flags;
    REQUIRE(std::system(line.c_str()) == 0);
    return to_float(read_image(file));
  };
  constexpr int kPanel = 360;
  const auto spread = [](const ImageF& image, int x0, int x1) {
    double sum = 0, squares = 0, n = 0;
    for (int y = 60; y < image.height - 60; ++y)
      for (int x = x0; x < x1; ++x) {
        sum += image.at(x, y);
        squares += image.at(x, y) * image.at(x, y);
        ++n;
      }
    return std::sqrt(squares / n - sum / n * sum / n);
  };
  const ImageF plain = shot("--method fast"), exact = shot("--method exact --backend gl");
  REQUIRE(plain.width > kPanel + 160);
  CHECK(spread(plain, 0, kPanel - 10) > 0.02);  // text and switches
  CHECK(spread(plain, kPanel + 60, plain.width - 60) > 0.05);
  // Grey texture without the overlay, coloured with it; the same picture by either method.
  const ImageF depth = shot("--method exact --overlay depth");
  const int x = (kPanel + plain.width) / 2, y = plain.height / 2;
  CHECK(plain.at(x, y, 0) == plain.at(x, y, 2));
  CHECK(std::abs(plain.at(x, y, 0) - exact.at(x, y, 0)) < 0.03);
  CHECK(std::abs(depth.at(x, y, 0) - depth.at(x, y, 2)) + std::abs(depth.at(x, y, 1) - depth.at(x, y, 2)) >
        0.1);
}
