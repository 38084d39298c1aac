#include "calib/photometry/estimate_photometry.h"

#include <cmath>
#include <random>

#include "calib/photometry/board_samples.h"
#include "capture/capture.h"
#include "capture/synthetic/synthetic_source.h"
#include "core/files.h"
#include "tests/support/support.h"

using namespace stuv;
using Catch::Contains;

namespace {

std::vector<Camera> row_of_cameras(int count) {
  std::vector<Camera> cameras;
  for (int i = 0; i < count; ++i)
    cameras.push_back(
        {"cam" + std::to_string(i), "LENSMODEL_PINHOLE", {600, 600, 319.5, 239.5}, 640, 480, {}});
  return cameras;
}

struct Truth {
  std::vector<CameraPhotometry> cameras;
};

/// Cameras that differ in all respects; means as the gauge wants them.
Truth random_truth(int count, std::mt19937& random) {
  std::normal_distribution<double> normal;
  Truth truth;
  for (const Camera& camera : row_of_cameras(count)) {
    CameraPhotometry p;
    p.camera = camera.name;
    for (int c = 0; c < 3; ++c) {
      p.gain[c] = 1 + 0.08 * normal(random);
      p.offset[c] = 0.01 * normal(random);
    }
    p.falloff = {-0.25 + 0.04 * normal(random), 0.05 * normal(random), 0};
    p.centre_px = {319.5, 239.5};
    p.corner_px = std::hypot(319.5, 239.5);
    truth.cameras.push_back(p);
  }
  for (int c = 0; c < 3; ++c) {
    double gain = 0, offset = 0;
    for (const CameraPhotometry& p : truth.cameras) {
      gain += p.gain[c] / count;
      offset += p.offset[c] / count;
    }
    for (CameraPhotometry& p : truth.cameras) {
      p.gain[c] /= gain;
      p.offset[c] -= offset;
    }
  }
  return truth;
}

/// Points that wander through the pictures from camera to camera, light and dark, with noise and with every
/// tenth one glossy in one camera.
std::vector<PhotometricSample> samples_of(const Truth& truth, int points, double noise, std::mt19937& random,
                                          double darkest = 0.05, double reach = 1) {
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  std::vector<PhotometricSample> samples;
  const int count = static_cast<int>(truth.cameras.size());
  for (int point = 0; point < points; ++point) {
    std::array<double, 3> light;
    for (double& l : light) l = darkest + (0.85 - darkest) * uniform(random);
    const Eigen::Vector2d start(640 * uniform(random), 480 * uniform(random)), step(-40, 6 * normal(random));
    const int glossy = point % 10 == 0 ? static_cast<int>(count * uniform(random)) : -1;
    for (int k = 0; k < count; ++k) {
      Eigen::Vector2d q = start + (k - 0.5 * count) * step;
      q = Eigen::Vector2d(319.5, 239.5) + reach * (q - Eigen::Vector2d(319.5, 239.5));
      if (q.x() < 0 || q.y() < 0 || q.x() > 639 || q.y() > 479) continue;
      PhotometricSample s{k, point, q, {}};
      const CameraPhotometry& p = truth.cameras[k];
      for (int c = 0; c < 3; ++c)
        s.stored[c] = p.offset[c] + p.gain[c] * falloff_at(p, q) * light[c] + noise * normal(random) +
                      (k == glossy ? 0.2 : 0);
      samples.push_back(s);
    }
  }
  return samples;
}

}  // namespace

TEST_CASE("photometry: gains, offsets and falloff are found, and their sigmas are true") {
  std::mt19937 random(4);
  double sum = 0;
  int count = 0;
  for (int trial = 0; trial < 6; ++trial) {
    const Truth truth = random_truth(6, random);
    const auto samples = samples_of(truth, 500, 0.004, random);
    const Photometry p = estimate_photometry(samples, row_of_cameras(6), 3, "boards");
    REQUIRE(p.cameras.size() == 6);
    CHECK(p.spread_before > 0.05);
    CHECK(p.spread_after < 0.01);
    for (int k = 0; k < 6; ++k) {
      const CameraPhotometry &got = p.cameras[k], &want = truth.cameras[k];
      REQUIRE(got.determined);
      for (int c = 0; c < 3; ++c) {
        CHECK(got.gain[c] == Approx(want.gain[c]).margin(0.006));
        CHECK(got.offset[c] == Approx(want.offset[c]).margin(0.004));
        sum += std::pow((got.gain[c] - want.gain[c]) / got.gain_sigma[c], 2);
        sum += std::pow((got.offset[c] - want.offset[c]) / got.offset_sigma[c], 2);
        count += 2;
      }
      CHECK(falloff_at(got, {0, 0}) == Approx(falloff_at(want, {0, 0})).margin(0.03));
      // It falls all the way.
      for (int i = 0; i < 50; ++i)
        CHECK(falloff_at(got, {319.5 - 6.3 * i, 239.5}) >=
              falloff_at(got, {319.5 - 6.3 * (i + 1), 239.5}) - 1e-12);
    }
  }
  const double normalised = std::sqrt(sum / count);
  INFO("error over sigma, rms: " << normalised);
  CHECK(normalised > 0.8);
  CHECK(normalised < 1.25);
}

TEST_CASE("photometry: what samples do not determine is left alone, with the reason") {
  std::mt19937 random(5);
  const Truth truth = random_truth(5, random);
  SECTION("a camera with hardly a place in common") {
    auto samples = samples_of(truth, 300, 0.003, random);
    int kept = 0;
    std::erase_if(samples, [&](const PhotometricSample& s) { return s.camera == 2 && ++kept > 10; });
    const Photometry p = estimate_photometry(samples, row_of_cameras(5), 3, "boards");
    CHECK_FALSE(p.cameras[2].determined);
    CHECK(p.of("cam2") == nullptr);
    CHECK(p.cameras[2].gain == std::array<double, 3>{1, 1, 1});
    REQUIRE(p.cameras[2].reasons.size() == 1);
    CHECK_THAT(p.cameras[2].reasons[0], Contains("10 flat places"));
    CHECK(p.of("cam1") != nullptr);
  }
  SECTION("two groups that share nothing") {
    auto samples = samples_of(truth, 300, 0.003, random);
    std::erase_if(samples, [&](const PhotometricSample& s) { return (s.point % 2 == 0) == (s.camera < 2); });
    const Photometry p = estimate_photometry(samples, row_of_cameras(5), 3, "boards");
    CHECK(p.of("cam0") == nullptr);
    CHECK(p.of("cam1") == nullptr);
    CHECK_THAT(p.cameras[0].reasons.at(0), Contains("in common with most"));
    CHECK(p.of("cam3") != nullptr);
  }
  SECTION("everything equally bright: no offset") {
    const auto samples = samples_of(truth, 300, 0.003, random, 0.84);
    const Photometry p = estimate_photometry(samples, row_of_cameras(5), 3, "boards");
    for (const CameraPhotometry& c : p.cameras) {
      REQUIRE(c.determined);
      CHECK(c.offset == std::array<double, 3>{0, 0, 0});
      CHECK_THAT(c.reasons.at(0), Contains("offset"));
    }
    CHECK(p.spread_after < 0.01);
  }
  SECTION("places only in the middle: the corners are not known") {
    const auto samples = samples_of(truth, 300, 0.003, random, 0.05, 0.15);
    const Photometry p = estimate_photometry(samples, row_of_cameras(5), 3, "boards");
    for (const CameraPhotometry& c : p.cameras) CHECK_THAT(c.reasons.at(0), Contains("corners"));
    CHECK_THAT(p.notes.at(0), Contains("share"));
  }
  SECTION("a board that shines: nobody is believed") {
    auto samples = samples_of(truth, 300, 0.003, random);
    // What it mirrors depends on the place and on where one looks from.
    for (PhotometricSample& s : samples)
      for (double& v : s.stored) v *= 1 + 0.05 * std::sin(0.7 * s.point + 1.3 * s.camera);
    PhotometryOptions options;
    options.most_spread = 0.01;
    const Photometry p = estimate_photometry(samples, row_of_cameras(5), 3, "boards", options);
    for (const CameraPhotometry& c : p.cameras) {
      CHECK_FALSE(c.determined);
      CHECK(c.gain == std::array<double, 3>{1, 1, 1});
      CHECK_THAT(c.reasons.at(0), Contains("shines"));
    }
  }
  SECTION("one camera") {
    const Photometry p = estimate_photometry({}, row_of_cameras(1), 3, "boards");
    CHECK_FALSE(p.cameras[0].determined);
    CHECK(p.cameras[0].reasons.size() == 1);
    CHECK_THAT(summary_of(p), Contains("not determined"));
  }
}

TEST_CASE("photometry: the file keeps it all, and damage is named") {
  std::mt19937 random(6);
  const Truth truth = random_truth(3, random);
  const Photometry p =
      estimate_photometry(samples_of(truth, 200, 0.003, random), row_of_cameras(3), 3, "boards");
  const test::TempFolder folder;
  CHECK_FALSE(read_photometry(folder.path()));
  write_photometry(folder.path(), p);
  const auto back = read_photometry(folder.path());
  REQUIRE(back);
  CHECK(back->channels == 3);
  CHECK(back->source == "boards");
  for (int k = 0; k < 3; ++k) {
    CHECK(back->cameras[k].gain == p.cameras[k].gain);
    CHECK(back->cameras[k].falloff == p.cameras[k].falloff);
    CHECK(back->cameras[k].centre_px == p.cameras[k].centre_px);
    CHECK(back->cameras[k].determined == p.cameras[k].determined);
  }
  Photometry bad = p;
  bad.cameras[1].gain[0] = -1;
  write_photometry(folder.path(), bad);
  CHECK_THROWS_WITH(read_photometry(folder.path()), Contains("photometry.json") && Contains("cam1"));
  write_text(folder / "photometry.json", R"({"format": "stuv.photometry", "version": 1})");
  CHECK_THROWS_WITH(read_photometry(folder.path()), Contains("photometry.json"));
}

TEST_CASE("photometry: clipped, sloping and masked squares are no samples") {
  ImageF pixels(100, 100, 1, 0.6F);
  const std::array<Eigen::Vector2d, 4> quad = {Eigen::Vector2d(20, 20), Eigen::Vector2d(60, 22),
                                               Eigen::Vector2d(62, 60), Eigen::Vector2d(21, 61)};
  Image image = from_float(pixels, PixelType::u8);
  REQUIRE(flat_value(image, 1, quad));
  CHECK((*flat_value(image, 1, quad))[0] == Approx(0.6));
  image.bytes[40 * 100 + 40] = std::byte{255};
  CHECK_FALSE(flat_value(image, 1, quad));
  image.bytes[40 * 100 + 40] = std::byte{0};
  CHECK_FALSE(flat_value(image, 1, quad));
  image = from_float(pixels, PixelType::u8);
  image.mask = Mask(100, 100, 1, 255);
  image.mask.at(40, 40) = 0;
  CHECK_FALSE(flat_value(image, 1, quad));
  for (int y = 0; y < 100; ++y)
    for (int x = 0; x < 100; ++x) pixels.at(x, y) = 0.1F + 0.008F * static_cast<float>(x);
  CHECK_FALSE(flat_value(from_float(pixels, PixelType::u8), 1, quad));
  // 12 bits in 16 are full at 4095.
  Image deep = from_float(ImageF(4, 4, 1, 1.0F), PixelType::u16);
  auto* values = reinterpret_cast<std::uint16_t*>(deep.bytes.data());
  CHECK(white_level(deep) == 1);
  std::fill_n(values, 16, std::uint16_t{4095});
  values[3] = 17;
  CHECK(white_level(deep) == Approx(4095.0 / 65535));
  CHECK(full_fraction(deep) == Approx(15.0 / 16));
}
