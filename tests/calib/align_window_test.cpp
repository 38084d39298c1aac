#include "calib/two_view/align_window.h"

#include <cmath>

#include "tests/support/support.h"

using namespace stuv;

namespace {

/// A texture of many directions that can be evaluated anywhere.
double texture(const Eigen::Vector2d& p, int seed) {
  double sum = 0;
  for (int k = 1; k <= 12; ++k) {
    const double angle = 2.4 * k + seed, wave = 0.15 + 0.05 * (k % 7);
    sum += std::sin(wave * (std::cos(angle) * p.x() + std::sin(angle) * p.y()) + 1.7 * k * seed);
  }
  return 0.5 + 0.03 * sum;
}

/// gain * texture + offset where (x, y) = c + A d shows the texture's place 60 + d, so that c is the place of
/// (60, 60).
ImageF warped(const WindowPlace& place, double gain, double offset, int seed) {
  ImageF out(120, 120, 1);
  const Eigen::Matrix2d inverse = place.A.inverse();
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 120; ++x) {
      const Eigen::Vector2d d = inverse * (Eigen::Vector2d(x, y) - place.centre_px);
      out.at(x, y) = static_cast<float>(gain * texture(Eigen::Vector2d(60, 60) + d, seed) + offset);
    }
  return out;
}

}  // namespace

TEST_CASE(
    "a window is found to a hundredth of a pixel, sheared, brighter, and from a pixel and a half away") {
  for (int seed = 1; seed <= 10; ++seed) {
    const ImageF a = warped({{60, 60}, Eigen::Matrix2d::Identity()}, 1, 0, seed);
    WindowPlace truth{{57.3 + 0.07 * seed, 62.8 - 0.11 * seed}, Eigen::Matrix2d::Identity()};
    truth.A << 1.05, 0.08, -0.03, 0.96;
    const ImageF b = warped(truth, 0.7, 0.1, seed);
    const auto window = Window::at(a, 60, 60, 0.003, 0.1);
    REQUIRE(window);
    WindowPlace start = truth;
    start.centre_px += Eigen::Vector2d(1.2, -0.9);
    start.A.setIdentity();
    const auto found = window->find(b, start, {});
    INFO("seed " << seed);
    REQUIRE(found);
    CHECK((found->place.centre_px - truth.centre_px).norm() < 0.02);
    CHECK((found->place.A - truth.A).norm() < 0.02);
    CHECK(found->ncc > 0.99);
    CHECK(found->sigma_px < 0.02);
  }
}

TEST_CASE("no window without texture, and none found where it is not") {
  const WindowPlace here{{60, 60}, Eigen::Matrix2d::Identity()};
  const ImageF a = warped(here, 1, 0, 1), other = warped(here, 1, 0, 2), flat(120, 120, 1, 0.5F);
  CHECK_FALSE(Window::at(flat, 60, 60, 0.003, 0.1));
  CHECK_FALSE(Window::at(a, 5, 60, 0.003, 0.1));
  ImageF edge(120, 120, 1);  // a place along it is anyone's guess
  for (int y = 0; y < 120; ++y)
    for (int x = 0; x < 120; ++x) edge.at(x, y) = x < 60 ? 0.2F : 0.8F;
  CHECK_FALSE(Window::at(edge, 60, 60, 0.003, 0.1));
  const auto window = Window::at(a, 60, 60, 0.003, 0.1);
  REQUIRE(window);
  CHECK_FALSE(window->find(other, here, {}));
  CHECK_FALSE(window->find(flat, here, {}));
  CHECK_FALSE(window->find(a, {{4, 60}, Eigen::Matrix2d::Identity()}, {}));
}
