#include "calib/rectify/board_matches.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "calib/board/find_corners.h"
#include "core/json.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

/// The board whose corners were kept for this set.
std::optional<Board> kept_board(const Recording& recording, const FrameSet& set) {
  std::error_code ec;
  for (const auto& board : fs::directory_iterator(recording.folder / "corners", ec))
    for (const auto& file : fs::directory_iterator(board.path() / set.name, ec)) {
      try {
        return parse_board(read_json(file.path()).at("board"));
      } catch (const std::exception&) {
        // Not ours, or damaged: as if it were not there.
      }
    }
  return std::nullopt;
}

/// Corners in the rectified view; NaN where the board has none or none was seen.
std::vector<Eigen::Vector2d> rectified(const std::vector<Eigen::Vector2d>& corners, const Camera& camera,
                                       const CommonView& view) {
  std::vector<Eigen::Vector2d> seen;
  std::vector<std::size_t> which;
  for (std::size_t k = 0; k < corners.size(); ++k)
    if (corners[k].allFinite()) {
      seen.push_back(corners[k]);
      which.push_back(k);
    }
  std::vector<Eigen::Vector2d> result(corners.size(), Eigen::Vector2d::Constant(std::nan("")));
  const std::vector<Eigen::Vector3d> rays = unproject(camera, seen);
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const Eigen::Vector3d r = camera.cam_from_rig.R.transpose() * rays[i];
    result[which[i]] = {view.cx_px + view.focal_px * r.x() / r.z(),
                        view.cy_px + view.focal_px * r.y() / r.z()};
  }
  return result;
}

/// The same lattice of corners may have been counted from its other end (Board::is_ambiguous): then steps
/// from corner to corner point the other way.
void turn_alike(const std::vector<Eigen::Vector2d>& a, std::vector<Eigen::Vector2d>& b) {
  double alike = 0;
  for (std::size_t k = 0; k + 1 < a.size(); ++k) {
    const double product = (a[k + 1] - a[k]).dot(b[k + 1] - b[k]);
    if (std::isfinite(product)) alike += product;
  }
  if (alike < 0) std::reverse(b.begin(), b.end());
}

}  // namespace

std::vector<ViewMatch> board_matches(const Recording& recording, const FrameSet& set, const Rig& rig,
                                     const CommonView& common, const LightField& lf) {
  const std::optional<Board> board = kept_board(recording, set);
  if (!board) return {};
  Recording only = recording;
  only.sets = {set};
  const FoundCorners found = find_corners(only, *board);
  std::vector<std::vector<Eigen::Vector2d>> corners(lf.views.size());
  for (std::size_t v = 0; v < lf.views.size(); ++v) {
    const int index = recording.camera_index(lf.views[v].name);
    if (const BoardView& seen = found.views[0][index]; !seen.empty())
      corners[v] = rectified(seen.corners_px, rig.cameras[rig.camera_index(lf.views[v].name)].camera, common);
  }
  std::vector<ViewMatch> matches;
  for (const auto& [a, b] : neighbours(lf)) {
    if (corners[a].empty() || corners[b].empty()) continue;
    std::vector<Eigen::Vector2d> in_b = corners[b];
    if (board->is_ambiguous()) turn_alike(corners[a], in_b);
    for (std::size_t k = 0; k < in_b.size(); ++k)
      if (corners[a][k].allFinite() && in_b[k].allFinite())
        matches.push_back({a, b, static_cast<int>(k), corners[a][k], in_b[k]});
  }
  return matches;
}

}  // namespace stuv
