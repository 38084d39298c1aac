#include "render/lattice_chart.h"

#include <map>

#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

namespace {

std::map<std::string, double> weights_at(const ViewSet& set, Filter filter, double col, double row) {
  std::vector<CameraWeight> weights;
  LatticeFilter(set.lf.rows, set.lf.cols, set.cameras, filter).weights({col, row}, weights);
  std::map<std::string, double> out;
  for (const CameraWeight& w : weights) out[set.cameras[static_cast<std::size_t>(w.camera)].name] = w.weight;
  return out;
}

}  // namespace

TEST_CASE("The ray through a displaced camera's centre has that camera's place on the lattice") {
  const auto set = make_views({.rows = 4, .cols = 5, .jitter = 0.2, .off_plane = 0.2});
  const LatticeChart chart(4, 5, set->cameras);
  for (const View& c : set->cameras) {
    for (const double z : {0.0, 0.5, -2.0}) {
      const double gx = 0.3, gy = -0.2;
      const Eigen::Vector2d p = chart.position({c.s + (z - c.w) * gx, c.t + (z - c.w) * gy, z}, gx, gy);
      CHECK(p.x() == Approx(c.col).margin(1e-6));
      CHECK(p.y() == Approx(c.row).margin(1e-6));
    }
  }
}

TEST_CASE("Filters on a full row are the tents of figure 7") {
  const auto set = make_views({.rows = 1, .cols = 7});
  const auto normal = weights_at(*set, Filter::normal, 2.25, 0);
  CHECK(normal.at("0_2") == Approx(0.75));
  CHECK(normal.at("0_3") == Approx(0.25));
  CHECK(normal.size() == 2);
  const auto wide = weights_at(*set, Filter::wide, 2.5, 0);  // tents 0.25 0.75 0.75 0.25
  CHECK(wide.at("0_1") == Approx(0.125));
  CHECK(wide.at("0_2") == Approx(0.375));
  CHECK(wide.at("0_4") == Approx(0.125));
  const auto skipped = weights_at(*set, Filter::skipped, 2.5, 0);
  CHECK(skipped.at("0_2") == Approx(0.75));
  CHECK(skipped.at("0_4") == Approx(0.25));
  CHECK(skipped.size() == 2);
}

TEST_CASE("Along a row a tent reaches to the next present camera") {
  const auto set = make_views({.rows = 1, .cols = 6, .holes = {{0, 2}, {0, 3}}});
  for (const double p : {1.3, 2.0, 2.9, 3.5}) {
    const auto normal = weights_at(*set, Filter::normal, p, 0);
    CHECK(normal.at("0_1") == Approx((4 - p) / 3));
    CHECK(normal.at("0_4") == Approx((p - 1) / 3));
  }
  // Thinned to 0, (2), 4: the hole at 2 is bridged from 0 to 4.
  const auto skipped = weights_at(*set, Filter::skipped, 1, 0);
  CHECK(skipped.at("0_0") == Approx(0.75));
  CHECK(skipped.at("0_4") == Approx(0.25));
}

TEST_CASE("At the place of a missing camera of a row the three filters differ") {
  for (int hole = 1; hole < 8; ++hole) {
    const auto set = make_views({.rows = 1, .cols = 9, .jitter = 0.05, .holes = {{0, hole}}});
    drop_empty_lines(*set);
    CHECK(set->lf.cols == 8);
    const LatticeChart chart(set->lf.rows, set->lf.cols, set->cameras);
    const double p = chart.position({double(hole), 0, 0}, 0, 0).x();
    CHECK(p > hole - 1);
    CHECK(p < hole);
    const auto normal = weights_at(*set, Filter::normal, p, 0);
    CHECK(normal.size() == 2);
    CHECK(weights_at(*set, Filter::wide, p, 0).size() > 2);
    CHECK(weights_at(*set, Filter::skipped, p, 0) != normal);
  }
}

TEST_CASE("Places are found on rows of very uneven spacing") {
  auto set = make_views({.rows = 1, .cols = 12, .holes = {{0, 3}, {0, 4}, {0, 5}, {0, 6}, {0, 9}}});
  drop_empty_lines(*set);
  const LatticeChart chart(set->lf.rows, set->lf.cols, set->cameras);
  for (std::size_t i = 0; i + 1 < set->cameras.size(); ++i) {
    const View &a = set->cameras[i], &b = set->cameras[i + 1];
    for (const double part : {0.0, 0.3, 0.9}) {
      const Eigen::Vector2d p = chart.position({a.s + part * (b.s - a.s), 0, 0}, 0, 0);
      CHECK(p.x() == Approx(a.col + part).margin(1e-9));
    }
  }
}

TEST_CASE("Weights add up to 1 everywhere, holes and outside included") {
  const auto set = make_views({.rows = 4, .cols = 5, .holes = {{0, 0}, {2, 2}, {2, 3}, {3, 4}, {0, 4}}});
  for (const Filter filter : {Filter::normal, Filter::wide, Filter::skipped}) {
    for (double row = -2; row < 6; row += 0.37) {
      for (double col = -2; col < 7; col += 0.29) {
        double sum = 0;
        for (const auto& [name, weight] : weights_at(*set, filter, col, row)) {
          CHECK(weight > 0);
          sum += weight;
        }
        CHECK(sum == Approx(1));
      }
    }
  }
}

TEST_CASE("Beside a row of cameras the hull ends one spacing off; a single camera is its own hull") {
  const auto inside = [](const ViewSet& set, double s, double t) {
    const LatticeChart chart(set.lf.rows, set.lf.cols, set.cameras);
    return chart.inside_hull(chart.position({s, t, 0}, 0, 0));
  };
  auto row = make_views({.rows = 1, .cols = 5, .jitter = 0.02});
  auto column = make_views({.rows = 5, .cols = 1, .jitter = 0.02});
  for (const double off : {0.0, 0.9, -0.9, 1.2, -1.2, 40.0}) {
    CHECK(inside(*row, 2.3, off) == (std::abs(off) < 1));
    CHECK(inside(*column, off, 2.3) == (std::abs(off) < 1));
  }
  CHECK_FALSE(inside(*row, 4.2, 0));
  // Off the row the place along it stays, but for the jitter's tilt of the row.
  const LatticeChart chart(1, 5, row->cameras);
  CHECK(chart.position({2.3, 0.7, 0}, 0, 0).x() ==
        Approx(chart.position({2.3, 0, 0}, 0, 0).x()).margin(0.01));
  const auto one = make_views({.rows = 1, .cols = 1});
  CHECK(inside(*one, one->cameras[0].s, one->cameras[0].t));
  CHECK_FALSE(inside(*one, one->cameras[0].s + 0.1, one->cameras[0].t));
}
