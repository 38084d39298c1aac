#include "calib/board/overlay.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <opencv2/imgproc.hpp>

namespace stuv {
namespace {

const cv::Scalar kGreen(60, 220, 60), kOrange(255, 150, 0), kRed(255, 60, 60), kGrey(120, 120, 220);
constexpr int kShift = 4;  // drawing's coordinates are in sixteenths of a pixel

cv::Point at(const Eigen::Vector2d& q) {
  return {static_cast<int>(std::lround(q.x() * (1 << kShift))),
          static_cast<int>(std::lround(q.y() * (1 << kShift)))};
}

cv::Mat rgb_of(const Image& picture) {
  const ImageF pixels = to_float(picture);
  cv::Mat rgb(picture.height, picture.width, CV_8UC3);
  for (int y = 0; y < picture.height; ++y)
    for (int x = 0; x < picture.width; ++x)
      for (int c = 0; c < 3; ++c)
        rgb.at<cv::Vec3b>(y, x)[c] = static_cast<unsigned char>(
            std::lround(255 * std::clamp(pixels.at(x, y, pixels.channels == 3 ? c : 0), 0.0F, 1.0F)));
  return rgb;
}

/// Lines between corners of a row that follow each other, over the lattice's empty points too.
void draw_rows(cv::Mat& rgb, const Board& board, const BoardView& view) {
  for (int y = 0; y < board.rows; ++y) {
    const Eigen::Vector2d* before = nullptr;
    for (int x = 0; x < board.columns; ++x) {
      const Eigen::Vector2d& q = view.corners_px[static_cast<std::size_t>(y * board.columns + x)];
      if (!q.allFinite()) continue;
      if (before != nullptr) cv::line(rgb, at(*before), at(q), y == 0 ? kRed : kGrey, 1, cv::LINE_AA, kShift);
      before = &q;
    }
  }
}

}  // namespace

Image draw_board_overlay(const Image& picture, const Board& board, const BoardView& view,
                         double usual_sigma_px) {
  cv::Mat rgb = rgb_of(picture);
  const int radius = std::clamp(std::max(rgb.cols, rgb.rows) / 320, 2, 8);
  if (!view.empty()) {
    draw_rows(rgb, board, view);
    for (std::size_t i = 0; i < view.corners_px.size(); ++i)
      if (view.corners_px[i].allFinite())
        cv::circle(rgb, at(view.corners_px[i]), radius << kShift,
                   view.sigma_px[i] > 2 * usual_sigma_px ? kOrange : kGreen, 1, cv::LINE_AA, kShift);
    if (const Eigen::Vector2d& first = view.corners_px.front(); first.allFinite()) {
      const Eigen::Vector2d half = Eigen::Vector2d::Constant(2.0 * radius);
      cv::rectangle(rgb, at(first - half), at(first + half), kRed, 1, cv::LINE_AA, kShift);
    }
  }
  Image image{rgb.cols, rgb.rows, 3, PixelType::u8, {}, {}};
  image.bytes.resize(rgb.total() * 3);
  std::memcpy(image.bytes.data(), rgb.data, image.bytes.size());
  return image;
}

}  // namespace stuv
