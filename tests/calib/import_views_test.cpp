#include "calib/interchange/import_views.h"

#include <fmt/format.h>

#include <cmath>

#include "core/error.h"
#include "core/image_io.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;

namespace {

LightField with_positions(const std::vector<std::pair<double, double>>& st) {
  LightField lf;
  for (std::size_t i = 0; i < st.size(); ++i) {
    View view;
    view.name = std::to_string(i);
    view.s = st[i].first;
    view.t = st[i].second;
    lf.views.push_back(view);
  }
  return lf;
}

void write_views(const test::TempFolder& folder, const std::vector<std::string>& names, int width = 20) {
  for (const std::string& name : names)
    write_image(folder / name, from_float(ImageF(width, 10, 3, 0.5F), PixelType::u8));
}

}  // namespace

TEST_CASE("lattices are found: jittered grid, row with jitter across, column, holes, one view") {
  std::vector<std::pair<double, double>> st;
  for (int row = 0; row < 3; ++row)
    for (int col = 0; col < 5; ++col)
      st.emplace_back(2.0 * col + 0.2 * std::sin(row + 7.0 * col),
                      2.5 * row + 0.2 * std::cos(3.0 * row + col));
  LightField grid = with_positions(st);
  place_on_lattice(grid, "x");
  CHECK(grid.rows == 3);
  CHECK(grid.cols == 5);
  CHECK(grid.views[7].row == 1);
  CHECK(grid.views[7].col == 2);

  LightField row = with_positions({{0, 0.1}, {3, -0.1}, {1, 0.2}, {2, 0}});
  place_on_lattice(row, "x");
  CHECK(row.rows == 1);
  CHECK(row.cols == 4);
  CHECK(row.views[1].col == 3);

  LightField column = with_positions({{0.1, 0}, {0, 1e-6}});
  CHECK_NOTHROW(place_on_lattice(column, "x"));

  LightField hole = with_positions({{0, 0}, {1, 0}, {2, 0}, {0, 1}, {2, 1}, {0, 2}, {1, 2}, {2, 2}});
  place_on_lattice(hole, "x");
  CHECK(hole.views[4].row == 1);
  CHECK(hole.views[4].col == 2);

  LightField one = with_positions({{5, 5}});
  place_on_lattice(one, "x");
  CHECK(one.rows == 1);
  CHECK(one.cols == 1);

  LightField twice = with_positions({{0, 0}, {1, 0}, {1, 0}});
  CHECK_THROWS_WITH(place_on_lattice(twice, "list"), Contains("list") && Contains("share one place"));
}

TEST_CASE("views.csv is read, and its mistakes are named by line") {
  const test::TempFolder folder;
  const auto csv = folder / "views.csv";
  write_text(csv, "file,s,t,role\na.png,0.5,-1,input\nb.png,1e-1,2,truth\n");
  const auto views = list_views(folder.path(), ViewLayout::csv);
  REQUIRE(views.size() == 2);
  CHECK(views[0].file == folder / "a.png");
  CHECK(views[1].s == 0.1);
  CHECK(views[1].role == ViewRole::truth);
  for (const char* line : {"a.png,1,2", "a.png,x,2,input", "a.png,1,nan,input", "a.png,1,2,output"}) {
    write_text(csv, std::string("file,s,t,role\nb.png,0,0,input\n") + line + "\n");
    CHECK_THROWS_WITH(list_views(csv, ViewLayout::csv), Contains("views.csv:3"));
  }
  write_text(csv, "s,t,file\n");
  CHECK_THROWS_WITH(list_views(csv, ViewLayout::csv), Contains("views.csv:1"));
  write_text(csv, "file,s,t,role\na.png,0,0,truth\n");
  CHECK_THROWS_WITH(list_views(csv, ViewLayout::csv), Contains("no input view"));
}

TEST_CASE("Stanford and HCI names give positions") {
  const test::TempFolder folder;
  write_views(folder, {"out_00_01_-381.909271_1103.376221_.png", "out_00_00_-380_1100.png",
                       "input_Cam000.png", "input_Cam040.png"});
  const auto stanford = list_views(folder.path(), ViewLayout::stanford);
  REQUIRE(stanford.size() == 2);
  CHECK(stanford[1].s == Approx(1.103376221));
  CHECK(stanford[1].t == Approx(-0.381909271));
  const auto hci = list_views(folder.path(), ViewLayout::hci);
  REQUIRE(hci.size() == 2);
  CHECK(hci[0].s == -4);
  CHECK(hci[0].t == -4);
  CHECK(hci[1].s == 0);
  CHECK(hci[1].t == 0);
}

TEST_CASE("an import is a light field with metres only where it can have them") {
  const test::TempFolder folder;
  write_views(folder, {"a.png", "b.png", "c.png"});
  write_text(folder / "views.csv", "file,s,t,role\na.png,0,0,input\nb.png,1,0,input\nc.png,0.5,0,truth\n");
  std::filesystem::create_directory(folder / "scene");
  ImportOptions options;
  const LightField plain = import_views(folder / "views.csv", folder / "scene", options, {});
  CHECK_FALSE(plain.metric);
  CHECK_FALSE(plain.has_range());
  CHECK(plain.views[1].cx_px == 9.5);
  options.focal_px = 100;
  options.converge_m = 4;
  options.d_min = -5;
  options.d_max = 5;
  import_views(folder / "views.csv", folder / "scene", options, {});
  const LightField lf = open_light_field(folder / "scene");
  CHECK(lf.metric);
  CHECK(lf.convergence_px == 25);
  CHECK(lf.views[1].cx_px - lf.views[0].cx_px == Approx(25));
  CHECK(lf.views[2].cx_px == Approx(9.5));
  CHECK(lf.d_max == 5);
}

TEST_CASE("views that do not fit together are named") {
  const test::TempFolder folder;
  write_views(folder, {"a.png"});
  write_views(folder, {"b.png"}, 21);
  write_text(folder / "views.csv", "file,s,t,role\na.png,0,0,input\nb.png,1,0,input\n");
  std::filesystem::create_directory(folder / "scene");
  CHECK_THROWS_WITH(import_views(folder / "views.csv", folder / "scene", {}, {}),
                    Contains("b.png") && Contains("21x10"));
  write_text(folder / "views.csv", "file,s,t,role\na.png,0,0,input\nc.png,1,0,input\n");
  CHECK_THROWS_WITH(import_views(folder / "views.csv", folder / "scene", {}, {}), Contains("c.png"));
  CHECK_FALSE(std::filesystem::exists(folder / "scene/lightfield.json"));
}
