#include "calib/solve/groups.h"

#include <algorithm>
#include <numeric>

namespace stuv {
namespace {

/// Union-find over the cameras, path halving.
class Forest {
 public:
  explicit Forest(int n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), 0); }
  int root(int i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(int a, int b) { parent_[std::max(root(a), root(b))] = std::min(root(a), root(b)); }

 private:
  std::vector<int> parent_;
};

}  // namespace

CameraGroups camera_groups(const std::vector<BoardObservation>& boards, int cameras) {
  Forest forest(cameras);
  std::vector<std::size_t> corners(cameras, 0);
  int sets = 0;
  for (const BoardObservation& b : boards) sets = std::max(sets, b.set + 1);
  std::vector<int> seen_by(sets, -1);
  for (const BoardObservation& b : boards) {
    corners[b.camera] += b.corners_px.size();
    if (seen_by[b.set] >= 0) forest.join(seen_by[b.set], b.camera);
    seen_by[b.set] = b.camera;
  }
  CameraGroups result;
  std::vector<int> group_of(cameras, -1);
  std::vector<std::size_t> group_corners;
  for (int c = 0; c < cameras; ++c) {
    if (corners[c] == 0) {
      result.blind.push_back(c);
      continue;
    }
    int& group = group_of[forest.root(c)];
    if (group < 0) {
      group = static_cast<int>(result.groups.size());
      result.groups.emplace_back();
      group_corners.push_back(0);
    }
    result.groups[group].push_back(c);
    group_corners[group] += corners[c];
  }
  std::size_t best = 0;
  for (std::size_t g = 1; g < result.groups.size(); ++g)
    if (std::pair(result.groups[g].size(), group_corners[g]) >
        std::pair(result.groups[best].size(), group_corners[best]))
      best = g;
  if (!result.groups.empty()) std::swap(result.groups[0], result.groups[best]);
  return result;
}

ObservedPart part_of(const Observations& all, const std::vector<int>& cameras) {
  ObservedPart part;
  part.observations.board = all.board;
  part.observations.set_names = all.set_names;
  part.camera_of = cameras;
  std::vector<int> new_index(all.camera_names.size(), -1);
  for (const int c : cameras) {
    new_index[c] = static_cast<int>(part.observations.camera_names.size());
    part.observations.camera_names.push_back(all.camera_names[c]);
    part.observations.size_px.push_back(all.size_px[c]);
  }
  for (std::size_t i = 0; i < all.boards.size(); ++i) {
    if (new_index[all.boards[i].camera] < 0) continue;
    part.observations.boards.push_back(all.boards[i]);
    part.observations.boards.back().camera = new_index[all.boards[i].camera];
    part.board_of.push_back(static_cast<int>(i));
  }
  return part;
}

}  // namespace stuv
