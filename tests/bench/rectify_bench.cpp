// How fast a picture is warped, against the machine's memory and OpenCV's remap, with each one's error
// against the truth.
//   rectify_bench [WIDTHxHEIGHT] [ROUNDS]
#include <fmt/format.h>

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <functional>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "calib/rectify/warp.h"
#include "core/parallel.h"

using namespace stuv;

namespace {

Camera camera_of(int width, int height) {
  const double f = 0.55 * width;
  Camera camera{"cam",
                "LENSMODEL_OPENCV4",
                {f, f, 0.5 * width + 3.3, 0.5 * height - 2.1, -0.12, 0.04, 5e-4, -4e-4},
                width,
                height,
                {}};
  camera.cam_from_rig.R = rotation_from_vector({0.01, -0.015, 0.008});
  return camera;
}

/// Of directions: up to a fifth of the sampling frequency in each of three waves.
double sky(const Eigen::Vector2d& d, double f) {
  return 0.5 + 0.15 * std::sin(1.2 * f * d.x()) + 0.15 * std::cos(0.9 * f * d.y() + 0.4 * f * d.x()) +
         0.1 * std::sin(0.2 * f * (d.x() - d.y()));
}

ImageF picture(const Camera& camera, double f) {
  ImageF image(camera.width, camera.height, 1);
  parallel_for(camera.height, [&](int y) {
    std::vector<Eigen::Vector2d> pixels;
    for (int x = 0; x < camera.width; ++x) pixels.emplace_back(x, y);
    const auto rays = unproject(camera, pixels);
    for (int x = 0; x < camera.width; ++x) {
      const Eigen::Vector3d r = camera.cam_from_rig.R.transpose() * rays[x];
      image.at(x, y) = static_cast<float>(sky(r.head<2>() / r.z(), f));
    }
  });
  return image;
}

/// Fastest of several runs [s].
double seconds(int rounds, const std::function<void()>& f) {
  double best = 1e9;
  for (int i = 0; i < rounds; ++i) {
    const auto begin = std::chrono::steady_clock::now();
    f();
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  }
  return best;
}

/// Bytes read and written a second by copying blocks that no cache holds, on all threads.
double memory_bandwidth() {
  constexpr int kBlocks = 64;
  constexpr std::size_t kBytes = 4 << 20;
  std::vector<std::uint8_t> from(kBlocks * kBytes, 1), to(kBlocks * kBytes, 2);
  const double s = seconds(5, [&] {
    parallel_for(kBlocks, [&](int i) { std::memcpy(&to[i * kBytes], &from[i * kBytes], kBytes); });
  });
  return 2.0 * kBlocks * kBytes / s;
}

double psnr_against(const ImageF& out, const Mask& mask, const CommonView& view) {
  double sum = 0, count = 0;
  for (int y = 8; y < view.height - 8; ++y)
    for (int x = 8; x < view.width - 8; ++x) {
      if (!mask.empty() && mask.at(x, y) == 0) continue;
      const Eigen::Vector2d d((x - view.cx_px) / view.focal_px, (y - view.cy_px) / view.focal_px);
      sum += std::pow(out.at(x, y) - sky(d, view.focal_px), 2);
      ++count;
    }
  return -10 * std::log10(sum / count);
}

}  // namespace

int main(int argc, char** argv) {
  int width = 1920, height = 1200, rounds = 9;
  if (argc > 1 && std::sscanf(argv[1], "%dx%d", &width, &height) != 2) {
    fmt::print(stderr, "rectify_bench [WIDTHxHEIGHT] [ROUNDS]\n");
    return 2;
  }
  if (argc > 2) rounds = std::max(1, std::atoi(argv[2]));
  const Camera camera = camera_of(width, height);
  const CommonView view{camera.intrinsics[0], 0.5 * (width - 1), 0.5 * (height - 1), width, height};
  const double bandwidth = memory_bandwidth();
  fmt::print("memory: {:.1f} GB/s read and written\n", bandwidth / 1e9);
  for (const PixelType type : {PixelType::u8, PixelType::u16, PixelType::f32}) {
    const Image image = from_float(picture(camera, view.focal_px), type);
    Image ours;
    const double map_s = seconds(rounds, [&] { LensMap(camera, view); });
    const LensMap map(camera, view);
    const double warp_s = seconds(rounds, [&] { ours = warp_to_common_view(image, map, view); });

    const auto& k = camera.intrinsics;
    const cv::Mat K = (cv::Mat_<double>(3, 3) << k[0], 0, k[2], 0, k[1], k[3], 0, 0, 1);
    const cv::Mat d = (cv::Mat_<double>(1, 4) << k[4], k[5], k[6], k[7]);
    const cv::Mat P =
        (cv::Mat_<double>(3, 3) << view.focal_px, 0, view.cx_px, 0, view.focal_px, view.cy_px, 0, 0, 1);
    cv::Mat R(3, 3, CV_64F), map1, map2, theirs;
    // OpenCV's R leads from the camera to the rectified view.
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) R.at<double>(i, j) = camera.cam_from_rig.R(j, i);
    const int cv_type = type == PixelType::u8 ? CV_8U : type == PixelType::u16 ? CV_16U : CV_32F;
    const cv::Mat in(height, width, cv_type, const_cast<std::byte*>(image.bytes.data()));
    const double cv_map_s = seconds(rounds, [&] {
      cv::initUndistortRectifyMap(K, d, R, P, {width, height}, CV_32FC1, map1, map2);
    });
    const double cv_warp_s = seconds(rounds, [&] { cv::remap(in, theirs, map1, map2, cv::INTER_LANCZOS4); });
    Image back{width, height, 1, type, std::vector<std::byte>(image.bytes.size()), {}};
    std::memcpy(back.bytes.data(), theirs.data, back.bytes.size());

    const double bytes = 2.0 * static_cast<double>(image.bytes.size()), ours_s = map_s + warp_s,
                 cv_s = cv_map_s + cv_warp_s;
    fmt::print(
        "{:4} {}x{}: ours {:.2f} ms (map {:.2f}), {:.2f} GB/s, {:.0f} % of memory, {:.1f} dB; OpenCV "
        "{:.1f} ms (map {:.1f}), {:.1f} dB; ratio {:.1f}, of the warp alone {:.1f}\n",
        name_of(type), width, height, 1e3 * ours_s, 1e3 * map_s, bytes / warp_s / 1e9,
        100 * bytes / warp_s / bandwidth, psnr_against(to_float(ours), ours.mask, view), 1e3 * cv_s,
        1e3 * cv_map_s, psnr_against(to_float(back), ours.mask, view), cv_s / ours_s, cv_warp_s / warp_s);
  }
  return 0;
}
