#include "calib/two_view/refine_tracks.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <tuple>

#include "calib/solve/camera_sight.h"
#include "calib/two_view/align_window.h"
#include "core/parallel.h"

namespace stuv {
namespace {

constexpr int kCellsAcross = 8, kCellsDown = 6;  ///< of a picture, among which points are spread
constexpr int kApart = 6;                        ///< pixels between the windows' centres of one camera

/// Where a point of the solution is to be looked at from.
struct Anchor {
  std::size_t track = 0;
  int camera = 0, x = 0, y = 0;
  int seen_by = 0;
};

class Refiner {
 public:
  Refiner(const SetPictures& pictures, const SfmProblem& problem, const SfmSolution& solution,
          const RefineTracksOptions& options)
      : pictures_(pictures), problem_(problem), solution_(solution), options_(options) {
    lenses_.assign(pictures.lenses.begin(), pictures.lenses.end());
    for (std::size_t c = 0; c < problem.lens_root.size(); ++c)
      lenses_[c] = with_states(lenses_[c], problem.lens_root[c], solution.lens[c]);
  }

  std::vector<Track> run() const {
    const std::vector<Anchor> anchors = spread(candidates());
    std::vector<Track> tracks(anchors.size());
    parallel_for(static_cast<int>(anchors.size()), [&](int i) { tracks[i] = follow(anchors[i]); });
    std::erase_if(tracks, [](const Track& t) { return t.camera.size() < 3; });
    return tracks;
  }

 private:
  /// Ideal pixels are the lens's directions times its own focal length; the solution's may differ.
  double stretch() const { return solution_.focal_px / problem_.focal_px; }

  Eigen::Vector2d to_picture(int camera, const Eigen::Vector3d& x_cam) const {
    const Eigen::Vector3d bent(stretch() * x_cam.x(), stretch() * x_cam.y(), x_cam.z());
    return project(lenses_[camera], {bent})[0];
  }
  Eigen::Vector3d ray(int camera, const Eigen::Vector2d& px) const {
    const Eigen::Vector2d d = unproject(lenses_[camera], {px})[0].hnormalized();
    return {d.x() / stretch(), d.y() / stretch(), 1};
  }
  Eigen::Vector2d ideal(int camera, const Eigen::Vector2d& px) const {
    return problem_.focal_px * unproject(pictures_.lenses[camera], {px})[0].hnormalized();
  }

  /// Of every point the observation in the middle of those that fit.
  std::vector<Anchor> candidates() const {
    std::vector<Anchor> out;
    for (std::size_t t = 0; t < problem_.tracks.size(); ++t) {
      const Track& track = problem_.tracks[t];
      if (track.set != pictures_.set || !solution_.points[t].allFinite()) continue;
      std::vector<int> cameras;
      for (std::size_t k = 0; k < track.camera.size(); ++k)
        if (solution_.inlier[t][k] && solution_.placed[track.camera[k]]) cameras.push_back(track.camera[k]);
      if (cameras.size() < 2) continue;
      std::sort(cameras.begin(), cameras.end());
      const int camera = cameras[cameras.size() / 2];
      const Eigen::Vector3d x = solution_.cam_from_ref[camera] * solution_.points[t];
      if (!(x.z() > 0)) continue;
      const Eigen::Vector2d at = to_picture(camera, x);
      if (!(at.cwiseAbs().maxCoeff() < 1e5)) continue;
      out.push_back({t, camera, static_cast<int>(std::lround(at.x())), static_cast<int>(std::lround(at.y())),
                     static_cast<int>(cameras.size())});
    }
    return out;
  }

  /// most_points of them: round by round the one of every cell of every picture that most cameras saw.
  std::vector<Anchor> spread(std::vector<Anchor> all) const {
    std::stable_sort(all.begin(), all.end(),
                     [](const Anchor& a, const Anchor& b) { return a.seen_by > b.seen_by; });
    std::map<std::tuple<int, int, int>, std::vector<Anchor>> cells;
    for (const Anchor& a : all) {
      const Camera& lens = pictures_.lenses[a.camera];
      auto& cell = cells[{a.camera, a.x * kCellsAcross / lens.width, a.y * kCellsDown / lens.height}];
      const bool near = std::any_of(cell.begin(), cell.end(), [&](const Anchor& b) {
        return std::abs(a.x - b.x) < kApart && std::abs(a.y - b.y) < kApart;
      });
      if (!near) cell.push_back(a);
    }
    std::vector<Anchor> chosen;
    for (std::size_t round = 0, before = 1; before != chosen.size() || round == 0; ++round) {
      before = chosen.size();
      for (const auto& [key, cell] : cells)
        if (round < cell.size() && static_cast<int>(chosen.size()) < options_.most_points)
          chosen.push_back(cell[round]);
      if (static_cast<int>(chosen.size()) >= options_.most_points) break;
    }
    return chosen;
  }

  /// The window's place in another camera: its plane faces the anchor's camera.
  WindowPlace predicted(const Anchor& a, int camera) const {
    const Pose there = solution_.cam_from_ref[camera] * solution_.cam_from_ref[a.camera].inverse();
    const double depth = (solution_.cam_from_ref[a.camera] * solution_.points[a.track]).z();
    const auto at = [&](double dx, double dy) {
      return to_picture(camera, there * Eigen::Vector3d(depth * ray(a.camera, {a.x + dx, a.y + dy})));
    };
    constexpr double kStep = 4;
    WindowPlace place;
    place.centre_px = at(0, 0);
    place.A.col(0) = (at(kStep, 0) - at(-kStep, 0)) / (2 * kStep);
    place.A.col(1) = (at(0, kStep) - at(0, -kStep)) / (2 * kStep);
    return place;
  }

  Track follow(const Anchor& a) const {
    Track track;
    track.set = pictures_.set;
    const auto window =
        Window::at(pictures_.grey[a.camera], a.x, a.y, options_.noise_grey, options_.most_sigma_px);
    if (!window) return track;
    AlignOptions align;
    align.most_shift_px = options_.most_shift_px;
    align.least_ncc = options_.least_ncc;
    align.most_sigma_px = options_.most_sigma_px;
    for (int c = 0; c < problem_.cameras; ++c) {
      if (!solution_.placed[c] || pictures_.grey[c].empty()) continue;
      Eigen::Vector2d at(a.x, a.y);
      if (c != a.camera) {
        const WindowPlace start = predicted(a, c);
        if (!start.centre_px.allFinite() || !start.A.allFinite()) continue;
        const auto found = window->find(pictures_.grey[c], start, align);
        if (!found) continue;
        at = found->place.centre_px;
      }
      track.camera.push_back(c);
      track.at_px.push_back(ideal(c, at));
      if (!problem_.lens_root.empty())
        track.by_lens.push_back(
            lens_slope(pictures_.lenses[c], problem_.lens_root[c], problem_.focal_px, track.at_px.back()));
    }
    return track;
  }

  const SetPictures& pictures_;
  std::vector<Camera> lenses_;  ///< as the solution has them
  const SfmProblem& problem_;
  const SfmSolution& solution_;
  const RefineTracksOptions& options_;
};

}  // namespace

Camera with_states(Camera lens, const Eigen::MatrixXd& root, const SfmSolution::LensStates& states) {
  const Eigen::VectorXd change = root * states.head(root.cols());
  for (Eigen::Index i = 0; i < change.size(); ++i) lens.intrinsics[i] += change[i];
  return lens;
}

LensSlope lens_slope(const Camera& lens, const Eigen::MatrixXd& root, double focal_px,
                     const Eigen::Vector2d& ideal_px) {
  LensSlope slope = LensSlope::Zero();
  if (root.cols() == 0) return slope;
  Camera alone = lens;
  alone.cam_from_rig = {};
  const auto sight = camera_sight(alone, lens_model_of(alone), {(ideal_px / focal_px).homogeneous(), 0});
  if (!sight) return slope;
  const Eigen::Matrix2d by_direction = sight->by_direction.leftCols<2>();
  slope.leftCols(root.cols()) =
      -focal_px * by_direction.inverse() * sight->by_states.leftCols(root.rows()) * root;
  return slope;
}

std::vector<Track> refine_tracks(const SetPictures& pictures, const SfmProblem& problem,
                                 const SfmSolution& solution, const RefineTracksOptions& options) {
  return Refiner(pictures, problem, solution, options).run();
}

}  // namespace stuv
