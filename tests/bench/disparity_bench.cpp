// Disparity of the Aloe pair beside OpenCV's StereoSGBM, in one run.
//   disparity_bench DATA [OUT]     writes OUT/ours.png, OUT/opencv.png, OUT/truth.png, OUT/rebuilt.png
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <string>

#include "calib/two_view/disparity.h"
#include "calib/two_view/draw.h"
#include "core/image_io.h"

using namespace stuv;

namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

double seconds_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

/// Share of the pixels with truth that are wrong by more than 2 px or have no answer.
double wrong(const ImageF& found, const ImageF& truth) {
  double bad = 0, all = 0;
  for (std::size_t i = 0; i < truth.data.size(); ++i) {
    if (!std::isfinite(truth.data[i])) continue;
    all += 1;
    bad += std::abs(found.data[i] - truth.data[i]) <= 2 ? 0 : 1;
  }
  return bad / all;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) return fmt::print(stderr, "disparity_bench DATA [OUT]\n"), 2;
  const std::filesystem::path data = argv[1];
  const Image left = read_image(data / "aloeL.jpg"), right = read_image(data / "aloeR.jpg");
  const cv::Mat gt = cv::imread((data / "aloeGT.png").string(), cv::IMREAD_GRAYSCALE);
  ImageF truth(gt.cols, gt.rows, 1, kNaN);
  int most = 0;
  for (int y = 0; y < gt.rows; ++y)
    for (int x = 0; x < gt.cols; ++x)
      if (const int d = gt.at<std::uint8_t>(y, x); d > 0)
        truth.at(x, y) = static_cast<float>(d), most = std::max(most, d);
  const int range = (most + 16) / 16 * 16;

  const cv::Mat l = cv::imread((data / "aloeL.jpg").string()), r = cv::imread((data / "aloeR.jpg").string());
  const auto sgbm = cv::StereoSGBM::create(0, range, 5, 8 * 3 * 25, 32 * 3 * 25, 1, 0, 10, 100, 32);
  cv::Mat d16;
  auto begin = std::chrono::steady_clock::now();
  sgbm->compute(l, r, d16);
  const double s_opencv = seconds_since(begin);
  ImageF opencv(gt.cols, gt.rows, 1, kNaN);
  for (int y = 0; y < gt.rows; ++y)
    for (int x = 0; x < gt.cols; ++x)
      if (const int d = d16.at<std::int16_t>(y, x); d >= 0) opencv.at(x, y) = static_cast<float>(d) / 16;

  DisparityOptions options;
  options.min_px = -range;
  options.max_px = 0;
  begin = std::chrono::steady_clock::now();
  const Disparity ours = find_disparity(left, right, options);
  const double s_ours = seconds_since(begin);
  ImageF positive = ours.d_px, sure = ours.d_px;
  for (std::size_t i = 0; i < positive.data.size(); ++i) {
    positive.data[i] = -positive.data[i];
    sure.data[i] = ours.confidence.data[i] > 0 ? positive.data[i] : kNaN;
  }
  fmt::print("range 0..{} px, {} cores\n", range, cv::getNumberOfCPUs());
  fmt::print("StereoSGBM  {:6.2f} % wrong  {:.2f} s\n", 100 * wrong(opencv, truth), s_opencv);
  fmt::print("stuv        {:6.2f} % wrong  {:.2f} s  ({:.2f} % where filled in counts as wrong)\n",
             100 * wrong(positive, truth), s_ours, 100 * wrong(sure, truth));
  if (argc > 2) {
    const std::filesystem::path out = argv[2];
    std::filesystem::create_directories(out);
    write_image(out / "truth.png", draw_disparity(truth));
    write_image(out / "opencv.png", draw_disparity(opencv));
    write_image(out / "ours.png", draw_disparity(positive));
    write_image(out / "rebuilt.png", rebuild(right, ours));
  }
}
