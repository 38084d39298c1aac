#include "core/image_io.h"
#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

TEST_CASE("stuv render: outputs, wrong usage, and nothing overwritten") {
  const TempFolder folder;
  const auto set = make_views({.rows = 2, .cols = 2});
  paint_plane(*set, 2, waves);
  LightField lf = set->lf;
  lf.folder = folder / "scene";
  lf.metric = false;
  lf.d_min = lf.d_max = std::nan("");
  for (std::size_t i = 0; i < lf.views.size(); ++i) {
    lf.views[i].file = "views/" + lf.views[i].name + ".tif";
    write_view(lf, lf.views[i], from_float(set->pixels[i].colour, lf.type));
  }
  write_manifest(lf);
  const std::string render = "render " + lf.folder.string() + " -o " + (folder / "out.png").string() + " ";
  for (const char* wrong :
       {"--disparity 1,3 --method exact", "--mode focal-plane --focus 3", "", "--disparity 1,3 --at 0,0,1",
        "--disparity 1,3 --at 0", "--disparity 3,1", "--disparity 1,3 --leave-out nobody", "--depth-m 1,2"}) {
    const ProgramResult result = run_stuv(render + wrong);
    INFO(wrong << ": " << result.err);
    CHECK(result.exit_code == 2);
    CHECK(line_count(result.err) == 1);
  }
  const std::string depth = (folder / "depth.pfm").string();
  REQUIRE(run_stuv(render + "--disparity -1,5 --planes 7 --leave-out 0_0 --depth-out " + depth).exit_code ==
          0);
  CHECK(read_image(folder / "out.png").width == 48);
  CHECK(read_pfm(depth).at(24, 20) == Approx(2));
  CHECK(run_stuv(render + "--disparity=-1,5").exit_code == 1);
  CHECK(run_stuv(render + "--disparity=-1,5 --size 24x20 --force").exit_code == 0);
  CHECK(read_image(folder / "out.png").width == 24);
}
