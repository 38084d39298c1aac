#include <cmath>

#include "calib/check/check_rig.h"
#include "calib/check/lens_turn.h"
#include "tests/calib/check_scenes.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;

namespace {

constexpr double kDegree = M_PI / 180;

int count_of(const SceneCheck& check, CheckStatus status) {
  return static_cast<int>(std::count_if(check.cameras.begin(), check.cameras.end(),
                                        [&](const CameraCheck& c) { return c.status == status; }));
}

std::string reasons_of(const SceneCheck& check) {
  std::string text;
  for (const std::string& reason : check.reasons) text += reason + "\n";
  return text;
}

}  // namespace

TEST_CASE("a point is where its sight lines meet, near, far and infinitely far") {
  for (const double z : {0.5, 5.0, 1e4, 1e9}) {
    const Eigen::Vector3d X(0.1 * z, -0.2 * z, z);
    std::vector<SightLine> lines;
    for (const double s : {-1.0, 0.0, 2.0}) {
      const Eigen::Vector3d c(s, 0.3 * s, 0);
      lines.push_back({c, (X - c).normalized(), 600});
    }
    const auto point = triangulate(lines, 1e-3);
    REQUIRE(point);
    for (const SightLine& line : lines) {
      const Eigen::Vector3d y = point->X.head<3>() - point->X[3] * line.centre;
      CHECK((y.normalized() - line.direction).norm() < 1e-9);
    }
    if (z < 100) CHECK((point->X.hnormalized() - X).norm() < 1e-6 * z);
    // Covariance against the spread of noisy copies, along the well known directions.
    if (z == 5.0) CHECK(point->covariance.diagonal().minCoeff() > 0);
  }
  // Lines that do not meet, one line, and one centre.
  const Eigen::Vector3d ahead(0, 0, 1);
  CHECK_FALSE(triangulate(std::vector<SightLine>{{{0, 0, 0}, ahead, 600}, {{1, 0, 0}, {0, 1, 0}, 600}}, 3));
  CHECK_FALSE(triangulate(std::vector<SightLine>{{{0, 0, 0}, ahead, 600}}, 3));
  CHECK_FALSE(triangulate(std::vector<SightLine>{{{0, 0, 0}, ahead, 600}, {{0, 0, 0}, ahead, 600}}, 3));
}

TEST_CASE("a half turned camera takes the same picture half turned") {
  for (const char* model :
       {"LENSMODEL_PINHOLE", "LENSMODEL_OPENCV4", "LENSMODEL_OPENCV8", "LENSMODEL_OPENCV12"}) {
    Camera camera = test::true_rig(1, 1, 3).cameras[0].camera;
    camera.lens_model = model;
    camera.intrinsics.resize(4);
    const std::size_t terms =
        std::string(model) == "LENSMODEL_PINHOLE" ? 0 : std::stoul(std::string(model).substr(16));
    for (std::size_t k = 0; k < terms; ++k) camera.intrinsics.push_back(0.01 * (double(k) - 2.5));
    const auto turned = half_turned(camera);
    REQUIRE(turned);
    for (const Eigen::Vector3d& X : {Eigen::Vector3d(0.3, 0.2, 1), {-0.2, 0.1, 2}, {0.05, -0.4, 1.5}}) {
      const Eigen::Vector2d a = project(camera, {camera.cam_from_rig * X})[0],
                            b = project(*turned, {turned->cam_from_rig * X})[0];
      CHECK((Eigen::Vector2d(camera.width - 1, camera.height - 1) - a - b).norm() < 1e-9);
    }
  }
  Camera splined;
  splined.lens_model = "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=10_Ny=8_fov_x_deg=90";
  CHECK_FALSE(half_turned(splined));
}

TEST_CASE("changes that a resection finds are off by what it says") {
  double sum = 0;
  int count = 0;
  for (unsigned seed = 0; seed < 40; ++seed) {
    const Rig rig = test::true_rig(3, 3, 100 + seed);
    std::vector<Camera> cameras = test::cameras_in(rig);
    const Eigen::Vector3d turn = 0.5 * kDegree * Eigen::Vector3d(0.6, -0.5, 0.62),
                          shift(0.003, -0.003, 0.0026);
    test::move(cameras[4], turn, shift);
    const SceneCheck check = check_rig(test::evidence_of(cameras, seed), rig);
    const CameraCheck& moved = check.cameras[4];
    INFO("seed " << seed << "\n" << reasons_of(check));
    REQUIRE(moved.status == CheckStatus::moved);
    REQUIRE(moved.shift_known);
    CHECK(count_of(check, CheckStatus::ok) == 8);
    Vector6d error = moved.change->change;
    error.head<3>() -= turn;
    error.tail<3>() -= shift;
    sum += error.dot(moved.change->covariance.ldlt().solve(error));
    count += 6;
  }
  const double normalised = std::sqrt(sum / count);
  INFO("normalised rms " << normalised << " of " << count);
  CHECK(normalised > 0.85);
  CHECK(normalised < 1.15);
}

TEST_CASE("no camera of a rig that stands as it did is called moved") {
  for (unsigned seed = 0; seed < 25; ++seed)
    for (const auto& [rows, cols] : {std::pair{3, 3}, {1, 7}, {2, 2}}) {
      const Rig rig = test::true_rig(rows, cols, 10 + seed);
      const SceneCheck check = check_rig(test::evidence_of(test::cameras_in(rig), seed), rig);
      INFO(rows << "x" << cols << " seed " << seed << "\n" << reasons_of(check));
      CHECK(check.good);
      CHECK(count_of(check, CheckStatus::ok) == rows * cols);
    }
}

TEST_CASE("a corrected rig is the true one") {
  const Rig rig = test::true_rig(1, 7, 5);
  std::vector<Camera> cameras = test::cameras_in(rig);
  test::move(cameras[2], {0, 0.01, 0}, {0.004, 0.002, 0});
  test::move(cameras[6], {0.3, 0, 0.1}, {0, 0, 0});
  const SceneCheck check = check_rig(test::evidence_of(cameras, 1), rig);
  CHECK(check.cameras[2].status == CheckStatus::moved);
  CHECK(check.cameras[6].status == CheckStatus::moved);
  CHECK(count_of(check, CheckStatus::ok) == 5);
  const Rig corrected = corrected_rig(rig, check);
  for (const int c : {2, 6}) {
    const Pose off = corrected.cameras[c].camera.cam_from_rig * cameras[c].cam_from_rig.inverse();
    CHECK(vector_from_rotation(off.R).norm() < 0.001);
    CHECK((corrected.cameras[c].camera.cam_from_rig.centre() - cameras[c].cam_from_rig.centre()).norm() <
          0.001);
    CHECK(corrected.cameras[c].position_sigma_m.allFinite());
  }
  CHECK(check_rig(test::evidence_of(cameras, 2), corrected).good);
}

TEST_CASE("swapped and half turned cameras are named, and their rig is put right") {
  const Rig rig = test::true_rig(3, 3, 7);
  std::vector<Camera> cameras = test::cameras_in(rig);
  std::swap(cameras[1], cameras[5]);
  cameras[6] = *half_turned(cameras[6]);
  const SceneCheck check = check_rig(test::evidence_of(cameras, 3), rig);
  INFO(reasons_of(check));
  CHECK(check.cameras[1].status == CheckStatus::swapped_with);
  CHECK(check.cameras[1].partner == "r1c2");
  CHECK(check.cameras[5].status == CheckStatus::swapped_with);
  CHECK(check.cameras[5].partner == "r0c1");
  CHECK(check.cameras[6].status == CheckStatus::upside_down);
  CHECK(count_of(check, CheckStatus::ok) == 6);
  const Rig corrected = corrected_rig(rig, check);
  CHECK(corrected.cameras[1].row == 1);
  CHECK(corrected.cameras[1].camera.name == "r0c1");
  CHECK(check_rig(test::evidence_of(cameras, 4), corrected).good);

  // One that was really mounted upside down, a few degrees off.
  cameras = test::cameras_in(rig);
  test::move(cameras[0], M_PI * Eigen::Vector3d(0.03, 0.02, 1).normalized(), {0.001, 0, 0});
  CHECK(check_rig(test::evidence_of(cameras, 5), rig).cameras[0].status == CheckStatus::upside_down);
}

TEST_CASE("before a far scene a turn is found and a shift is said to be unknown") {
  const Rig rig = test::true_rig(3, 3, 8);
  std::vector<Camera> cameras = test::cameras_in(rig);
  test::move(cameras[4], {0.005, 0, 0}, {0.005, 0, 0});
  test::CheckSceneOptions far;
  far.near_m = 300, far.far_m = 1e6;
  const SceneCheck check = check_rig(test::evidence_of(cameras, 6, far), rig);
  INFO(reasons_of(check));
  REQUIRE(check.cameras[4].status == CheckStatus::moved);
  CHECK_FALSE(check.cameras[4].shift_known);
  CHECK((check.cameras[4].change->change.head<3>() - Eigen::Vector3d(0.005, 0, 0)).norm() < 3e-4);
  CHECK(to_json(check.cameras[4])["translation_mm"].is_null());
  CHECK_THAT(check.cameras[4].reason, Contains("too far"));
  CHECK(count_of(check, CheckStatus::ok) == 8);
}

TEST_CASE("what cannot be told is not told") {
  // Two cameras: one of them has turned.
  Rig rig = test::true_rig(1, 2, 9);
  std::vector<Camera> cameras = test::cameras_in(rig);
  CHECK(check_rig(test::evidence_of(cameras, 1), rig).good);
  test::move(cameras[0], {0.01, 0, 0}, {0, 0, 0});
  CHECK(count_of(check_rig(test::evidence_of(cameras, 1), rig), CheckStatus::undetermined) == 2);
  // Three in a row, one moved along it: any of them explains it.
  rig = test::true_rig(1, 3, 9);
  cameras = test::cameras_in(rig);
  const Eigen::Vector3d along =
      (cameras[2].cam_from_rig.centre() - cameras[0].cam_from_rig.centre()).normalized();
  test::CheckSceneOptions many;
  many.points = 1500;
  test::move(cameras[1], {0, 0, 0}, 0.008 * along);
  const SceneCheck three = check_rig(test::evidence_of(cameras, 2, many), rig);
  INFO(reasons_of(three));
  CHECK(count_of(three, CheckStatus::undetermined) == 3);
  // Of five the rest agrees.
  rig = test::true_rig(1, 5, 9);
  cameras = test::cameras_in(rig);
  test::move(cameras[1], {0, 0, 0}, 0.008 * along);
  const SceneCheck five = check_rig(test::evidence_of(cameras, 2, many), rig);
  INFO("five: " << reasons_of(five));
  CHECK(five.cameras[1].status == CheckStatus::moved);
  CHECK(count_of(five, CheckStatus::ok) == 4);
  // A camera without common points, one without a picture, one that the rig does not know.
  rig = test::true_rig(3, 3, 9);
  cameras = test::cameras_in(rig);
  SceneEvidence evidence = test::evidence_of(cameras, 3);
  for (SceneTrack& t : evidence.tracks)
    for (std::size_t k = t.camera.size(); k-- > 0;)
      if (t.camera[k] == 0 || t.camera[k] == 8)
        t.camera.erase(t.camera.begin() + long(k)), t.at_px.erase(t.at_px.begin() + long(k));
  std::erase_if(evidence.pairs, [](const ScenePair& p) { return p.a == 0 || p.b == 8; });
  evidence.cameras[8].present = false;
  evidence.cameras[8].problem = "its picture is black";
  rig.cameras[4].determined = false;
  const SceneCheck check = check_rig(evidence, rig);
  CHECK(check.cameras[0].status == CheckStatus::undetermined);
  CHECK_THAT(check.cameras[0].reason, Contains("shares 0 points"));
  CHECK(check.cameras[8].status == CheckStatus::missing);
  CHECK(check.cameras[4].status == CheckStatus::undetermined);
  CHECK(count_of(check, CheckStatus::ok) == 6);
  CHECK_FALSE(check.good);
}

TEST_CASE("the verdict does not depend on the unit of length") {
  for (const double scale : {1e-3, 1.0, 1e3}) {
    Rig rig = test::true_rig(3, 3, 11);
    std::vector<Camera> cameras = test::cameras_in(rig);
    test::move(cameras[3], {0, 0, 0}, {0, 0.005, 0});
    const SceneEvidence evidence = test::evidence_of(cameras, 4);
    for (RigCamera& rc : rig.cameras) rc.camera.cam_from_rig.t *= scale;
    const SceneCheck check = check_rig(evidence, rig);
    CHECK(check.cameras[3].status == CheckStatus::moved);
    CHECK(check.cameras[3].change->change.tail<3>().norm() == Approx(0.005 * scale).epsilon(0.1));
    CHECK(count_of(check, CheckStatus::ok) == 8);
  }
}

TEST_CASE("matches are joined to tracks that no camera is in twice") {
  const Eigen::Vector2d p(1, 2), q(3, 4), r(5, 6), other(7, 8);
  const auto tracks = tracks_of({{0, 1, {{p, q}}}, {1, 2, {{q, r}}}});
  REQUIRE(tracks.size() == 1);
  CHECK(tracks[0].camera == std::vector<int>{0, 1, 2});
  CHECK(tracks[0].at_px[2] == r);
  CHECK(tracks_of({{0, 1, {{p, q}}}, {1, 2, {{q, r}}}, {0, 2, {{other, r}}}}).empty());
}
