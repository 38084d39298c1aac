#include "calib/tracking/moving_rig.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>
#include <numeric>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <set>

#include "calib/lattice_places.h"
#include "calib/tracking/moving_adjust.h"
#include "calib/tracking/sequence.h"
#include "core/error.h"
#include "core/image_io.h"
#include "core/parallel.h"

namespace stuv::tracking {
namespace {

/// Centres on their plane, x along the cameras' right, turned so that a grid lies along the axes.
std::vector<Eigen::Vector2d> on_plane(const std::vector<Pose>& poses) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero(), right = mean, forward = mean;
  for (const Pose& p : poses) {
    mean += p.centre() / static_cast<double>(poses.size());
    right += p.R.row(0).transpose();
    forward += p.R.row(2).transpose();
  }
  forward.normalize();
  const Eigen::Vector3d x = (right - right.dot(forward) * forward).normalized(), y = forward.cross(x);
  std::vector<Eigen::Vector2d> points;
  for (const Pose& p : poses) points.emplace_back(x.dot(p.centre() - mean), y.dot(p.centre() - mean));
  return points;
}

/// The frames nearest to the points of a lattice of rows x cols that spans the box; `score` is how many
/// points are filled, 0 if too few are.
struct Candidate {
  LatticeChoice choice;
  int score = 0;
};

Candidate fill_lattice(const std::vector<Eigen::Vector2d>& points, const Eigen::AlignedBox2d& box, int rows,
                       int cols, const MovingOptions& options) {
  const Eigen::Vector2d step(cols > 1 ? box.sizes().x() / (cols - 1) : 0,
                             rows > 1 ? box.sizes().y() / (rows - 1) : 0);
  const double spacing = cols > 1 && rows > 1 ? step.minCoeff() : step.maxCoeff();
  std::map<std::pair<int, int>, std::pair<double, int>> nearest;
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector2d at = points[i] - box.min();
    const int col = cols > 1 ? static_cast<int>(std::lround(at.x() / step.x())) : 0;
    const int row = rows > 1 ? static_cast<int>(std::lround(at.y() / step.y())) : 0;
    Eigen::Vector2d off = at - Eigen::Vector2d(col * step.x(), row * step.y());
    if (rows == 1) off.y() = 0;
    if (cols == 1) off.x() = 0;
    if (off.norm() > options.most_off_lattice * spacing) continue;
    const std::pair<double, int> here(off.norm(), static_cast<int>(i));
    const auto [found, is_new] = nearest.try_emplace({row, col}, here);
    if (!is_new) found->second = std::min(found->second, here);
  }
  Candidate c;
  if (static_cast<double>(nearest.size()) < options.least_filled * rows * cols) return c;
  c.score = static_cast<int>(nearest.size());
  c.choice.rows = rows;
  c.choice.cols = cols;
  for (const auto& [place, frame] : nearest) {
    c.choice.row.push_back(place.first);
    c.choice.col.push_back(place.second);
    c.choice.frames.push_back(frame.second);
  }
  return c;
}

/// All frames, if they stand on a lattice as they are.
LatticeChoice whole_lattice(const std::vector<Eigen::Vector2d>& points) {
  const LatticePlaces places = places_on_lattice(points);
  LatticeChoice choice;
  std::set<std::pair<int, int>> taken;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!taken.emplace(places.row[i], places.col[i]).second) return {};
    choice.frames.push_back(static_cast<int>(i));
  }
  // Scattered points have rows and columns, too: nearly one for each point.
  if (static_cast<double>(points.size()) < 0.7 * places.rows * places.cols) return {};
  choice.row = places.row, choice.col = places.col;
  choice.rows = places.rows, choice.cols = places.cols;
  return choice;
}

struct Feature {
  Eigen::Vector2d ray;  ///< x/z, y/z
  int track = -1;
};

struct Picture {
  std::vector<Feature> features;
  cv::Mat descriptors;
};

Picture look(const MovingFrame& frame, const Camera& camera, int keypoints) {
  const Image image = FrameReader().read({frame.name, frame.file, 0, -1}, camera);
  const Grey grey = grey_of(image);
  const cv::Mat pixels(grey.height, grey.width, CV_8U, const_cast<std::uint8_t*>(grey.data.data()));
  std::vector<cv::KeyPoint> found;
  Picture picture;
  cv::SIFT::create(keypoints)->detectAndCompute(pixels, cv::noArray(), found, picture.descriptors);
  std::vector<Eigen::Vector2d> places;
  for (const cv::KeyPoint& k : found) places.emplace_back(k.pt.x, k.pt.y);
  for (const Eigen::Vector3d& ray : unproject(camera, places))
    picture.features.push_back({ray.hnormalized(), -1});
  return picture;
}

/// Mutual best matches that pass the ratio test and one epipolar geometry (RANSAC, `most` off its lines [of
/// the image plane at 1]): tracked poses may be centimetres off.
std::vector<std::pair<int, int>> match(const Picture& a, const Picture& b, double most) {
  std::vector<std::pair<int, int>> matches;
  if (a.features.size() < 2 || b.features.size() < 2) return matches;
  std::vector<std::vector<cv::DMatch>> found, back;
  const cv::BFMatcher matcher(cv::NORM_L2);
  matcher.knnMatch(a.descriptors, b.descriptors, found, 2);
  matcher.knnMatch(b.descriptors, a.descriptors, back, 1);
  std::vector<cv::Point2d> pa, pb;
  for (const auto& m : found) {
    if (!(m[0].distance < 0.8F * m[1].distance) || back[m[0].trainIdx][0].trainIdx != m[0].queryIdx) continue;
    matches.emplace_back(m[0].queryIdx, m[0].trainIdx);
    const Eigen::Vector2d &ra = a.features[m[0].queryIdx].ray, &rb = b.features[m[0].trainIdx].ray;
    pa.emplace_back(ra.x() / most, ra.y() / most);  // in units of the threshold
    pb.emplace_back(rb.x() / most, rb.y() / most);
  }
  if (matches.size() < 12) return {};
  cv::Mat inlier;
  cv::findFundamentalMat(pa, pb, cv::FM_RANSAC, 1, 0.999, 2000, inlier);
  std::vector<std::pair<int, int>> kept;
  for (std::size_t i = 0; i < matches.size() && !inlier.empty(); ++i)
    if (inlier.at<std::uint8_t>(static_cast<int>(i)) != 0) kept.push_back(matches[i]);
  return kept;
}

/// Sets of things that are the same.
class Unions {
 public:
  explicit Unions(int n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), 0); }
  int root(int i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(int a, int b) { parent_[root(a)] = root(b); }

 private:
  std::vector<int> parent_;
};

/// Features of three frames or more that are the same point, no two in one frame.
std::vector<TrackedPoint> link(const std::vector<Picture>& pictures,
                               const std::vector<std::array<int, 4>>& matches) {
  std::vector<int> first(pictures.size() + 1, 0);
  for (std::size_t i = 0; i < pictures.size(); ++i)
    first[i + 1] = first[i] + static_cast<int>(pictures[i].features.size());
  Unions unions(first.back());
  for (const auto& [a, i, b, j] : matches) unions.join(first[a] + i, first[b] + j);
  std::map<int, TrackedPoint> by_root;
  for (std::size_t f = 0; f < pictures.size(); ++f)
    for (std::size_t i = 0; i < pictures[f].features.size(); ++i)
      by_root[unions.root(first[f] + static_cast<int>(i))].push_back(
          {static_cast<int>(f), pictures[f].features[i].ray});
  std::vector<TrackedPoint> points;
  for (auto& [root, sights] : by_root) {
    std::set<int> frames;
    for (const Sight& s : sights) frames.insert(s.frame);
    if (sights.size() >= 3 && frames.size() == sights.size()) points.push_back(std::move(sights));
  }
  return points;
}

/// Pairs of frames whose centres are near each other, `near` to each.
std::set<std::pair<int, int>> neighbours(const std::vector<Pose>& poses, std::size_t near) {
  std::set<std::pair<int, int>> pairs;
  const int count = static_cast<int>(poses.size());
  for (int a = 0; a < count; ++a) {
    std::vector<std::pair<double, int>> others;
    for (int b = 0; b < count; ++b)
      if (b != a) others.emplace_back((poses[a].centre() - poses[b].centre()).norm(), b);
    std::sort(others.begin(), others.end());
    for (std::size_t k = 0; k < std::min(near, others.size()); ++k)
      pairs.insert(std::minmax(a, others[k].second));
    if (a + 1 < count) pairs.insert({a, a + 1});
  }
  return pairs;
}

std::vector<std::array<int, 4>> match_neighbours(const std::vector<Picture>& pictures,
                                                 const std::vector<Pose>& poses, double most,
                                                 const Reporter& reporter) {
  const std::set<std::pair<int, int>> near = neighbours(poses, 8);
  const std::vector<std::pair<int, int>> pairs(near.begin(), near.end());
  std::vector<std::vector<std::pair<int, int>>> found(pairs.size());
  std::mutex mutex;
  std::size_t done = 0;
  parallel_for(static_cast<int>(pairs.size()), [&](int i) {
    const auto [a, b] = pairs[i];
    found[i] = match(pictures[a], pictures[b], most);
    const std::lock_guard lock(mutex);
    reporter.at("matching frames", ++done, pairs.size());
  });
  std::vector<std::array<int, 4>> matches;
  for (std::size_t i = 0; i < pairs.size(); ++i)
    for (const auto& [k, l] : found[i]) matches.push_back({pairs[i].first, k, pairs[i].second, l});
  return matches;
}

/// Largest distance of a centre from their mean.
double extent_of(const std::vector<Pose>& poses) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Pose& p : poses) mean += p.centre() / static_cast<double>(poses.size());
  double extent = 0;
  for (const Pose& p : poses) extent = std::max(extent, (p.centre() - mean).norm());
  return extent;
}

/// Depths of the points below the plane of the rig, without the nearest and farthest hundredth.
void note_depths(std::vector<Eigen::Vector3d> points, Calibration& c) {
  std::vector<double> z;
  for (const Eigen::Vector3d& x : points)
    if (const double depth = (c.layout.rig_from_ref * x).z(); depth > 0) z.push_back(depth);
  if (z.empty()) return;
  std::sort(z.begin(), z.end());
  c.rig.nearest_seen_m = z[z.size() / 100];
  c.rig.farthest_seen_m = z[z.size() - 1 - z.size() / 100];
}

/// Covariance of the chosen frames' centres after rigid alignment, in the rig's frame: of the adjustment
/// after alignment by a similarity, and of the scale, which makes all centres go apart together.
void note_uncertainty(const LatticeChoice& lattice, const Adjusted& a, Rig& rig, const Layout& layout) {
  if (a.centre_covariance.size() == 0 || !std::isfinite(a.scale_sigma)) return;
  const auto n = static_cast<Eigen::Index>(lattice.frames.size());
  std::vector<Eigen::Vector3d> centres;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const int frame : lattice.frames) {
    centres.push_back(a.poses[frame].centre());
    mean += centres.back() / static_cast<double>(n);
  }
  Eigen::MatrixXd covariance(3 * n, 3 * n), turn = Eigen::MatrixXd::Zero(3 * n, 3 * n);
  Eigen::VectorXd growth(3 * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    turn.block<3, 3>(3 * i, 3 * i) = layout.rig_from_ref.R;
    growth.segment<3>(3 * i) = centres[i] - mean;
    for (Eigen::Index j = 0; j < n; ++j)
      covariance.block<3, 3>(3 * i, 3 * j) =
          a.centre_covariance.block<3, 3>(3 * lattice.frames[i], 3 * lattice.frames[j]);
  }
  const Eigen::VectorXd g = growth.normalized();
  const Eigen::MatrixXd P = Eigen::MatrixXd::Identity(3 * n, 3 * n) - g * g.transpose();
  covariance = P * rigidly_aligned(covariance, centres) * P;
  covariance += a.scale_sigma * a.scale_sigma * growth * growth.transpose();
  rig.centre_covariance_m2 = turn * covariance * turn.transpose();
  for (Eigen::Index i = 0; i < n; ++i)
    rig.cameras[i].position_sigma_m =
        rig.centre_covariance_m2.diagonal().segment<3>(3 * i).cwiseMax(0).cwiseSqrt();
}

void fill(const std::vector<MovingFrame>& frames, const Camera& camera, const LatticeChoice& lattice,
          const Adjusted& a, Calibration& c) {
  std::vector<PlacedCamera> placed;
  for (std::size_t i = 0; i < lattice.frames.size(); ++i)
    placed.push_back({a.poses[lattice.frames[i]], lattice.row[i], lattice.col[i], true});
  c.layout = fit_layout(placed, lattice.rows, lattice.cols);
  Rig& rig = c.rig;
  set_lattice(c.layout, rig);
  const Pose ref_from_rig = c.layout.rig_from_ref.inverse();
  double sum_sq = 0, count = 0;
  for (std::size_t i = 0; i < lattice.frames.size(); ++i) {
    const int frame = lattice.frames[i];
    RigCamera rc;
    rc.camera = camera;
    rc.camera.name = frames[frame].name;
    rc.camera.cam_from_rig = a.poses[frame] * ref_from_rig;
    rc.row = c.layout.row[i], rc.col = c.layout.col[i];
    rc.off_lattice_m = c.layout.off_lattice_m[i];
    rig.cameras.push_back(rc);
    CameraSummary summary;
    summary.inliers = a.count[frame] / 2;
    summary.outliers = a.outliers[frame];
    summary.rms_px = std::sqrt(a.sum_sq[frame] / a.count[frame]);
    c.cameras.push_back(summary);
    c.observations.camera_names.push_back(rc.camera.name);
    c.observations.size_px.emplace_back(camera.width, camera.height);
    sum_sq += a.sum_sq[frame], count += a.count[frame];
    c.solution.inliers += a.count[frame] / 2, c.solution.outliers += a.outliers[frame];
  }
  c.solution.converged = a.converged;
  c.solution.rms_px = c.solution.rms_unweighted_px = std::sqrt(sum_sq / count);
  c.solution.worst_px = a.worst_px;
  note_uncertainty(lattice, a, rig, c.layout);
}

/// The frames that the points hold: others cannot be placed.
std::vector<int> determined_frames(const Adjusted& a) {
  constexpr int least_points = 12;
  std::vector<int> frames;
  for (std::size_t i = 0; i < a.poses.size(); ++i)
    if (a.count[i] >= 2 * least_points) frames.push_back(static_cast<int>(i));
  return frames;
}

/// choose_lattice among some of the frames.
LatticeChoice choose_among(const std::vector<int>& frames, const std::vector<Pose>& all,
                           const MovingOptions& options) {
  std::vector<Pose> poses;
  for (const int i : frames) poses.push_back(all[i]);
  LatticeChoice choice = choose_lattice(poses, options);
  for (int& i : choice.frames) i = frames[i];
  return choice;
}

void judge(const Adjusted& a, const MovingOptions& options, bool scaled, int slipped, int count,
           Calibration& c) {
  if (!a.converged) c.reasons.push_back("the adjustment did not converge");
  if (!(c.solution.rms_px <= options.most_rms_px))
    c.reasons.push_back(fmt::format("residuals are large: rms {:.2f} px, more than {:.2f}", c.solution.rms_px,
                                    options.most_rms_px));
  if (!scaled) c.reasons.push_back("scale cannot be determined: the tracked poses do not tell");
  if (slipped > options.most_slipped * count)
    c.reasons.push_back(
        fmt::format("{} of {} tracked poses do not fit the pictures: scale and place are those of "
                    "the others, if they are right; look at the overlays of `stuv track`",
                    slipped, count));
  else if (slipped > 0)
    c.notes.push_back(
        fmt::format("{} of {} tracked poses do not fit the pictures and were moved", slipped, count));
  if (c.rig.centre_covariance_m2.size() == 0)
    c.reasons.push_back(
        "how certain the places are cannot be determined: too few frames, or points that they share");
  else if (std::isfinite(a.scale_sigma))
    c.notes.push_back(
        fmt::format("scale is that of the tracked poses, certain to {:.2g} %", 100 * a.scale_sigma));
  if (c.rig.centre_covariance_m2.size() != 0)
    c.notes.emplace_back(
        "the sigmas of the places take the errors of keypoints as independent of each other");
  c.good = c.reasons.empty();
}

}  // namespace

LatticeChoice choose_lattice(const std::vector<Pose>& poses, const MovingOptions& options) {
  if (poses.size() < 2) return {};
  std::vector<Eigen::Vector2d> points = on_plane(poses);
  const Eigen::Rotation2Dd turn(-lattice_angle(points));
  for (Eigen::Vector2d& p : points) p = turn * p;
  const LatticeChoice whole = whole_lattice(points);
  if (!whole.frames.empty()) return whole;
  Eigen::AlignedBox2d box;
  for (const Eigen::Vector2d& p : points) box.extend(p);
  const int most = static_cast<int>(std::min<std::size_t>(points.size(), 100));
  Candidate best;
  for (int rows = 1; rows <= most; ++rows)
    for (int cols = 1; cols <= most && rows * cols <= int(double(points.size()) / options.least_filled);
         ++cols) {
      if (rows * cols < 2) continue;
      const Candidate c = fill_lattice(points, box, rows, cols, options);
      if (c.score > best.score) best = c;
    }
  return best.choice;
}

Calibration calibrate_moving(const std::vector<MovingFrame>& frames, const Camera& camera,
                             const MovingOptions& options, const Reporter& reporter) {
  if (frames.size() < 2)
    throw Error(camera.name, fmt::format("{} frame(s) with a pose make no lattice", frames.size()),
                "track more frames");
  Calibration c;
  std::vector<Pose> tracked;
  for (const MovingFrame& f : frames) tracked.push_back(f.cam_from_scene);
  const int count = static_cast<int>(frames.size());
  std::vector<Picture> pictures(frames.size());
  parallel_for(count, [&](int i) { pictures[i] = look(frames[i], camera, options.keypoints); });
  const double focal_px = std::sqrt(camera.intrinsics[0] * camera.intrinsics[1]);
  const std::vector<TrackedPoint> points =
      link(pictures, match_neighbours(pictures, tracked, 1.5 / focal_px, reporter));
  reporter.at("adjusting", 0, 1);
  const double sigma_m = options.prior_part * extent_of(tracked);
  Adjusted adjusted = adjust_moving(tracked, points, focal_px, sigma_m);
  const bool scaled = restore_scale(tracked, adjusted);
  reporter.at("adjusting", 1, 1);
  const std::vector<int> determined = determined_frames(adjusted);
  int slipped = 0;
  for (const int i : determined)
    slipped += (adjusted.poses[i].centre() - tracked[i].centre()).norm() < 3 * sigma_m ? 0 : 1;
  const LatticeChoice lattice = choose_among(determined, adjusted.poses, options);
  if (lattice.frames.size() < 2)
    throw Error(
        camera.name,
        fmt::format("no lattice can be chosen among the {} of {} frames that share points with others",
                    determined.size(), frames.size()),
        "move the camera along a row or over a plane, more evenly, past a scene with texture");
  fill(frames, camera, lattice, adjusted, c);
  note_depths(adjusted.points, c);
  if (determined.size() < frames.size())
    c.notes.push_back(fmt::format("{} of {} frames share too few points with others and were left out",
                                  frames.size() - determined.size(), frames.size()));
  if (lattice.frames.size() < determined.size())
    c.notes.push_back(
        fmt::format("{} of {} frames were chosen for the lattice", lattice.frames.size(), frames.size()));
  judge(adjusted, options, scaled, slipped, count, c);
  return c;
}

}  // namespace stuv::tracking
