#include <cmath>
#include <cstdio>

#include "calib/board/find_corners.h"
#include "core/json.h"
#include "core/rig.h"
#include "tests/support/support.h"

using namespace stuv;

namespace {

/// Estimated minus true centres after rigid alignment [m], worst over the cameras.
double worst_centre_m(const Rig& rig, const Rig& truth) {
  const auto n = static_cast<Eigen::Index>(truth.cameras.size());
  Eigen::Matrix3Xd a(3, n), b(3, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    a.col(i) = truth.cameras[i].camera.cam_from_rig.centre();
    b.col(i) = rig.cameras[i].camera.cam_from_rig.centre();
  }
  const Eigen::Matrix4d T = Eigen::umeyama(a, b, false);
  double worst = 0;
  for (Eigen::Index i = 0; i < n; ++i)
    worst =
        std::max(worst, (b.col(i) - T.topLeftCorner<3, 3>() * a.col(i) - T.topRightCorner<3, 1>()).norm());
  return worst;
}

}  // namespace

TEST_CASE(
    "a synthetic rig is calibrated from a ChArUco board and from an AprilGrid, parts of which are seen") {
  const test::TempFolder folder;
  for (const std::string spec : {"aprilgrid:4x3:70mm:1/4", "charuco:8x6:40mm:30mm:DICT_5X5_100"}) {
    INFO(spec);
    const std::string rec = (folder / "rec").string(), rig = (folder / "rig").string();
    write_text(folder / "rig.toml",
               "[source]\nkind = \"synthetic\"\nseed = 5\n[rig]\nrows = 1\ncols = 4\n[board]\nspec = \"" +
                   spec + "\"\n[sets]\nboards = 8\nscenes = 0\n");
    const auto captured = test::run_stuv("capture " + (folder / "rig.toml").string() + " --force -o " + rec);
    INFO(captured.err);
    REQUIRE(captured.exit_code == 0);
    // The recording says which board it shows.
    const auto run = test::run_stuv("calibrate " + rec + " --force -o " + rig);
    INFO(run.out << run.err);
    REQUIRE((run.exit_code == 0 || run.exit_code == 3));
    const Json report = read_json(folder / "rig" / "report.json");
    CHECK(report["rms_unweighted_px"] < 0.12);
    CHECK(report["outlier_fraction"] < 0.02);
    const Rig found = read_rig(folder / "rig"), truth = read_rig(folder / "rec" / "truth");
    REQUIRE(found.cameras.size() == 4);
    double sigma = 0;
    for (const RigCamera& camera : found.cameras) {
      CHECK(camera.determined);
      sigma = std::max(sigma, camera.position_sigma_m.norm());
    }
    const double worst = worst_centre_m(found, truth);
    std::printf("%s: rms %.3f px, worst centre %.3f mm off, sigma %.3f mm, solved in %.2f s\n", spec.c_str(),
                report["rms_px"].get<double>(), 1e3 * worst, 1e3 * sigma,
                report["seconds"].get<double>() - report["seconds_corners"].get<double>());
    CHECK(worst < 4 * sigma);
    CHECK(worst < 0.5e-3);
  }
}
