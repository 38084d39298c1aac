#include <cmath>

#include "core/image_io.h"
#include "core/json.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;
namespace fs = std::filesystem;

namespace {

struct Scene {
  const char* list;
  const char* range;
  int planes, window, views;
  double psnr_db;  ///< of ../shared/tools/literal.cpp for the same views
};

/// `literal` against the independent implementation of the same equations: the same views, within 0.4 dB.
void check_literal(const Scene& scene) {
  STUV_NEED_SHARED_DATA(data);
  const test::TempFolder folder;
  const std::string lf = (folder / "scene").string(), json = (folder / "bench.json").string();
  const auto import = test::run_stuv("import '" + (data / scene.list).string() + "' -o " + lf +
                                     " --disparity=" + scene.range);
  INFO(import.err);
  REQUIRE(import.exit_code == 0);
  const auto bench =
      test::run_stuv("bench " + lf + " -o " + json + " --methods literal --planes " +
                     std::to_string(scene.planes) + " --window " + std::to_string(scene.window) +
                     " --views " + std::to_string(scene.views) + " --border 24");
  INFO(bench.out << bench.err);
  REQUIRE(bench.exit_code == 0);
  const Json row = read_json(json)["rows"][0];
  CHECK(row["views"] == scene.views);
  CHECK(row["evaluated_fraction"] == 1);
  CHECK(row["ssim"] > 0.9);
  CHECK(std::abs(row["psnr_db"].get<double>() - scene.psnr_db) < 0.4);
}

}  // namespace

TEST_CASE("literal on the knights agrees with an independent implementation") {
  check_literal({"knights/views.csv", "-347,231", 41, 3, 8, 32.89});
}
TEST_CASE("literal on the shop agrees with an independent implementation") {
  check_literal({"shop/views.csv", "0,276", 49, 4, 1, 33.69});
}
TEST_CASE("literal on dino agrees with an independent implementation") {
  check_literal({"hci/dino/views.csv", "-2.5,2.5", 41, 3, 3, 41.57});
}
TEST_CASE("literal on cotton agrees with an independent implementation") {
  check_literal({"hci/cotton/views.csv", "-2.5,2.5", 41, 3, 3, 48.83});
}

TEST_CASE("bench refuses what it does not have") {
  const test::TempFolder folder;
  const std::string out = (folder / "b.json").string();
  const auto method = test::run_stuv("bench scene -o " + out + " --methods magic");
  CHECK(method.exit_code == 2);
  CHECK_THAT(method.err, Contains("magic") && Contains("literal"));
  CHECK(test::run_stuv("bench scene -o " + out + " --planes 0").exit_code == 2);
  CHECK(test::run_stuv("bench scene -o " + out + " --backend cuda").exit_code == 2);
  const auto missing = test::run_stuv("bench " + (folder / "none").string() + " -o " + out);
  CHECK(missing.exit_code == 1);
  CHECK(test::line_count(missing.err) == 1);
}

TEST_CASE("bench: a border that leaves nothing, truths outside, memory of each row") {
  const test::TempFolder folder;
  fs::create_directory(folder / "in");
  for (const char* name : {"a", "b", "c"})
    write_image(folder / "in" / (std::string(name) + ".png"),
                from_float(ImageF(16, 12, 3, 0.5F), PixelType::u8));
  const auto import_with = [&](const std::string& truth) {
    write_text(folder / "in/views.csv", "file,s,t,role\na.png,0,0,input\nb.png,1,0,input\n" + truth);
    const std::string scene = (folder / "scene").string();
    REQUIRE(test::run_stuv("import " + (folder / "in/views.csv").string() + " -o " + scene +
                           " --force --disparity=-1,1")
                .exit_code == 0);
    return "bench " + scene + " -o " + (folder / "b.json").string() + " --force ";
  };
  const auto outside = test::run_stuv(import_with("c.png,3,0,truth\n"));
  CHECK(outside.exit_code == 1);
  CHECK_THAT(outside.err, Contains("no truth view between"));
  const std::string bench = import_with("c.png,0.5,0,truth\n");
  CHECK(test::run_stuv(bench + "--border 6").exit_code == 2);
  REQUIRE(test::run_stuv(bench + "--planes 3,4 --window 1 --backend cpu,gl").exit_code == 0);
  const Json rows = read_json(folder / "b.json")["rows"];
  REQUIRE(rows.size() == 4);
  for (const Json& row : rows) {
    CHECK(row["peak_mb"] > 1);
    CHECK(row["psnr_db"].is_null());  // equal pictures: infinite, which JSON does not hold
  }
  // The first row knows nothing of what OpenGL takes later.
  CHECK(rows[0]["peak_mb"] < rows[2]["peak_mb"]);
}
