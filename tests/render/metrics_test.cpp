#include "render/metrics.h"

#include <cmath>

#include "tests/support/support.h"

using namespace stuv;

namespace {

ImageF texture(int width, int height, int channels) {
  ImageF image(width, height, channels);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      for (int c = 0; c < channels; ++c)
        image.at(x, y, c) = 0.5F + 0.3F * static_cast<float>(std::sin(0.7 * x + c) * std::cos(0.5 * y));
  return image;
}

}  // namespace

TEST_CASE("PSNR is that of the 8-bit pictures within the border") {
  ImageF a(10, 8, 3, 100.0F / 255), b(10, 8, 3, 110.0F / 255);
  CHECK(psnr_db(a, b, 0) == Approx(10 * std::log10(255.0 * 255.0 / 100)));
  CHECK(std::isinf(psnr_db(a, a, 0)));
  // A difference below half a level is none; one outside the border does not count.
  b = a;
  b.at(5, 4, 0) += 0.4F / 255;
  b.at(0, 0, 0) = 1;
  CHECK(std::isinf(psnr_db(a, b, 1)));
  CHECK(std::isfinite(psnr_db(a, b, 0)));
  CHECK(std::isnan(psnr_db(a, b, 4)));
  CHECK_THROWS_AS(psnr_db(a, ImageF(10, 8, 1), 0), std::invalid_argument);
}

TEST_CASE("SSIM of equal pictures is 1, of a constant shift as its formula says, of the negative below 0") {
  const ImageF a = texture(40, 30, 3);
  CHECK(ssim(a, a, 0) == Approx(1));
  ImageF negative = a;
  for (float& v : negative.data) v = 1 - v;
  CHECK(ssim(a, negative, 0) < 0);
  // Two constants: only the luminance term is left, (2 p q + C1) / (p^2 + q^2 + C1).
  const ImageF p(20, 20, 1, 100.0F / 255), q(20, 20, 1, 150.0F / 255);
  const double c1 = 6.5025;
  CHECK(ssim(p, q, 0) == Approx((2 * 100 * 150 + c1) / (100 * 100 + 150 * 150 + c1)));
  CHECK(std::isnan(ssim(p, q, 5)));
}
