#pragma once

#include <cmath>
#include <cstdint>
#include <random>

#include "calib/board/detect.h"
#include "calib/board/pattern.h"
#include "capture/synthetic/board.h"
#include "core/camera.h"
#include "core/image.h"

namespace stuv::test {

/// The synthetic room's options for any board.
inline synthetic::BoardOptions drawn(const Board& board) {
  synthetic::BoardOptions options;
  options.columns = board.columns;
  options.rows = board.rows;
  options.square_m = board.square_m;
  options.margin_squares = board.kind == Board::Kind::aprilgrid ? board.gap_steps : 0.5;
  options.spec = board_spec(board);
  options.pattern = std::make_shared<synthetic::BoardPattern>(
      synthetic::BoardPattern{dark_areas(board), board_outline(board), board.inverted});
  return options;
}

inline Camera test_camera(int width = 800, int height = 600, double focal_px = 800) {
  return {"cam",
          "LENSMODEL_OPENCV4",
          {focal_px, focal_px, 0.5 * (width - 1), 0.5 * (height - 1), -0.1, 0.03, 0, 0},
          width,
          height,
          {}};
}

/// The board's middle `distance_m` before the camera and `aside` of it, turned.
inline Pose board_pose(const Board& board, double distance_m, const Eigen::Vector3d& turn,
                       const Eigen::Vector2d& aside = {0, 0}) {
  Pose pose;
  pose.R = rotation_from_vector(turn);
  const Eigen::Vector2d middle = board_outline(board).center();
  pose.t =
      Eigen::Vector3d(aside.x(), aside.y(), distance_m) - pose.R * Eigen::Vector3d(middle.x(), middle.y(), 0);
  return pose;
}

struct Spoil {
  double blur_px = 0;  ///< deviation of a Gaussian
  double light = 1;    ///< factor
  double noise = 0;    ///< deviation, of 255
  std::uint64_t seed = 1;
};

inline ImageF blurred(const ImageF& in, double sigma) {
  if (sigma <= 0) return in;
  const int reach = static_cast<int>(std::ceil(4 * sigma));
  std::vector<float> kernel;
  float sum = 0;
  for (int i = -reach; i <= reach; ++i)
    kernel.push_back(static_cast<float>(std::exp(-0.5 * i * i / (sigma * sigma))));
  for (const float k : kernel) sum += k;
  ImageF rows = in, out = in;
  const auto pass = [&](const ImageF& from, ImageF& to, int dx, int dy) {
    for (int y = 0; y < in.height; ++y)
      for (int x = 0; x < in.width; ++x) {
        float total = 0;
        for (int i = -reach; i <= reach; ++i)
          total += kernel[static_cast<std::size_t>(i + reach)] *
                   from.at(std::clamp(x + i * dx, 0, in.width - 1), std::clamp(y + i * dy, 0, in.height - 1));
        to.at(x, y) = total / sum;
      }
  };
  pass(in, rows, 1, 0);
  pass(rows, out, 0, 1);
  return out;
}

/// The board as a camera at the rig's origin takes it, 8 bit.
inline Image photograph(const Board& board, const Camera& camera, const Pose& pose, const Spoil& spoil = {}) {
  ImageF light = blurred(synthetic::render_board(drawn(board), camera, pose), spoil.blur_px);
  std::mt19937_64 random(spoil.seed);
  std::normal_distribution<double> noise(0, spoil.noise / 255);
  for (float& v : light.data)
    v = static_cast<float>(v * spoil.light + (spoil.noise > 0 ? noise(random) : 0.0));
  return from_float(light, PixelType::u8);
}

/// Found minus true, of all corners that were found, [px]; NaN pairs left out. Also their sigmas.
struct Errors {
  std::vector<Eigen::Vector2d> error_px;
  std::vector<double> sigma_px;

  double rms() const {
    double sum = 0;
    for (const auto& e : error_px) sum += e.squaredNorm();
    return std::sqrt(sum / (2.0 * static_cast<double>(error_px.size())));
  }
  double worst() const {
    double worst = 0;
    for (const auto& e : error_px) worst = std::max(worst, e.norm());
    return worst;
  }
  /// rms of error / sigma
  double normalised_rms() const {
    double sum = 0;
    for (std::size_t i = 0; i < error_px.size(); ++i)
      sum += error_px[i].squaredNorm() / (sigma_px[i] * sigma_px[i]);
    return std::sqrt(sum / (2.0 * static_cast<double>(error_px.size())));
  }
};

inline void add_errors(const Board& board, const Camera& camera, const Pose& pose, const BoardView& view,
                       Errors& errors) {
  const std::vector<Eigen::Vector2d> truth = synthetic::board_pixels(drawn(board), camera, pose);
  for (std::size_t i = 0; i < view.corners_px.size(); ++i)
    if (view.corners_px[i].allFinite()) {
      errors.error_px.push_back(view.corners_px[i] - truth[i]);
      errors.sigma_px.push_back(view.sigma_px[i]);
    }
}

}  // namespace stuv::test
