#include "calib/solve/seed.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <opencv2/calib3d.hpp>
#include <stdexcept>

#include "core/error.h"

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

struct Points {
  std::vector<cv::Point3d> board;
  std::vector<cv::Point2d> pixel;  ///< from the picture's middle
};

Points points_of(const Observations& in, const BoardObservation& b,
                 const std::vector<Eigen::Vector3d>& model) {
  const Eigen::Vector2d middle = 0.5 * (in.size_px[b.camera].cast<double>() - Eigen::Vector2d::Ones());
  Points points;
  for (std::size_t i = 0; i < model.size(); ++i) {
    if (!is_there(b, i)) continue;
    points.board.emplace_back(model[i].x(), model[i].y(), 0.0);
    points.pixel.emplace_back(b.corners_px[i].x() - middle.x(), b.corners_px[i].y() - middle.y());
  }
  return points;
}

/// Normal equation of w = 1/f^2 from one homography: sum a^2 w = -sum a b.
struct FocalEquation {
  double aa = 0, ab = 0;
};

FocalEquation focal_equation(const Points& points) {
  std::vector<cv::Point2d> plane;
  for (const cv::Point3d& p : points.board) plane.emplace_back(p.x, p.y);
  cv::Mat H = cv::findHomography(plane, points.pixel, 0);
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

std::vector<double> focal_lengths(const Observations& in, const std::vector<Points>& points) {
  std::map<std::pair<int, int>, FocalEquation> by_size;
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    const Eigen::Vector2i size = in.size_px[in.boards[i].camera];
    const FocalEquation e = focal_equation(points[i]);
    by_size[{size.x(), size.y()}].aa += e.aa;
    by_size[{size.x(), size.y()}].ab += e.ab;
  }
  std::vector<double> focal_px;
  for (const Eigen::Vector2i& size : in.size_px) {
    const FocalEquation e = by_size[{size.x(), size.y()}];
    const double f = 1 / std::sqrt(-e.ab / e.aa);
    const double width = std::max(size.x(), size.y());
    // Boards that are all parallel to the sensor say nothing: then a lens of 53 degrees.
    const bool sane = std::isfinite(f) && f > 0.2 * width && f < 20 * width;
    focal_px.push_back(sane ? f : width);
  }
  return focal_px;
}

Pose board_pose(const Points& points, double focal_px) {
  const cv::Matx33d K(focal_px, 0, 0, 0, focal_px, 0, 0, 0, 1);
  cv::Vec3d r, t;
  cv::solvePnP(points.board, points.pixel, K, cv::noArray(), r, t, false, cv::SOLVEPNP_IPPE);
  cv::solvePnP(points.board, points.pixel, K, cv::noArray(), r, t, true, cv::SOLVEPNP_ITERATIVE);
  return {rotation_from_vector({r[0], r[1], r[2]}), {t[0], t[1], t[2]}};
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

std::string names_of(const Observations& in, const std::vector<bool>& which, bool value) {
  std::vector<std::string> names;
  for (std::size_t c = 0; c < which.size(); ++c)
    if (which[c] == value) names.push_back(in.camera_names[c]);
  return fmt::format("{}", fmt::join(names, ", "));
}

void require_boards(const Observations& in) {
  std::vector<bool> sees(in.camera_names.size(), false);
  for (const BoardObservation& b : in.boards) sees[b.camera] = true;
  if (std::find(sees.begin(), sees.end(), false) != sees.end())
    throw Error("camera " + names_of(in, sees, false), "never sees the board " + board_spec(in.board),
                "show it the board, or record without this camera");
}

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
    if (to < 0)
      throw Error("cameras " + names_of(chain.in, placed, true),
                  "have no board in common with " + names_of(chain.in, placed, false),
                  "record a set in which both see the board");
    cam_from_ref[to] = chain.relative(from, to) * cam_from_ref[from];
    placed[to] = true;
  }
  return cam_from_ref;
}

/// The board's pose in the reference frame, and with an ambiguous board every camera's corners in that order.
Pose place_board(Observations& in, const std::vector<int>& set, const std::vector<Pose>& cam_from_ref,
                 std::vector<Pose>& cam_from_board, double lever_m) {
  const Pose turn = half_turn(in.board);
  std::vector<Pose> candidates;
  for (std::size_t c = 0; c < set.size(); ++c) {
    if (set[c] < 0) continue;
    Pose pose = cam_from_ref[c].inverse() * cam_from_board[set[c]];
    const Pose turned = pose * turn;
    if (in.board.is_ambiguous() && !candidates.empty() &&
        distance(turned, candidates.front(), lever_m) < distance(pose, candidates.front(), lever_m)) {
      BoardObservation& b = in.boards[set[c]];
      std::reverse(b.corners_px.begin(), b.corners_px.end());
      std::reverse(b.weights.begin(), b.weights.end());
      pose = turned;
    }
    candidates.push_back(pose);
  }
  return candidates.empty() ? Pose{} : medoid(candidates, lever_m);
}

}  // namespace

Seed seed_solve(Observations& in) {
  const Matrix index = index_of(in);
  require_boards(in);
  const std::vector<Eigen::Vector3d> model = board_points(in.board);
  std::vector<Points> points;
  for (const BoardObservation& b : in.boards) {
    points.push_back(points_of(in, b, model));
    if (points.back().board.size() < 6)
      throw Error("camera " + in.camera_names[b.camera],
                  "has fewer than 6 finite corners in set " + in.set_names[b.set], "leave this view out");
  }
  Seed seed;
  seed.focal_px = focal_lengths(in, points);
  std::vector<Pose> cam_from_board;
  double lever_m = 0;
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    cam_from_board.push_back(board_pose(points[i], seed.focal_px[in.boards[i].camera]));
    lever_m += cam_from_board.back().t.norm() / static_cast<double>(in.boards.size());
  }
  seed.cam_from_ref = camera_poses({in, index, cam_from_board, lever_m});
  for (const std::vector<int>& set : index)
    seed.ref_from_board.push_back(place_board(in, set, seed.cam_from_ref, cam_from_board, lever_m));
  return seed;
}

}  // namespace stuv
