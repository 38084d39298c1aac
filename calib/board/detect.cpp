#include "calib/board/detect.h"

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace stuv {
namespace {

/// 8-bit luma, what the detector works on.
cv::Mat grey_of(const Image& picture) {
  const ImageF pixels = to_float(picture);
  cv::Mat grey(picture.height, picture.width, CV_8U);
  for (int y = 0; y < picture.height; ++y) {
    auto* out = grey.ptr<std::uint8_t>(y);
    for (int x = 0; x < picture.width; ++x) {
      const float* p = &pixels.at(x, y);
      const float luma = pixels.channels == 3 ? 0.299F * p[0] + 0.587F * p[1] + 0.114F * p[2] : p[0];
      out[x] = static_cast<std::uint8_t>(std::lround(255 * std::clamp(luma, 0.0F, 1.0F)));
    }
  }
  return grey;
}

/// Mean brightness of the inner squares whose row + column is even, minus that of the others.
double even_minus_odd(const cv::Mat& grey, const std::vector<cv::Point2f>& corners, const Board& board) {
  double sum[2] = {0, 0};
  int count[2] = {0, 0};
  for (int y = 0; y + 1 < board.rows; ++y) {
    for (int x = 0; x + 1 < board.columns; ++x) {
      const auto* c = &corners[static_cast<std::size_t>(y * board.columns + x)];
      const cv::Point2f middle = 0.25F * (c[0] + c[1] + c[board.columns] + c[board.columns + 1]);
      const int px = std::clamp(cvRound(middle.x), 0, grey.cols - 1);
      const int py = std::clamp(cvRound(middle.y), 0, grey.rows - 1);
      sum[(x + y) % 2] += grey.at<std::uint8_t>(py, px);
      ++count[(x + y) % 2];
    }
  }
  return sum[0] / count[0] - sum[1] / count[1];
}

/// A mirrored order (x to the right, y up) cannot come from a board seen from its front.
bool is_mirrored(const std::vector<cv::Point2f>& corners, const Board& board) {
  const cv::Point2f x = corners[static_cast<std::size_t>(board.columns) - 1] - corners.front();
  const cv::Point2f y = corners[corners.size() - static_cast<std::size_t>(board.columns)] - corners.front();
  return x.cross(y) < 0;
}

bool usable(const std::vector<cv::Point2f>& corners, const cv::Mat& grey) {
  return std::all_of(corners.begin(), corners.end(), [&](const cv::Point2f& c) {
    return c.x >= 0 && c.y >= 0 && c.x <= static_cast<float>(grey.cols - 1) &&
           c.y <= static_cast<float>(grey.rows - 1);
  });
}

}  // namespace

std::vector<Eigen::Vector2d> detect_board(const Image& picture, const Board& board) {
  const cv::Mat grey = grey_of(picture);
  std::vector<cv::Point2f> corners;
  const bool found = cv::findChessboardCornersSB(grey, {board.columns, board.rows}, corners,
                                                 cv::CALIB_CB_EXHAUSTIVE | cv::CALIB_CB_ACCURACY);
  if (!found || corners.size() != static_cast<std::size_t>(board.corners()) || !usable(corners, grey))
    return {};
  if (is_mirrored(corners, board)) {
    for (int y = 0; y < board.rows; ++y)
      std::reverse(corners.begin() + y * board.columns, corners.begin() + (y + 1) * board.columns);
  }
  if (!board.is_ambiguous() && even_minus_odd(grey, corners, board) > 0)
    std::reverse(corners.begin(), corners.end());
  std::vector<Eigen::Vector2d> result;
  for (const cv::Point2f& c : corners) result.emplace_back(c.x, c.y);
  return result;
}

}  // namespace stuv
