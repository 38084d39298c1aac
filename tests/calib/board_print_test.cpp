#include <cmath>

#include "calib/board/detect.h"
#include "calib/board/print.h"
#include "core/error.h"
#include "core/image_io.h"
#include "core/json.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;
namespace fs = std::filesystem;

namespace {

constexpr double kDpi = 120;

/// The page as a picture, by a program that knows nothing of us. (pdftoppm shades edges to a quarter of a
/// pixel only, and shifts all by 0.2 px.)
fs::path rasterised(const fs::path& page) {
  fs::path picture = page;
  picture.replace_extension(page.extension().string() + ".png");
  const std::string dpi = std::to_string(kDpi);
  fs::path stem = picture;
  stem.replace_extension();
  const std::string line =
      page.extension() == ".pdf"
          ? "pdftocairo -singlefile -png -r " + dpi + " " + page.string() + " " + stem.string()
          : "rsvg-convert -d " + dpi + " -p " + dpi + " " + page.string() + " -o " + picture.string();
  REQUIRE(std::system(line.c_str()) == 0);
  return picture;
}

/// Corners are where the exact size says, in pixels of the raster: paper's corner to picture's corner.
void check_geometry(const fs::path& picture, const Board& board, const Json& printed) {
  const Image page = read_image(picture);
  CHECK(page.width == Approx(printed["paper_mm"][0].get<double>() / 25.4 * kDpi).margin(1.5));
  CHECK(page.height == Approx(printed["paper_mm"][1].get<double>() / 25.4 * kDpi).margin(1.5));
  const BoardView view = detect_board(page, board);
  REQUIRE(view.seen() == board.real_corners());
  const std::vector<Eigen::Vector3d> points = board_points(board);
  double worst = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!view.corners_px[i].allFinite()) continue;
    const Eigen::Vector2d paper_mm(printed["origin_mm"][0].get<double>() + 1e3 * points[i].x(),
                                   printed["origin_mm"][1].get<double>() + 1e3 * points[i].y());
    // Pixel (0, 0) is the centre of the first one.
    const Eigen::Vector2d expected = paper_mm / 25.4 * kDpi - Eigen::Vector2d(0.5, 0.5);
    worst = std::max(worst, (view.corners_px[i] - expected).norm());
  }
  INFO("worst corner " << worst << " px of " << kDpi << " dpi");
  CHECK(worst < 0.15);  // 0.03 mm; renderers put edges on whole pixels or shade them
}

}  // namespace

TEST_CASE("printed boards have their exact size and are found as what they are") {
  const test::TempFolder folder;
  const char* specs[] = {"chessboard:9x6:25mm", "charuco:5x7:38mm:28mm:DICT_4X4_50",
                         "charuco:4x6:40mm:30mm:DICT_5X5_100:inverted:legacy", "aprilgrid:4x5:35mm:0.3"};
  int n = 0;
  for (const char* spec : specs)
    for (const char* extension : {".pdf", ".svg"}) {
      INFO(spec << extension);
      const fs::path page = folder / ("board" + std::to_string(n++) + extension);
      const auto run = test::run_stuv("board " + std::string(spec) + " -o " + page.string() + " --json " +
                                      (folder / "b.json").string() + " --force");
      INFO(run.err);
      REQUIRE(run.exit_code == 0);
      check_geometry(rasterised(page), parse_board(spec), read_json(folder / "b.json"));
    }
}

TEST_CASE("paper: the smallest that holds the board, or the one that is asked for") {
  const test::TempFolder folder;
  const auto paper_mm = [&](const std::string& arguments) {
    const auto run = test::run_stuv("board " + arguments + " --force -o " + (folder / "b.pdf").string() +
                                    " --json " + (folder / "b.json").string());
    INFO(run.err);
    REQUIRE(run.exit_code == 0);
    const Json json = read_json(folder / "b.json");
    return std::pair(std::lround(json["paper_mm"][0].get<double>()),
                     std::lround(json["paper_mm"][1].get<double>()));
  };
  using Size = std::pair<long, long>;
  CHECK(paper_mm("chessboard:7x5:20mm") == Size(210, 297));
  CHECK(paper_mm("chessboard:10x6:20mm") == Size(297, 210));
  CHECK(paper_mm("chessboard:9x6:30mm") == Size(420, 297));
  CHECK(paper_mm("chessboard:9x6:30mm --paper A2") == Size(420, 594));
  CHECK(paper_mm("chessboard:9x6:30mm --paper 50x40cm") == Size(500, 400));
  CHECK(paper_mm("chessboard:9x6:30mm --paper 400x500mm") == Size(400, 500));
  // Larger than A0: as large as it has to be.
  CHECK(paper_mm("chessboard:9x6:150mm --margin-mm 20") == Size(1650, 1216));
}

TEST_CASE("a board that does not fit, or a file of no known kind, is refused") {
  const test::TempFolder folder;
  const std::string pdf = (folder / "b.pdf").string();
  const auto small = test::run_stuv("board chessboard:9x6:30mm --paper A4 -o " + pdf);
  CHECK(small.exit_code == 1);
  CHECK_THAT(small.err, Contains("more than the paper's"));
  CHECK(test::line_count(small.err) == 1);
  CHECK_FALSE(fs::exists(pdf));
  CHECK(test::run_stuv("board chessboard:9x6:30mm -o " + (folder / "b.png").string()).exit_code == 2);
  CHECK(test::run_stuv("board chessboard:9x6:30mm --paper A7 -o " + pdf).exit_code == 1);
  CHECK(test::run_stuv("board triangle:9x6:30mm -o " + pdf).exit_code == 1);
  CHECK(test::run_stuv("board -o " + pdf).exit_code == 2);
  CHECK_THROWS_AS(parse_paper("210x297"), Error);
  CHECK_THROWS_AS(parse_paper("A5x"), Error);
}

TEST_CASE("equal boards are equal files") {
  const test::TempFolder folder;
  for (const char* extension : {".pdf", ".svg"}) {
    const fs::path a = folder / (std::string("a") + extension), b = folder / (std::string("b") + extension);
    for (const fs::path& file : {a, b})
      REQUIRE(test::run_stuv("board charuco:5x7:38mm:28mm:DICT_4X4_50 -o " + file.string()).exit_code == 0);
    CHECK(read_text(a) == read_text(b));
  }
}
