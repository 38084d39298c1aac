#include <fmt/format.h>

#include <cmath>

#include "capture/synthetic/render.h"
#include "core/image_io.h"
#include "core/light_field.h"
#include "core/rig.h"
#include "render/metrics.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;
namespace fs = std::filesystem;

namespace {

void run_or_fail(const std::string& arguments) {
  const auto result = test::run_stuv(arguments);
  INFO("stuv " << arguments << "\n" << result.out << result.err);
  REQUIRE(result.exit_code == 0);
}

Eigen::Matrix3Xd centres_of(const Rig& rig) {
  Eigen::Matrix3Xd centres(3, rig.cameras.size());
  for (std::size_t i = 0; i < rig.cameras.size(); ++i)
    centres.col(static_cast<Eigen::Index>(i)) = rig.cameras[i].camera.cam_from_rig.centre();
  return centres;
}

/// Rigid motion that takes the estimated centres to the true ones, least squares (Umeyama without scale).
Pose true_from_rig(const Rig& rig, const Rig& truth) {
  const Eigen::Matrix4d m = Eigen::umeyama(centres_of(rig), centres_of(truth), false);
  return {m.topLeftCorner<3, 3>(), m.topRightCorner<3, 1>()};
}

/// The same for pictures: turned so that all cameras' pixels look the same way. (Centres within 12 cm fix the
/// direction to a milliradian or two only, half a pixel and more.)
Pose true_from_rig_by_rays(const Rig& rig, const Rig& truth) {
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    std::vector<Eigen::Vector2d> pixels;
    for (int y = 60; y < 480; y += 60)
      for (int x = 80; x < 640; x += 80) pixels.emplace_back(x, y);
    const Camera &a = rig.cameras[i].camera, &b = truth.cameras[i].camera;
    const auto rays_a = unproject(a, pixels), rays_b = unproject(b, pixels);
    for (std::size_t k = 0; k < pixels.size(); ++k)
      sum +=
          (b.cam_from_rig.R.transpose() * rays_b[k]) * (a.cam_from_rig.R.transpose() * rays_a[k]).transpose();
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Matrix3d R = svd.matrixU() * svd.matrixV().transpose();
  return {R, centres_of(truth).rowwise().mean() - R * centres_of(rig).rowwise().mean()};
}

void check_errors_fit_sigmas(const Rig& rig, const Rig& truth) {
  const Pose align = true_from_rig(rig, truth);
  double sum = 0;
  int within = 0, count = 0;
  for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
    const RigCamera& rc = rig.cameras[i];
    REQUIRE(rc.camera.name == truth.cameras[i].camera.name);
    REQUIRE(rc.determined);
    const Eigen::Vector3d error =
        align.R.transpose() * (truth.cameras[i].camera.cam_from_rig.centre() - align.t) -
        rc.camera.cam_from_rig.centre();
    for (int axis = 0; axis < 3; ++axis) {
      const double normalised = error[axis] / rc.position_sigma_m[axis];
      sum += normalised * normalised;
      within += std::abs(normalised) < 3 ? 1 : 0;
      ++count;
    }
  }
  const double rms = std::sqrt(sum / count);
  INFO("normalised rms " << rms << ", " << within << " of " << count << " within 3 sigma");
  CHECK(rms > 0.8);
  CHECK(rms < 1.25);
  CHECK(within >= 0.99 * count - 1e-9);
}

/// The picture that the true scene shows at a place of the estimated rig.
ImageF true_picture(const LightField& lf, const Pose& align, const Eigen::Vector3d& place) {
  Camera camera;
  camera.name = "novel";
  camera.intrinsics = {lf.focal_px, lf.focal_px, lf.cx0_px, lf.cy0_px};
  camera.width = lf.width;
  camera.height = lf.height;
  camera.cam_from_rig = Pose{Eigen::Matrix3d::Identity(), -place} * align.inverse();
  const synthetic::SensorOptions noiseless{2.2, 0, 0};
  const synthetic::Exposure average{1, 0, 0};  // calibrate finds the vignetting, rectify takes it out
  return to_float(
      synthetic::expose(synthetic::render_picture(synthetic::Scene(), camera).colour, 3, noiseless, average));
}

/// Samples that are there in `expected` and differ.
std::size_t different_samples(const Image& image, const Image& expected) {
  std::size_t different = 0;
  for (std::size_t i = 0; i < expected.bytes.size(); ++i) {
    if (!expected.mask.empty() && expected.mask.data[i / expected.channels] == 0) continue;
    different += image.bytes[i] != expected.bytes[i] ? 1 : 0;
  }
  return different;
}

/// A viewpoint on a camera gives its picture back, wherever the focal plane is.
void check_identity(const test::TempFolder& folder, const LightField& lf, const View& view) {
  const Image expected = read_image(lf.folder / view.file);
  for (const char* focus : {"--focus-px 0", "--focus-px 900"}) {
    const std::string out = (folder / "identity.png").string();
    run_or_fail("render " + lf.folder.string() + " -o " + out +
                " --force --mode focal-plane --filter normal " + focus +
                fmt::format(" --at={},{}", view.s, view.t));
    const Image back = read_image(out);
    REQUIRE(back.bytes.size() == expected.bytes.size());
    CHECK(different_samples(back, expected) == 0);
  }
}

}  // namespace

TEST_CASE("the synthetic rig goes all the way: its errors fit its sigmas, its pictures the scene") {
  const test::TempFolder folder;
  const std::string rec = (folder / "rec").string(), rig_folder = (folder / "rig").string(),
                    scene = (folder / "scene").string();
  run_or_fail("capture -o " + rec);
  const Rig truth = read_rig(folder / "rec/truth");
  run_or_fail("calibrate " + rec + " -o " + rig_folder);

  // No stage reads the truth: without it, and with nothing remembered, every byte is the same.
  fs::rename(folder / "rec/truth", folder / "truth");
  fs::remove_all(folder / "rec/corners");
  run_or_fail("calibrate " + rec + " -o " + (folder / "rig_again").string());
  CHECK(read_text(folder / "rig/rig.json") == read_text(folder / "rig_again/rig.json"));
  for (const auto& entry : fs::directory_iterator(folder / "rig/cameras"))
    CHECK(read_text(entry.path()) ==
          read_text(folder / "rig_again/cameras" / entry.path().filename().string()));

  const Rig rig = read_rig(rig_folder);
  CHECK(rig.rows == 5);
  CHECK(rig.cols == 5);
  check_errors_fit_sigmas(rig, truth);

  run_or_fail("rectify " + rec + " --rig " + rig_folder + " -o " + scene + " --set scene00");
  const LightField lf = open_light_field(scene);
  check_identity(folder, lf, lf.views[7]);

  // Between cameras, where none stands, all in focus.
  const Eigen::Vector3d place(0.015, -0.015, 0);
  for (const char* backend : {"cpu", "gl"})
    run_or_fail("render " + scene + " -o " + (folder / (std::string(backend) + ".png")).string() +
                " --at=0.015,-0.015 --planes 48 --window 4 --backend " + backend);
  const Image cpu = read_image(folder / "cpu.png"), gl = read_image(folder / "gl.png");
  const ImageF expected = true_picture(lf, true_from_rig_by_rays(rig, truth), place);
  const double psnr = psnr_db(to_float(cpu), expected, 24);
  run_or_fail("render " + scene + " -o " + (folder / "plane.png").string() +
              " --at=0.015,-0.015 --mode focal-plane --focus 2");
  const double one_plane = psnr_db(to_float(read_image(folder / "plane.png")), expected, 24);
  std::printf("PSNR against the ray-traced picture: %.2f dB, one plane in the middle %.2f dB\n", psnr,
              one_plane);
  CHECK(psnr > one_plane + 3);
  CHECK(psnr_db(to_float(cpu), to_float(gl), 0) > 40);
}

TEST_CASE("manifests of a future version are refused by every command that reads them") {
  const test::TempFolder folder;
  const struct {
    const char* file;
    const char* format;
    const char* command;
  } cases[] = {{"recording.json", "stuv.recording", "calibrate IN -o OUT --board chessboard:9x6:20mm"},
               {"recording.json", "stuv.recording", "rectify IN --rig IN -o OUT"},
               {"rig.json", "stuv.rig", "rectify RECORDING --rig IN -o OUT"},
               {"lightfield.json", "stuv.lightfield", "render IN -o OUT.png"},
               {"lightfield.json", "stuv.lightfield", "bench IN -o OUT.json"}};
  fs::create_directories(folder / "good/sets");
  write_text(
      folder / "good/recording.json",
      R"({"format": "stuv.recording", "version": 1, "rows": 1, "cols": 1, "cameras": [], "source": {}})");
  for (const auto& c : cases) {
    fs::create_directories(folder / "in");
    write_text(folder / "in" / c.file, std::string(R"({"format": ")") + c.format + R"(", "version": 99})");
    std::string line = c.command;
    for (const auto& [from, to] : {std::pair<std::string, fs::path>{"RECORDING", folder / "good"},
                                   {"IN", folder / "in"},
                                   {"OUT", folder / "out"}})
      for (std::size_t at; (at = line.find(from)) != std::string::npos;)
        line.replace(at, from.size(), to.string());
    const auto result = test::run_stuv(line);
    INFO(line << "\n" << result.err);
    CHECK(result.exit_code == 1);
    CHECK(test::line_count(result.err) == 1);
    CHECK_THAT(result.err, Contains(c.file) && Contains("version 99"));
    CHECK_FALSE(fs::exists(folder / "out"));
    fs::remove_all(folder / "in");
  }
}

TEST_CASE("outputs that cannot be written are named before any work, and nothing is left") {
  const test::TempFolder folder;
  fs::create_directory(folder / "pictures");
  write_image(folder / "pictures/a.png", from_float(ImageF(8, 8, 3, 0.5F), PixelType::u8));
  write_text(folder / "pictures/views.csv", "file,s,t,role\na.png,0,0,input\n");
  const std::string source = (folder / "pictures/views.csv").string();
  // /proc takes no folder from anybody, root included.
  for (const std::string& out : {std::string("/proc/scene"), (folder / "nowhere/scene").string()}) {
    const auto result = test::run_stuv("import " + source + " -o " + out);
    CHECK(result.exit_code == 1);
    CHECK(test::line_count(result.err) == 1);
  }
  CHECK(test::run_stuv("import " + source + " -o " + (folder / "scene").string()).exit_code == 0);
  const auto again = test::run_stuv("import " + source + " -o " + (folder / "scene").string());
  CHECK(again.exit_code == 1);
  CHECK_THAT(again.err, Contains("--force"));
  fs::resize_file(folder / "pictures/a.png", 40);
  const auto damaged = test::run_stuv("import " + source + " -o " + (folder / "other").string());
  CHECK(damaged.exit_code == 1);
  CHECK(test::line_count(damaged.err) == 1);
  CHECK_THAT(damaged.err, Contains("a.png"));
  CHECK_FALSE(fs::exists(folder / "other"));
}

TEST_CASE("every command's help opens with an example, and wrong usage is exit 2") {
  for (const std::string command : {"capture", "calibrate", "rectify", "import", "render", "bench"}) {
    const auto help = test::run_stuv(command + " --help");
    CHECK(help.exit_code == 0);
    const std::string example = "stuv " + command;
    CHECK(help.out.find(example) != std::string::npos);
    CHECK(help.out.find(example) < help.out.find("Usage:"));
    CHECK(test::run_stuv(command + " --no-such-flag").exit_code == 2);
  }
  CHECK(test::run_stuv("").exit_code == 2);
  CHECK(test::run_stuv("--version").exit_code == 0);
}
