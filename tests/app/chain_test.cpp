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
  return synthetic::encode(synthetic::render_picture(synthetic::Scene(), camera).colour, {});
}

std::size_t different_pixels(const Image& a, const Image& b, int levels) {
  std::size_t count = 0;
  for (std::size_t i = 0; i < a.bytes.size(); ++i)
    count += std::abs(std::to_integer<int>(a.bytes[i]) - std::to_integer<int>(b.bytes[i])) > levels ? 1 : 0;
  return count;
}

/// A viewpoint on a camera gives its picture back, wherever the focal plane is.
void check_identity(const test::TempFolder& folder, const LightField& lf, const View& view) {
  const Image expected = read_image(lf.folder / view.file);
  for (const char* focus : {"--focus-px 0", "--focus-px 900"}) {
    const std::string out = (folder / "identity.png").string();
    run_or_fail("render " + lf.folder.string() + " -o " + out +
                " --force --mode focal-plane --filter normal " + focus + " --at=" + std::to_string(view.s) +
                "," + std::to_string(view.t) + "," + std::to_string(view.w));
    const Image back = read_image(out);
    REQUIRE(back.bytes.size() == expected.bytes.size());
    // The command line carries six decimals, a micrometre: interpolation then changes a pixel by a level at
    // most.
    CHECK(different_pixels(back, expected, 2) < back.bytes.size() / 1000);
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
  const ImageF expected = true_picture(lf, true_from_rig(rig, truth), place);
  const double psnr = psnr_db(to_float(cpu), expected, 24);
  INFO("PSNR " << psnr);
  CHECK(psnr > 26);
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
