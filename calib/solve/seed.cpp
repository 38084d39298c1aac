#include "calib/solve/seed.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <opencv2/calib3d.hpp>
#include <optional>
#include <stdexcept>

#include "core/error.h"
#include "core/median.h"

namespace stuv {
namespace {

using Matrix = std::vector<std::vector<int>>;  // [set][camera]: index of the observation, -1 for none

Matrix index_of(const Observations& in) {
  Matrix index(in.set_names.size(), std::vector<int>(in.camera_names.size(), -1));
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    const BoardObservation& b = in.boards[i];
    if (b.camera < 0 || b.camera >= static_cast<int>(in.camera_names.size()) || b.set < 0 ||
        b.set >= static_cast<int>(in.set_names.size()) ||
        b.corners_px.size() != static_cast<std::size_t>(in.board.corners()) ||
        (!b.weights.empty() && b.weights.size() != b.corners_px.size()))
      throw std::invalid_argument("board observation does not fit the cameras, sets or board");
    index[b.set][b.camera] = static_cast<int>(i);
  }
  return index;
}

bool is_there(const BoardObservation& b, std::size_t corner) {
  return (b.weights.empty() || b.weights[corner] > 0) && b.corners_px[corner].allFinite();
}

/// The corners of a view that are there.
struct Points {
  std::vector<int> corner;
  std::vector<cv::Point3d> board;
  std::vector<cv::Point2d> pixel;  ///< from the picture's middle
};

Points points_of(const Observations& in, const BoardObservation& b,
                 const std::vector<Eigen::Vector3d>& model) {
  const Eigen::Vector2d middle = 0.5 * (in.size_px[b.camera].cast<double>() - Eigen::Vector2d::Ones());
  Points points;
  for (std::size_t i = 0; i < model.size(); ++i) {
    if (!is_there(b, i)) continue;
    points.corner.push_back(static_cast<int>(i));
    points.board.emplace_back(model[i].x(), model[i].y(), 0.0);
    points.pixel.emplace_back(b.corners_px[i].x() - middle.x(), b.corners_px[i].y() - middle.y());
  }
  return points;
}

std::vector<cv::Point2d> plane_of(const Points& points) {
  std::vector<cv::Point2d> plane;
  for (const cv::Point3d& p : points.board) plane.emplace_back(p.x, p.y);
  return plane;
}

/// Takes out what is far from the homography that most corners agree on, and says which it was. Distortion
/// and model error are no outliers: the bound is eight times the residual that 60 % stay below, and at least
/// a hundredth of the view's size.
std::vector<bool> take_out_suspects(Points& points, std::size_t corners) {
  std::vector<bool> suspect(corners, false);
  const std::vector<cv::Point2d> plane = plane_of(points);
  const cv::Mat H = cv::findHomography(plane, points.pixel, cv::LMEDS);
  if (H.empty()) return suspect;
  std::vector<cv::Point2d> predicted;
  cv::perspectiveTransform(plane, predicted, H);
  Eigen::AlignedBox2d box;
  std::vector<double> error;
  for (std::size_t i = 0; i < plane.size(); ++i) {
    error.push_back(cv::norm(predicted[i] - points.pixel[i]));
    box.extend(Eigen::Vector2d(predicted[i].x, predicted[i].y));
  }
  const double most_px = std::max(0.01 * box.sizes().norm(), 8 * value_of_rank(error, 0.6));
  Points kept;
  for (std::size_t i = 0; i < plane.size(); ++i) {
    if (error[i] > most_px) {
      suspect[points.corner[i]] = true;
      continue;
    }
    kept.corner.push_back(points.corner[i]);
    kept.board.push_back(points.board[i]);
    kept.pixel.push_back(points.pixel[i]);
  }
  if (kept.board.size() < 6) return std::vector<bool>(corners, false);
  points = kept;
  return suspect;
}

/// Normal equation of w = 1/f^2 from one homography: sum a^2 w = -sum a b.
struct FocalEquation {
  double aa = 0, ab = 0;
};

FocalEquation focal_equation(const Points& points) {
  cv::Mat H = cv::findHomography(plane_of(points), points.pixel, 0);
  if (H.empty()) return {};
  // Scaled so that views weigh by the angle they are seen under and not by the board's units.
  const double scale = 1 / std::sqrt(H.col(0).dot(H.col(0)) + H.col(1).dot(H.col(1)));
  const auto h = [&](int r, int c) { return scale * H.at<double>(r, c); };
  FocalEquation e;
  const auto add = [&e](double a, double b) { e.aa += a * a, e.ab += a * b; };
  add(h(0, 0) * h(0, 1) + h(1, 0) * h(1, 1), h(2, 0) * h(2, 1));
  add(h(0, 0) * h(0, 0) + h(1, 0) * h(1, 0) - h(0, 1) * h(0, 1) - h(1, 1) * h(1, 1),
      h(2, 0) * h(2, 0) - h(2, 1) * h(2, 1));
  return e;
}

double pinhole_focal(const std::vector<const Points*>& views, double width) {
  FocalEquation sum;
  for (const Points* points : views) {
    const FocalEquation e = focal_equation(*points);
    sum.aa += e.aa;
    sum.ab += e.ab;
  }
  const double f = 1 / std::sqrt(-sum.ab / sum.aa);
  // Boards that are all parallel to the sensor say nothing: then a lens of 53 degrees.
  return std::isfinite(f) && f > 0.2 * width && f < 20 * width ? f : width;
}

/// Of unit length.
Eigen::Vector3d stereographic_direction(const cv::Point2d& pixel, double focal_px) {
  const double r = std::hypot(pixel.x, pixel.y), theta = 2 * std::atan(0.5 * r / focal_px);
  const double scale = r > 0 ? std::sin(theta) / r : 0;
  return {scale * pixel.x, scale * pixel.y, std::cos(theta)};
}

/// Directions through a lens, turned so that their mean is the z axis, on the plane z = 1: any view of a
/// board that is less than 180 degrees wide is one of a pinhole camera.
struct Sight {
  Eigen::Matrix3d cam_from_sight;
  std::vector<cv::Point2d> plane;
};

std::optional<Sight> sight_of(const std::vector<Eigen::Vector3d>& directions) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& d : directions) mean += d;
  const Eigen::Quaterniond turn = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), mean);
  Sight sight{turn.toRotationMatrix(), {}};
  for (const Eigen::Vector3d& d : directions) {
    const Eigen::Vector3d p = sight.cam_from_sight.transpose() * d;
    if (!(p.z() > 0.05)) return std::nullopt;
    sight.plane.emplace_back(p.x() / p.z(), p.y() / p.z());
  }
  return sight;
}

std::vector<Eigen::Vector3d> stereographic_directions(const Points& points, double focal_px) {
  std::vector<Eigen::Vector3d> directions;
  for (const cv::Point2d& p : points.pixel) directions.push_back(stereographic_direction(p, focal_px));
  return directions;
}

/// How far the corners are from a plane's picture [px^2], if the lens had this focal length.
double bend(const Points& points, double focal_px) {
  const auto directions = stereographic_directions(points, focal_px);
  const std::optional<Sight> sight = sight_of(directions);
  if (!sight) return std::numeric_limits<double>::infinity();
  const std::vector<cv::Point2d> plane = plane_of(points);
  const cv::Mat H = cv::findHomography(plane, sight->plane, 0);
  if (H.empty()) return std::numeric_limits<double>::infinity();
  std::vector<cv::Point2d> predicted;
  cv::perspectiveTransform(plane, predicted, H);
  double sum = 0;
  for (std::size_t i = 0; i < plane.size(); ++i) {
    const Eigen::Vector3d d =
        (sight->cam_from_sight * Eigen::Vector3d(predicted[i].x, predicted[i].y, 1)).normalized();
    const double scale = 2 * focal_px / (1 + d.z());
    sum += std::pow(scale * d.x() - points.pixel[i].x, 2) + std::pow(scale * d.y() - points.pixel[i].y, 2);
  }
  return sum;
}

/// Least bend over focal lengths from a tenth of the width to three times: a search on a logarithmic grid,
/// then between its neighbours. A longer lens is a pinhole.
double stereographic_focal(const std::vector<const Points*>& views, double width) {
  constexpr std::size_t kMostViews = 40;
  const double pinhole = pinhole_focal(views, width);
  if (pinhole > 1.5 * width) return pinhole;
  const std::size_t step = 1 + (views.size() - 1) / kMostViews;
  const auto cost = [&](double log_f) {
    double sum = 0;
    for (std::size_t i = 0; i < views.size(); i += step) sum += bend(*views[i], std::exp(log_f));
    return sum;
  };
  double best = std::log(width), step_log = std::log(1.15), least = std::numeric_limits<double>::infinity();
  for (double f = std::log(0.1 * width); f < std::log(3 * width); f += step_log)
    if (const double c = cost(f); c < least) least = c, best = f;
  for (; step_log > 1e-3; step_log *= 0.5)
    for (const double f : {best - step_log / 2, best + step_log / 2})
      if (const double c = cost(f); c < least) least = c, best = f;
  return std::exp(best);
}

std::vector<double> focal_lengths(const Observations& in, const std::vector<Points>& points, SeedLens lens) {
  std::map<std::pair<int, int>, std::vector<const Points*>> by_size;
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    const Eigen::Vector2i size = in.size_px[in.boards[i].camera];
    by_size[{size.x(), size.y()}].push_back(&points[i]);
  }
  std::map<std::pair<int, int>, double> focal_px;
  for (const auto& [size, views] : by_size) {
    const double width = std::max(size.first, size.second);
    focal_px[size] =
        lens == SeedLens::pinhole ? pinhole_focal(views, width) : stereographic_focal(views, width);
  }
  std::vector<double> result;
  for (const Eigen::Vector2i& size : in.size_px) result.push_back(focal_px[{size.x(), size.y()}]);
  return result;
}

std::vector<Eigen::Vector3d> directions_of(const Points& points, SeedLens lens, double focal_px) {
  if (lens == SeedLens::stereographic) return stereographic_directions(points, focal_px);
  std::vector<Eigen::Vector3d> directions;
  for (const cv::Point2d& p : points.pixel)
    directions.push_back(Eigen::Vector3d(p.x / focal_px, p.y / focal_px, 1).normalized());
  return directions;
}

std::vector<Eigen::Vector3d> directions_of(const Points& points, const Camera& known) {
  std::vector<Eigen::Vector2d> pixels;
  for (const cv::Point2d& p : points.pixel)
    pixels.emplace_back(p.x + 0.5 * (known.width - 1), p.y + 0.5 * (known.height - 1));
  return unproject(known, pixels);
}

Pose board_pose(const Points& points, const std::vector<Eigen::Vector3d>& directions) {
  const std::optional<Sight> sight = sight_of(directions);
  if (!sight) return {Eigen::Matrix3d::Identity(), {0, 0, 1}};
  const cv::Matx33d K = cv::Matx33d::eye();
  cv::Vec3d r, t;
  cv::solvePnP(points.board, sight->plane, K, cv::noArray(), r, t, false, cv::SOLVEPNP_IPPE);
  cv::solvePnP(points.board, sight->plane, K, cv::noArray(), r, t, true, cv::SOLVEPNP_ITERATIVE);
  const Pose sight_from_board{rotation_from_vector({r[0], r[1], r[2]}), {t[0], t[1], t[2]}};
  return Pose{sight->cam_from_sight, Eigen::Vector3d::Zero()} * sight_from_board;
}

/// How far apart two poses are: metres at a lever of one `lever_m`.
double distance(const Pose& a, const Pose& b, double lever_m) {
  return (a.t - b.t).norm() + lever_m * (a.R - b.R).norm();
}

/// The candidate that lies nearest to the others (least sum of distances cut off at `lever_m`).
Pose medoid(const std::vector<Pose>& candidates, double lever_m) {
  double best = std::numeric_limits<double>::infinity();
  Pose result;
  for (const Pose& a : candidates) {
    double sum = 0;
    for (const Pose& b : candidates) sum += std::min(lever_m, distance(a, b, lever_m));
    // Between candidates as good as each other, the one that turns least: cameras of an array look one way.
    sum += 1e-3 * lever_m * (a.R - Eigen::Matrix3d::Identity()).norm();
    if (sum < best) best = sum, result = a;
  }
  return result;
}

/// board_from_turned: the same board with its corners counted from the other end.
Pose half_turn(const Board& board) {
  Pose turn;
  turn.R.diagonal() << -1, -1, 1;
  turn.t = board.square_m * Eigen::Vector3d(board.columns - 1, board.rows - 1, 0);
  return turn;
}

struct Chain {
  const Observations& in;
  const Matrix& index;
  const std::vector<Pose>& cam_from_board;
  double lever_m;

  int common(int a, int b) const {
    return static_cast<int>(std::count_if(
        index.begin(), index.end(), [&](const std::vector<int>& set) { return set[a] >= 0 && set[b] >= 0; }));
  }

  /// b_from_a, from all boards that both see.
  Pose relative(int a, int b) const {
    std::vector<Pose> candidates;
    for (const std::vector<int>& set : index) {
      if (set[a] < 0 || set[b] < 0) continue;
      const Pose board_from_a = cam_from_board[set[a]].inverse();
      candidates.push_back(cam_from_board[set[b]] * board_from_a);
      if (in.board.is_ambiguous())
        candidates.push_back(cam_from_board[set[b]] * half_turn(in.board) * board_from_a);
    }
    return medoid(candidates, lever_m);
  }
};

/// Grows a tree from camera 0, always by the pair that shares most boards (Prim).
std::vector<Pose> camera_poses(const Chain& chain) {
  const int n = static_cast<int>(chain.in.camera_names.size());
  std::vector<Pose> cam_from_ref(n);
  std::vector<bool> placed(n, false);
  placed[0] = true;
  for (int count = 1; count < n; ++count) {
    int best = 0, from = -1, to = -1;
    for (int a = 0; a < n; ++a)
      for (int b = 0; b < n; ++b)
        if (placed[a] && !placed[b] && chain.common(a, b) > best) best = chain.common(a, b), from = a, to = b;
    if (to < 0) throw std::invalid_argument("cameras that do not hang together");
    cam_from_ref[to] = chain.relative(from, to) * cam_from_ref[from];
    placed[to] = true;
  }
  return cam_from_ref;
}

/// The board's pose in the reference frame, and with an ambiguous board every camera's corners in that order.
Pose place_board(Observations& in, const std::vector<int>& set, Seed& seed,
                 const std::vector<Pose>& cam_from_board, double lever_m) {
  const Pose turn = half_turn(in.board);
  std::vector<Pose> candidates;
  for (std::size_t c = 0; c < set.size(); ++c) {
    if (set[c] < 0) continue;
    Pose pose = seed.cam_from_ref[c].inverse() * cam_from_board[set[c]];
    const Pose turned = pose * turn;
    if (in.board.is_ambiguous() && !candidates.empty() &&
        distance(turned, candidates.front(), lever_m) < distance(pose, candidates.front(), lever_m)) {
      BoardObservation& b = in.boards[set[c]];
      std::reverse(b.corners_px.begin(), b.corners_px.end());
      std::reverse(b.weights.begin(), b.weights.end());
      std::reverse(seed.suspect[set[c]].begin(), seed.suspect[set[c]].end());
      pose = turned;
    }
    candidates.push_back(pose);
  }
  return candidates.empty() ? Pose{} : medoid(candidates, lever_m);
}

}  // namespace

Seed seed_solve(Observations& in, SeedLens lens, const std::vector<Camera>& known) {
  const Matrix index = index_of(in);
  const std::vector<Eigen::Vector3d> model = board_points(in.board);
  Seed seed;
  seed.lens = lens;
  std::vector<Points> points;
  for (const BoardObservation& b : in.boards) {
    points.push_back(points_of(in, b, model));
    if (points.back().board.size() < 6)
      throw Error("camera " + in.camera_names[b.camera],
                  "has fewer than 6 finite corners in set " + in.set_names[b.set], "leave this view out");
    seed.suspect.push_back(take_out_suspects(points.back(), model.size()));
  }
  seed.focal_px = focal_lengths(in, points, lens);
  std::vector<Pose> cam_from_board;
  double lever_m = 0;
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    const int camera = in.boards[i].camera;
    cam_from_board.push_back(board_pose(points[i], known.empty()
                                                       ? directions_of(points[i], lens, seed.focal_px[camera])
                                                       : directions_of(points[i], known[camera])));
    lever_m += cam_from_board.back().t.norm() / static_cast<double>(in.boards.size());
  }
  seed.cam_from_ref = camera_poses({in, index, cam_from_board, lever_m});
  for (const std::vector<int>& set : index)
    seed.ref_from_board.push_back(place_board(in, set, seed, cam_from_board, lever_m));
  return seed;
}

}  // namespace stuv
