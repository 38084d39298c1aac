#include <cmath>
#include <cstring>

#include "core/image_io.h"
#include "core/json.h"
#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

TEST_CASE("stuv render: outputs, wrong usage, and nothing overwritten") {
  const TempFolder folder;
  const LightField lf = write_scene(folder / "scene", PixelType::u8, false);
  const std::string render = "render " + lf.folder.string() + " -o " + (folder / "out.png").string() + " ";
  for (const char* wrong :
       {"--disparity 1,3 --method best", "--mode focal-plane --focus 3", "--disparity 1,3 --at 0,0,1",
        "--disparity 1,3 --at 0", "--disparity 3,1", "--disparity 1,3 --leave-out nobody", "--depth-m 1,2",
        "--disparity 1,inf", "--disparity nan,3", "--mode focal-plane --focus-px inf",
        "--disparity 1,3 --planes 0", "--disparity 1,3 --window -1", "--disparity 1,3 --index-out a.jpg",
        "--disparity 1,3 --depth-out a.exr", "--disparity 1,3 --path p.csv --at 0,0"}) {
    const ProgramResult result = run_stuv(render + wrong);
    INFO(wrong << ": " << result.err);
    CHECK(result.exit_code == 2);
    CHECK(line_count(result.err) == 1);
  }
  const ProgramResult unknown =
      run_stuv("render " + lf.folder.string() + " --disparity 1,3 -o " + (folder / "out.xyz").string());
  CHECK(unknown.exit_code == 2);
  CHECK(unknown.err.find("out.xyz") != std::string::npos);
  const std::string depth = (folder / "depth.pfm").string();
  REQUIRE(run_stuv(render + "--disparity -1,5 --planes 7 --leave-out 0_0 --depth-out " + depth).exit_code ==
          0);
  CHECK(read_image(folder / "out.png").width == 48);
  CHECK(read_pfm(depth).at(24, 20) == Approx(2));
  CHECK(run_stuv(render + "--disparity=-1,5").exit_code == 1);
  CHECK(run_stuv(render + "--disparity=-1,5 --size 24x20 --force").exit_code == 0);
  CHECK(read_image(folder / "out.png").width == 24);
}

TEST_CASE("stuv render: metric depth, planes and confidence, along a path") {
  const TempFolder folder;
  const LightField lf = write_scene(folder / "scene", PixelType::u8, true);  // f = 40 px: Z = 20 m
  write_text(folder / "path.csv", "s,t,z\n# between the cameras\n0.25,0.5,0\n0.75, 0.5, -0.5\n");
  const auto out = [&](const char* name) { return (folder / name).string(); };
  const auto run =
      run_stuv("render " + lf.folder.string() + " -o " + out("v.png") + " --path " + out("path.csv") +
               " --depth-m 5,inf --planes 17 --window 3 --depth-out " + out("d.pfm") + " --index-out " +
               out("n.png") + " --confidence-out " + out("c.pfm") + " --json " + out("r.json"));
  INFO(run.err);
  REQUIRE(run.exit_code == 0);
  for (const std::string number : {"_0000", "_0001"}) {
    CHECK(read_image(folder / ("v" + number + ".png")).channels == 1);
    CHECK(read_pfm(folder / ("d" + number + ".pfm")).at(24, 20) ==
          Approx(20));  // disparities 0 .. 8: plane 4
    const Image planes = read_image(folder / ("n" + number + ".png"));
    CHECK(planes.type == PixelType::u16);
    CHECK(to_float(planes).at(24, 20) * 65535 == Approx(4));
    const float confidence = read_pfm(folder / ("c" + number + ".pfm")).at(24, 20);
    CHECK(confidence > 0.5);
    CHECK(confidence <= 1);
  }
  CHECK(read_json(folder / "r.json")["views"].size() == 2);
  write_text(folder / "bad.csv", "s,t,z\n0,0,0\n0,zero,0\n");
  const auto bad = run_stuv("render " + lf.folder.string() + " -o " + out("w.png") +
                            " --disparity 0,8 --path " + out("bad.csv"));
  CHECK(bad.exit_code == 1);
  CHECK(bad.err.find("bad.csv:3") != std::string::npos);

  // The depth map as a picture: the plane lies at a quarter of the range.
  REQUIRE(run_stuv("render " + lf.folder.string() + " -o " + out("x.pfm") +
                   " --disparity 0,8 --planes 17 --window 3 --depth-out " + out("x.png"))
              .exit_code == 0);
  CHECK(to_float(read_image(folder / "x.png")).at(24, 20) == Approx(0.325).margin(0.003));
  CHECK(read_pfm(folder / "x.pfm").at(24, 20) > 0);
}

TEST_CASE("NaN and Inf in a float light field are missing pixels, from file to picture") {
  const TempFolder folder;
  const auto set = make_views({.rows = 2, .cols = 2});
  paint_plane(*set, 2, waves);
  std::filesystem::create_directory(folder / "exr");
  std::string csv = "file,s,t,role\n";
  for (std::size_t i = 0; i < set->cameras.size(); ++i) {
    ImageF colour = set->pixels[i].colour;
    Image image = from_float(colour, PixelType::f32);
    const float bad[] = {std::nanf(""), INFINITY, -INFINITY};
    for (std::size_t k = 0; k < 3; ++k)
      std::memcpy(image.bytes.data() + (20 * 48 + 20 + 5 * k) * sizeof(float), &bad[k], sizeof(float));
    const std::string name = set->cameras[i].name + ".exr";
    write_image(folder / "exr" / name, image);
    csv +=
        name + "," + std::to_string(set->cameras[i].s) + "," + std::to_string(set->cameras[i].t) + ",input\n";
  }
  write_text(folder / "exr/views.csv", csv);
  const std::string scene = (folder / "scene").string();
  REQUIRE(run_stuv("import " + (folder / "exr/views.csv").string() + " -o " + scene).exit_code == 0);
  for (const char* backend : {"cpu", "gl"}) {
    const auto run =
        run_stuv("render " + scene + " -o " + (folder / "out.pfm").string() +
                 " --force --disparity 0,4 --planes 5 --window 2 --at=0.5,0.5 --backend " + backend);
    INFO(run.err);
    REQUIRE(run.exit_code == 0);
    for (const float v : read_pfm(folder / "out.pfm").data) {
      REQUIRE(std::isfinite(v));
      REQUIRE(v >= 0);
      REQUIRE(v <= 1.001F);
    }
  }
}
