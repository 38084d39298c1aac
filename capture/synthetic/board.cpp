#include "capture/synthetic/board.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "capture/synthetic/lens_grid.h"
#include "capture/synthetic/random.h"
#include "core/parallel.h"

namespace stuv::synthetic {
namespace {

constexpr float kWhite = 0.75F, kBlack = 0.04F, kBackdrop = 0.18F;

double bend_at(const BoardOptions& board, double x_m, double y_m) {
  const double xr = 2 * x_m / ((board.columns - 1) * board.square_m) - 1;
  const double yr = 2 * y_m / ((board.rows - 1) * board.square_m) - 1;
  return board.bend_m[0] * (1 - xr * xr) + board.bend_m[1] * (1 - yr * yr);
}

/// The outer squares or tags [m].
Eigen::AlignedBox2d outline_of(const BoardOptions& board) {
  if (board.pattern) return board.pattern->outline;
  const double s = board.square_m;
  return {Eigen::Vector2d(-s, -s), Eigen::Vector2d(board.columns * s, board.rows * s)};
}

/// Share of [x - w/2, x + w/2] that lies in [low, high].
float averaged_inside(float x, float w, float low, float high) {
  const float scale = 1 / std::max(w, 1e-6F);
  return std::clamp((x - low) * scale + 0.5F, 0.0F, 1.0F) * std::clamp((high - x) * scale + 0.5F, 0.0F, 1.0F);
}

/// Average over [x - w/2, x + w/2], w <= 1, of the square wave that is 1 on [0, 1), -1 on [1, 2), and so on,
/// from -1 to n, and 0 beyond.
float averaged_wave(float x, float w, int n) {
  const float nearest = std::floor(x + 0.5F);
  const int edge = static_cast<int>(nearest);
  if (edge < -1 || edge > n) return 0;
  const float rising = (edge & 1) == 0 ? 1.0F : -1.0F;
  const float side = std::clamp(2 * (x - nearest) / std::max(w, 1e-6F), -1.0F, 1.0F);
  if (edge == -1) return rising * 0.5F * (side + 1);
  if (edge == n) return rising * 0.5F * (side - 1);
  return rising * side;
}

float overlap(float x, float w, float low, float high) {
  return std::max(0.0F, std::min(x + 0.5F * w, high) - std::max(x - 0.5F * w, low)) / w;
}

/// A pattern's boxes cut up by squares of the lattice, so that only those near a place are looked at.
class PatternIndex {
 public:
  explicit PatternIndex(const BoardOptions& board) {
    if (!board.pattern) return;
    const double s = board.square_m;
    const Eigen::AlignedBox2d outline = board.pattern->outline;
    origin_ = (outline.min() / s).array().floor().cast<int>();
    const Eigen::Vector2i end = (outline.max() / s).array().ceil().cast<int>();
    width_ = end.x() - origin_.x();
    height_ = end.y() - origin_.y();
    cells_.resize(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_));
    for (const Eigen::AlignedBox2d& box : board.pattern->dark)
      add(Eigen::AlignedBox2f((box.min() / s).cast<float>(), (box.max() / s).cast<float>()));
  }

  /// Share of the box of wx by wy squares around (x, y) that is dark.
  float dark(float x, float y, float wx, float wy) const {
    wx = std::max(wx, 1e-6F);
    wy = std::max(wy, 1e-6F);
    const int x0 = column(x - 0.5F * wx), x1 = column(x + 0.5F * wx);
    const int y0 = row(y - 0.5F * wy), y1 = row(y + 0.5F * wy);
    float sum = 0;
    for (int cy = y0; cy <= y1; ++cy)
      for (int cx = x0; cx <= x1; ++cx)
        for (const Eigen::AlignedBox2f& b : cell(cx, cy))
          sum += overlap(x, wx, b.min().x(), b.max().x()) * overlap(y, wy, b.min().y(), b.max().y());
    return sum;
  }

 private:
  int column(float x) const {
    return std::clamp(static_cast<int>(std::floor(x)) - origin_.x(), 0, width_ - 1);
  }
  int row(float y) const { return std::clamp(static_cast<int>(std::floor(y)) - origin_.y(), 0, height_ - 1); }
  const std::vector<Eigen::AlignedBox2f>& cell(int cx, int cy) const {
    return cells_[static_cast<std::size_t>(cy) * static_cast<std::size_t>(width_) +
                  static_cast<std::size_t>(cx)];
  }
  void add(const Eigen::AlignedBox2f& box) {
    for (int cy = row(box.min().y()); cy <= row(box.max().y()); ++cy)
      for (int cx = column(box.min().x()); cx <= column(box.max().x()); ++cx) {
        const Eigen::Vector2f corner = (origin_ + Eigen::Vector2i(cx, cy)).cast<float>();
        const Eigen::AlignedBox2f part =
            box.intersection(Eigen::AlignedBox2f(corner, corner + Eigen::Vector2f::Ones()));
        if (!part.isEmpty() && part.volume() > 0)
          cells_[static_cast<std::size_t>(cy) * static_cast<std::size_t>(width_) +
                 static_cast<std::size_t>(cx)]
              .push_back(part);
      }
  }

  Eigen::Vector2i origin_ = {0, 0};
  int width_ = 0, height_ = 0;
  std::vector<std::vector<Eigen::AlignedBox2f>> cells_;
};

/// Part of the box of wx by wy squares around (x, y) that is black.
float dark_share(const BoardOptions& board, const PatternIndex& index, float x, float y, float wx, float wy) {
  if (board.pattern) {
    const float dark = index.dark(x, y, wx, wy);
    return board.pattern->inverted ? 1 - dark : dark;
  }
  const auto columns = static_cast<float>(board.columns), rows = static_cast<float>(board.rows);
  const float squares = averaged_inside(x, wx, -1, columns) * averaged_inside(y, wy, -1, rows);
  return 0.5F * (squares - averaged_wave(x, std::min(wx, 1.0F), board.columns) *
                               averaged_wave(y, std::min(wy, 1.0F), board.rows));
}

/// Light of the board around (x, y), in squares from the first inner corner, over a box of wx by wy squares.
float board_light(const BoardOptions& board, const PatternIndex& index, float x, float y, float wx,
                  float wy) {
  const auto columns = static_cast<float>(board.columns), rows = static_cast<float>(board.rows);
  const Eigen::AlignedBox2d outline = outline_of(board);
  const auto margin = static_cast<float>(board.margin_squares);
  const Eigen::Vector2f low = (outline.min() / board.square_m).cast<float>().array() - margin,
                        high = (outline.max() / board.square_m).cast<float>().array() + margin;
  const float sheet = averaged_inside(x, wx, low.x(), high.x()) * averaged_inside(y, wy, low.y(), high.y());
  const float dark = dark_share(board, index, x, y, wx, wy);
  // A little shading over the sheet, as no lamp lights evenly.
  const float shading = 1 - 0.1F * (x / columns - 0.5F) - 0.08F * (y / rows - 0.5F);
  const float on_sheet = shading * (kWhite + (kBlack - kWhite) * dark);
  return kBackdrop + (on_sheet - kBackdrop) * sheet;
}

/// Where a ray of the camera meets the board.
struct BoardPlane {
  const BoardOptions& board;
  PatternIndex pattern;
  Eigen::Vector3d origin;  // the camera's centre in the board's frame
  Eigen::Matrix3d board_from_cam;
  bool bent;

  BoardPlane(const BoardOptions& options, const Pose& cam_from_board)
      : board(options),
        pattern(options),
        origin(cam_from_board.centre()),
        board_from_cam(cam_from_board.R.transpose()),
        bent(options.bend_m[0] != 0 || options.bend_m[1] != 0) {}

  /// In squares from the first inner corner; false if the board's plane is not hit.
  bool hit(const Eigen::Vector2d& ray, Eigen::Vector2d& squares) const {
    const Eigen::Vector3d d = board_from_cam * ray.homogeneous();
    double distance = -origin.z() / d.z();
    if (!(distance > 0)) return false;
    Eigen::Vector2d p = origin.head<2>() + distance * d.head<2>();
    // A bend is small against the distance: each round gains a factor of slope times tilt.
    for (int round = 0; bent && round < 8; ++round) {
      distance = (bend_at(board, p.x(), p.y()) - origin.z()) / d.z();
      p = origin.head<2>() + distance * d.head<2>();
    }
    squares = p / board.square_m;
    return true;
  }
};

void render_row(const BoardPlane& plane, const LensGrid& lens, int y, int first, int last, ImageF& image) {
  constexpr double offset = 0.25;
  const LensGrid::Row rays[2] = {{lens, y - offset}, {lens, y + offset}};
  float* out = image.row(y);
  for (int x = first; x < last; ++x) {
    Eigen::Vector2d p[2][2];
    bool all_hit = true;
    for (int j = 0; j < 2; ++j)
      for (int i = 0; i < 2; ++i) all_hit &= plane.hit(rays[j](x - offset + 2 * offset * i), p[j][i]);
    if (!all_hit) {
      out[x] = kBackdrop;
      continue;
    }
    // Samples are half a pixel apart: the box that each stands for is as wide as the step to its neighbour.
    const Eigen::Vector2d w = (p[0][1] - p[0][0]).cwiseAbs() + (p[1][0] - p[0][0]).cwiseAbs();
    float sum = 0;
    for (const auto& row : p)
      for (const Eigen::Vector2d& s : row)
        sum += board_light(plane.board, plane.pattern, static_cast<float>(s.x()), static_cast<float>(s.y()),
                           static_cast<float>(w.x()), static_cast<float>(w.y()));
    out[x] = 0.25F * sum;
  }
}

/// The rectangle of the picture outside of which there is backdrop only.
Eigen::AlignedBox2i outline(const BoardOptions& board, const Camera& camera, const Pose& cam_from_board) {
  const Eigen::AlignedBox2i picture(Eigen::Vector2i(0, 0), Eigen::Vector2i(camera.width, camera.height));
  constexpr int steps = 24, spare_px = 4;
  std::vector<Eigen::Vector3d> points;
  Eigen::AlignedBox2d sheet = outline_of(board);
  sheet.min().array() -= board.margin_squares * board.square_m;
  sheet.max().array() += board.margin_squares * board.square_m;
  for (int j = 0; j <= steps; ++j)
    for (int i = 0; i <= steps; ++i) {
      const double x = sheet.min().x() + sheet.sizes().x() * i / steps,
                   y = sheet.min().y() + sheet.sizes().y() * j / steps;
      points.emplace_back(cam_from_board * Eigen::Vector3d(x, y, bend_at(board, x, y)));
      if (points.back().z() < 0.5 * points.back().norm())
        return picture;  // the lens model may fold out there
    }
  Eigen::AlignedBox2i box;
  for (const Eigen::Vector2d& q : project(camera, points)) {
    const Eigen::Vector2d inside = q.cwiseMax(-1e6).cwiseMin(1e6);
    box.extend(
        Eigen::Vector2i(inside.array().floor().cast<int>().matrix() - Eigen::Vector2i::Constant(spare_px)));
    box.extend(
        Eigen::Vector2i(inside.array().ceil().cast<int>().matrix() + Eigen::Vector2i::Constant(spare_px)));
  }
  return box.intersection(picture);
}

/// Whether the camera sees all squares, with a few pixels to spare.
bool sees_whole(const BoardOptions& board, const Camera& camera, const Pose& rig_from_board) {
  constexpr double spare_px = 6;
  const Eigen::AlignedBox2d outline = outline_of(board);
  const Eigen::Vector2d low = outline.min(), middle = outline.center(), high = outline.max();
  std::vector<Eigen::Vector3d> points;
  const Pose cam_from_board = camera.cam_from_rig * rig_from_board;
  for (const double x : {low.x(), middle.x(), high.x()})
    for (const double y : {low.y(), middle.y(), high.y()}) {
      points.emplace_back(cam_from_board * Eigen::Vector3d(x, y, 0));
      if (points.back().z() < 0.05) return false;
    }
  for (const Eigen::Vector2d& q : project(camera, points))
    if (!(q.x() >= spare_px && q.y() >= spare_px && q.x() <= camera.width - 1 - spare_px &&
          q.y() <= camera.height - 1 - spare_px))
      return false;
  return true;
}

double share_seeing(const BoardOptions& board, const std::vector<Camera>& cameras,
                    const Pose& rig_from_board) {
  int seeing = 0;
  for (const Camera& camera : cameras) seeing += sees_whole(board, camera, rig_from_board) ? 1 : 0;
  return static_cast<double>(seeing) / static_cast<double>(cameras.size());
}

/// A pose to try: `spread` in 0..1 is how far off the middle it aims, `far` a factor on the distance.
Pose candidate(const BoardOptions& board, const std::vector<Camera>& cameras, std::uint64_t h, int index,
               double spread, double far) {
  constexpr double golden_angle = 2.399963229728653;
  const auto draw = [&](std::uint64_t key, double low, double high) {
    return low + (high - low) * uniform(hash({h, key}));
  };
  const double width = outline_of(board).sizes().x(), height = outline_of(board).sizes().y();
  const Camera& camera = cameras.front();
  const double fx = camera.intrinsics[0], fy = camera.intrinsics[1];
  // Near and far in turn: the board takes from nearly all to less than half of the picture.
  const double share = std::array{0.80, 0.55, 0.70, 0.42}[static_cast<std::size_t>(index % 4)];
  const double z = far / share * std::max(fx * width / camera.width, fy * height / camera.height);
  // Tilted to all sides; the first one nearly straight on.
  const double azimuth = golden_angle * index + draw(1, -0.4, 0.4);
  const double tilt = index == 0 ? 0.1 : draw(2, 0.35, 0.75);
  const Eigen::Vector3d axis(std::cos(azimuth), std::sin(azimuth), 0);
  const double aim = golden_angle * (index + 0.5) * 1.7;
  const double room_x = 0.5 * camera.width / fx * z, room_y = 0.5 * camera.height / fy * z;
  Pose pose;
  pose.R = Eigen::AngleAxisd(tilt, axis).toRotationMatrix() *
           Eigen::AngleAxisd(draw(3, -0.35, 0.35), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  const Eigen::Vector3d middle_rig(spread * std::cos(aim) * room_x, spread * std::sin(aim) * room_y, z);
  const Eigen::Vector3d middle_board(0.5 * (board.columns - 1) * board.square_m,
                                     0.5 * (board.rows - 1) * board.square_m, 0);
  pose.t = middle_rig - pose.R * middle_board;
  return pose;
}

}  // namespace

std::string problem_of(const BoardOptions& board) {
  if (!board.spec.empty() && !board.pattern) return "";  // its own reader judges it
  if (board.columns < 2 || board.rows < 2 || board.columns > 1000 || board.rows > 1000)
    return fmt::format("corners is {}x{}, but each must lie in 2..1000", board.columns, board.rows);
  if (!board.pattern && (board.columns < 3 || board.rows < 3 || board.columns > 200 || board.rows > 200))
    return fmt::format("corners is {}x{}, but each must lie in 3..200", board.columns, board.rows);
  if (!(board.square_m > 0 && std::isfinite(board.square_m)))
    return fmt::format("square_m is {}, but must be above 0", board.square_m);
  if (!(board.margin_squares >= 0 && std::isfinite(board.margin_squares)))
    return fmt::format("margin_squares is {}, but must be 0 or more", board.margin_squares);
  for (const double bend : board.bend_m)
    if (!(std::abs(bend) <= board.square_m))
      return fmt::format("bend_m is {}, but must be less than a square", bend);
  return "";
}

std::vector<Eigen::Vector3d> board_corners(const BoardOptions& board) {
  std::vector<Eigen::Vector3d> corners;
  for (int row = 0; row < board.rows; ++row)
    for (int column = 0; column < board.columns; ++column) {
      const double x = column * board.square_m, y = row * board.square_m;
      corners.emplace_back(x, y, bend_at(board, x, y));
    }
  return corners;
}

std::vector<Eigen::Vector2d> board_pixels(const BoardOptions& board, const Camera& camera,
                                          const Pose& rig_from_board) {
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  std::vector<Eigen::Vector3d> points = board_corners(board);
  const Pose cam_from_board = camera.cam_from_rig * rig_from_board;
  for (Eigen::Vector3d& point : points) point = cam_from_board * point;
  std::vector<Eigen::Vector2d> pixels = project(camera, points);
  for (std::size_t i = 0; i < points.size(); ++i)
    if (!(points[i].z() > 0)) pixels[i] = {nan, nan};
  return pixels;
}

std::vector<Pose> board_poses(const BoardOptions& board, const std::vector<Camera>& cameras, int count,
                              std::uint64_t seed) {
  constexpr int attempts = 240;
  constexpr double wanted_share = 0.8;
  std::vector<Pose> poses;
  for (int index = 0; index < count; ++index) {
    Pose best;
    double best_share = -1;
    for (int attempt = 0; attempt < attempts && best_share < wanted_share; ++attempt) {
      // Less and less demanding: nearer the middle, and then farther away.
      const double ease = static_cast<double>(attempt) / attempts;
      const std::uint64_t h =
          hash({seed, 0xB0A2D, static_cast<std::uint64_t>(index), static_cast<std::uint64_t>(attempt)});
      const Pose pose = candidate(board, cameras, h, index, 0.6 * (1 - ease), 1 + 1.5 * ease * ease);
      const double share = share_seeing(board, cameras, pose);
      if (share > best_share) {
        best = pose;
        best_share = share;
      }
    }
    poses.push_back(best);
  }
  return poses;
}

ImageF render_board(const BoardOptions& board, const Camera& camera, const Pose& rig_from_board) {
  const LensGrid lens(camera);
  const Pose cam_from_board = camera.cam_from_rig * rig_from_board;
  const BoardPlane plane(board, cam_from_board);
  const Eigen::AlignedBox2i box = outline(board, camera, cam_from_board);
  ImageF image(camera.width, camera.height, 1, kBackdrop);
  if (box.isEmpty()) return image;
  parallel_for(box.sizes().y(), [&](int i) {
    render_row(plane, lens, box.min().y() + i, box.min().x(), box.max().x(), image);
  });
  return image;
}

}  // namespace stuv::synthetic
