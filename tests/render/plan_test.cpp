#include <cmath>

#include "core/json.h"
#include "render/plan/depth_range.h"
#include "render/plan/sampling.h"
#include "tests/render/scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using namespace stuv::test;

namespace {

SamplingProblem paper() { return {9, 9, 0.008, 0.008, 1 / 1.84, 1 / 0.33, 300}; }

/// A far plane and a near one before its right half.
std::shared_ptr<ViewSet> two_depths(double far, double near) {
  auto set = make_views({.rows = 4, .cols = 4, .width = 320, .height = 200});
  for (std::size_t i = 0; i < set->cameras.size(); ++i) {
    const View& view = set->cameras[i];
    const auto fine = [](double x, double y) {
      return 0.6F * waves(0.35 * x, 0.4 * y) + 0.4F * waves(y, 1.3 * x);
    };
    const ImageF behind = picture_of_plane(set->lf, view, far, fine),
                 before = picture_of_plane(set->lf, view, near, fine);
    const double edge_px = set->lf.cx0_px - near * (view.s - 1.5);
    for (int y = 0; y < 200; ++y)
      for (int x = 0; x < 320; ++x) set->pixels[i].colour.at(x, y) = (x > edge_px ? before : behind).at(x, y);
  }
  return set;
}

}  // namespace

TEST_CASE("plan: the paper's scene") {
  const SamplingPlan plan = plan_sampling(paper());
  CHECK(plan.max_spacing == Approx(0.00134).margin(5e-6));
  CHECK(plan.cameras_needed == 2916);
  CHECK(plan.factor == 36);
  CHECK(1 / plan.inverse_optimum == Approx(2 / (1 / 0.33 + 1 / 1.84)));
  CHECK_FALSE(plan.one_plane_is_enough);
  CHECK(plan.planes.size() == 13);  // the paper's N
}

TEST_CASE("plan: everything is in focus in at least one plane") {
  for (const double near : {0.2, 0.33, 1.0, 1.8, 1.84}) {
    SamplingProblem p = paper();
    p.inverse_near = 1 / near;
    const SamplingPlan plan = plan_sampling(p);
    CHECK(plan.planes.front().inverse_far <= p.inverse_far);
    CHECK(plan.planes.back().inverse_near >= p.inverse_near);
    for (std::size_t n = 1; n < plan.planes.size(); ++n)
      CHECK(plan.planes[n].inverse_far <= plan.planes[n - 1].inverse_near + 1e-12);
  }
}

TEST_CASE("plan: rows, one camera, no depth, infinity, and what makes no sense") {
  SamplingProblem row = paper();
  row.rows = 1;
  row.spacing_t = 0;
  CHECK(plan_sampling(row).cameras_needed == 54);
  SamplingProblem one{1, 1, 0, 0, 0, 3, 300};
  CHECK(plan_sampling(one).cameras_needed == 1);
  CHECK(plan_sampling(one).planes.size() == 1);
  SamplingProblem flat = paper();
  flat.inverse_far = flat.inverse_near;
  CHECK(plan_sampling(flat).cameras_needed == 81);
  CHECK(plan_sampling(flat).one_plane_is_enough);
  SamplingProblem far = paper();
  far.inverse_far = 0;
  CHECK(plan_sampling(far).planes.front().inverse_depth == 0);
  for (const double scale : {1e-6, 1e6}) {  // the unit of length does not matter
    SamplingProblem p = paper();
    p.spacing_s *= scale;
    p.spacing_t *= scale;
    p.inverse_far /= scale;
    p.inverse_near /= scale;
    CHECK(plan_sampling(p).cameras_needed == 2916);
    CHECK(plan_sampling(p).planes.size() == 13);
  }
  const auto refused = [](auto change) {
    SamplingProblem p = paper();
    change(p);
    CHECK_THROWS_AS(plan_sampling(p), std::invalid_argument);
  };
  refused([](SamplingProblem& p) { p.bandwidth = 0; });
  refused([](SamplingProblem& p) { p.bandwidth = NAN; });
  refused([](SamplingProblem& p) { p.spacing_s = -1; });
  refused([](SamplingProblem& p) { p.inverse_near = 0.1; });
  refused([](SamplingProblem& p) { p.inverse_near = INFINITY; });
  refused([](SamplingProblem& p) { p.bandwidth = 1e12; });
}

TEST_CASE("The depth range is found in the pictures") {
  for (const auto& [far, near] : {std::pair(2.0, 6.0), std::pair(0.5, 14.0), std::pair(5.0, 5.0)}) {
    const DepthRange range = estimate_depth_range(two_depths(far, near));
    INFO(far << " " << near << ": " << range.d_min << " " << range.d_max);
    REQUIRE(range.found);
    CHECK(range.d_min <= far);
    CHECK(range.d_min >= std::max(0.0, far - 3));
    CHECK(range.d_max >= near);
    CHECK(range.d_max <= near + 3);
  }
}

TEST_CASE("Texture too fine for the small pictures: the right range or none") {
  const auto set = make_views({.rows = 4, .cols = 4, .width = 320, .height = 200});
  paint_plane(*set, 3, [](double x, double y) { return waves(1.7 * x, 1.9 * y); });
  const DepthRange range = estimate_depth_range(set);
  INFO(range.d_min << " " << range.d_max << " " << range.sure_fraction);
  CHECK((!range.found || (range.d_min <= 3 && range.d_max >= 3)));
}

TEST_CASE("Without texture, or with one camera, no depth range is found") {
  const auto grey = make_views({.rows = 3, .cols = 3, .width = 200, .height = 160});
  paint_constant(*grey, 0.5F);
  CHECK_FALSE(estimate_depth_range(grey).found);
  const auto one = make_views({.rows = 1, .cols = 1, .width = 200, .height = 160});
  paint_plane(*one, 2, waves);
  CHECK_FALSE(estimate_depth_range(one).found);
}

TEST_CASE("The range of real light fields is found in the pictures") {
  STUV_NEED_SHARED_DATA(data);
  struct Case {
    const char* list;
    double low[2], high[2];  ///< bounds of d_min, of d_max
  };
  for (const Case& c :
       {Case{"knights/views.csv", {-347, -150}, {120, 260}}, Case{"shop/views.csv", {-40, 40}, {180, 320}},
        Case{"hci/dino/views.csv", {-2.5, -1.2}, {1.2, 2.5}}}) {
    const TempFolder folder;
    const std::string scene = (folder / "scene").string();
    REQUIRE(run_stuv("import '" + (data / c.list).string() + "' -o " + scene).exit_code == 0);
    const LightFieldReader reader(open_light_field(scene));
    const DepthRange range = estimate_depth_range(open_views(reader));
    std::printf("%s: %.4g to %.4g px per unit of s, %.3f sure\n", c.list, range.d_min, range.d_max,
                range.sure_fraction);
    REQUIRE(range.found);
    CHECK(range.d_min >= c.low[0]);
    CHECK(range.d_min <= c.low[1]);
    CHECK(range.d_max >= c.high[0]);
    CHECK(range.d_max <= c.high[1]);
  }
}

TEST_CASE("stuv plan") {
  const TempFolder folder;
  const std::string json = (folder / "p.json").string();
  const auto good =
      run_stuv("plan --grid 9x9 --spacing-m 0.008 --depth-m 0.33,1.84 --bandwidth 300 --json " + json);
  REQUIRE(good.exit_code == 0);
  CHECK(good.out.find("1.34 mm") != std::string::npos);
  CHECK(good.out.find("2916 cameras, 36 times") != std::string::npos);
  const Json result = read_json(folder / "p.json");
  CHECK(result["cameras_needed"] == 2916);
  CHECK(result["planes"] == 13);
  for (const char* wrong : {"", "--grid 9x9", "--grid 9x9 --spacing-m 0 --depth-m 1,2 --bandwidth 3",
                            "--grid 9x9 --spacing-m 1 --depth-m 2,1 --bandwidth 3",
                            "--grid 9x9 --spacing-m 1 --depth-m 1,2 --bandwidth 0", "nowhere --grid 9x9"}) {
    const auto run = run_stuv(std::string("plan ") + wrong);
    INFO(wrong << ": " << run.err);
    CHECK(run.exit_code == 2);
    CHECK(line_count(run.err) == 1);
  }
  CHECK(run_stuv("plan nowhere").exit_code == 1);
}
