#include <fmt/format.h>

#include <cmath>

#include "core/image_io.h"
#include "core/json.h"
#include "core/rig.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;
namespace fs = std::filesystem;

namespace {

/// A recording of the room by nine small cameras, once for all tests.
const fs::path& recording() {
  static const test::TempFolder folder;
  static const fs::path rec = [] {
    write_text(
        folder / "rig.toml",
        "[source]\nkind = \"synthetic\"\nseed = 4\n[rig]\nrows = 3\ncols = 3\nwidth = 480\nheight = 360\n"
        "focal_px = 450\n[sets]\nboards = 0\nscenes = 1\n");
    const auto run =
        test::run_stuv("capture " + (folder / "rig.toml").string() + " -o " + (folder / "rec").string());
    INFO(run.err);
    REQUIRE(run.exit_code == 0);
    return folder / "rec";
  }();
  return rec;
}

/// A copy whose pictures may be changed.
fs::path copy_of_recording(const test::TempFolder& folder) {
  fs::copy(recording(), folder / "rec", fs::copy_options::recursive);
  return folder / "rec/sets/scene00";
}

struct Checked {
  int exit_code = 0;
  Json json;
  std::string out;
  const Json& camera(const std::string& name) const {
    for (const Json& c : json["cameras"])
      if (c["name"] == name) return c;
    throw std::runtime_error("no camera " + name);
  }
  int ok() const {
    int count = 0;
    for (const Json& c : json["cameras"]) count += c["status"] == "ok" ? 1 : 0;
    return count;
  }
};

Checked check(const fs::path& rec, const fs::path& rig, const test::TempFolder& folder,
              const std::string& more = "") {
  const fs::path json = folder / "check.json";
  const auto run = test::run_stuv("check " + rec.string() + " --rig " + rig.string() + " --force --json " +
                                  json.string() + " " + more);
  INFO(run.out << run.err);
  REQUIRE((run.exit_code == 0 || run.exit_code == 3));
  return {run.exit_code, read_json(json), run.out};
}

Image mirrored(const Image& image) {
  Image out = image;
  const std::size_t pixel = image.channels * bytes_per_sample(image.type);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x)
      std::copy_n(&image.bytes[(std::size_t(y) * image.width + x) * pixel], pixel,
                  &out.bytes[(std::size_t(y) * image.width + image.width - 1 - x) * pixel]);
  return out;
}

}  // namespace

TEST_CASE("check: a rig that stands as it did is good") {
  const test::TempFolder folder;
  const Checked result = check(recording(), recording() / "truth", folder);
  CHECK(result.exit_code == 0);
  CHECK(result.json["verdict"]["good"] == true);
  CHECK(result.ok() == 9);
  CHECK_THAT(result.out, Contains("verdict: good"));
}

TEST_CASE("check: a camera that moved is found, measured and corrected") {
  const test::TempFolder folder;
  Rig rig = read_rig(recording() / "truth");
  Camera& camera = rig.cameras[rig.camera_index("r1c2")].camera;
  const Pose truth = camera.cam_from_rig;
  const Eigen::Vector3d c = truth.centre() + Eigen::Vector3d(0.003, 0.004, 0);
  camera.cam_from_rig.R = rotation_from_vector(0.5 * M_PI / 180 * Eigen::Vector3d(0.6, 0.8, 0)) * truth.R;
  camera.cam_from_rig.t = -(camera.cam_from_rig.R * c);
  fs::create_directory(folder / "rig");
  write_rig(folder / "rig", rig);
  const Checked result = check(recording(), folder / "rig", folder, "-o " + (folder / "rig2").string());
  CHECK(result.exit_code == 3);
  CHECK(result.ok() == 8);
  const Json& moved = result.camera("r1c2");
  INFO(moved.dump(1));
  CHECK(moved["status"] == "moved");
  CHECK(moved["correctable"] == true);
  CHECK(std::abs(moved["rotation_deg"].get<double>() - 0.5) <
        4 * moved["rotation_sigma_deg"].get<double>() + 0.002);
  CHECK(moved["rotation_sigma_deg"].get<double>() < 0.1);
  CHECK(std::abs(moved["translation_mm"].get<double>() - 5) <
        4 * moved["translation_sigma_mm"].get<double>());
  CHECK(moved["translation_sigma_mm"].get<double>() < 1);
  const Pose corrected = read_rig(folder / "rig2").cameras[rig.camera_index("r1c2")].camera.cam_from_rig;
  CHECK((corrected.centre() - truth.centre()).norm() < 0.002);
  CHECK(vector_from_rotation(corrected.R * truth.R.transpose()).norm() < 0.001);
  CHECK(check(recording(), folder / "rig2", folder).exit_code == 0);
}

TEST_CASE("check: swapped, mirrored, turned, black and missing pictures are named") {
  const test::TempFolder folder;
  const fs::path set = copy_of_recording(folder);
  fs::rename(set / "r0c0.png", set / "other.png");
  fs::rename(set / "r1c1.png", set / "r0c0.png");
  fs::rename(set / "other.png", set / "r1c1.png");
  write_image(set / "r2c0.png", mirrored(read_image(set / "r2c0.png")));
  Image black = read_image(set / "r0c2.png");
  std::fill(black.bytes.begin(), black.bytes.end(), std::byte{2});
  write_image(set / "r0c2.png", black);
  const Checked result = check(folder / "rec", recording() / "truth", folder);
  INFO(result.out);
  CHECK(result.exit_code == 3);
  CHECK(result.camera("r0c0")["status"] == "swapped_with");
  CHECK(result.camera("r0c0")["swapped_with"] == "r1c1");
  CHECK(result.camera("r1c1")["swapped_with"] == "r0c0");
  CHECK(result.camera("r2c0")["status"] == "mirrored");
  CHECK(result.camera("r2c0")["correctable"] == false);
  CHECK(result.camera("r0c2")["status"] == "missing");
  CHECK(result.ok() == 5);
}

TEST_CASE("check: a picture turned by half a turn") {
  const test::TempFolder folder;
  const fs::path set = copy_of_recording(folder);
  Image turned = read_image(set / "r1c0.png");
  const std::size_t pixel = turned.channels * bytes_per_sample(turned.type), n = turned.bytes.size() / pixel;
  const Image original = turned;
  for (std::size_t i = 0; i < n; ++i)
    std::copy_n(&original.bytes[i * pixel], pixel, &turned.bytes[(n - 1 - i) * pixel]);
  write_image(set / "r1c0.png", turned);
  const Checked result =
      check(folder / "rec", recording() / "truth", folder, "-o " + (folder / "rig2").string());
  INFO(result.out);
  CHECK(result.camera("r1c0")["status"] == "upside_down");
  CHECK(result.ok() == 8);
  CHECK(check(folder / "rec", folder / "rig2", folder).exit_code == 0);
}

TEST_CASE("check: bad input ends in one line") {
  const test::TempFolder folder;
  for (const std::string& arguments :
       {recording().string() + " --rig nowhere",
        std::string("nowhere --rig ") + (recording() / "truth").string(),
        recording().string() + " --rig " + (recording() / "truth").string() + " --set none"}) {
    const auto run = test::run_stuv("check " + arguments);
    INFO(arguments << "\n" << run.err);
    CHECK(run.exit_code == 1);
    CHECK(test::line_count(run.err) == 1);
  }
  CHECK(test::run_stuv("check").exit_code == 2);
}
