#include "calib/solve/calibrate.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <opencv2/imgproc.hpp>

namespace stuv {
namespace {

/// Corner noise to judge determinacy by, however exact the corners happen to be [px].
constexpr double kLeastNoisePx = 0.02;

std::vector<Eigen::Vector3d> centres_of(const std::vector<Camera>& cameras, const std::vector<int>& which) {
  std::vector<Eigen::Vector3d> centres;
  for (const int c : which) centres.push_back(cameras[c].cam_from_rig.centre());
  return centres;
}

Eigen::MatrixXd block_of(const Eigen::MatrixXd& covariance, const std::vector<int>& which) {
  const auto n = static_cast<Eigen::Index>(which.size());
  Eigen::MatrixXd result(3 * n, 3 * n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j)
      result.block<3, 3>(3 * i, 3 * j) = covariance.block<3, 3>(3 * which[i], 3 * which[j]);
  return result;
}

double median_spacing(const std::vector<Eigen::Vector3d>& centres) {
  std::vector<double> nearest;
  for (const auto& a : centres) {
    double best = std::numeric_limits<double>::infinity();
    for (const auto& b : centres)
      if (&a != &b) best = std::min(best, (a - b).norm());
    nearest.push_back(best);
  }
  std::nth_element(nearest.begin(), nearest.begin() + static_cast<long>(nearest.size() / 2), nearest.end());
  return nearest[nearest.size() / 2];
}

/// Cameras whose lens and place the boards determine. Takes the least determined one out until the rest are:
/// one loose camera makes the alignment, and so all others, look loose.
std::vector<int> determined_cameras(const JointSolution& s, const CalibrationOptions& options) {
  std::vector<int> which;
  const double noise = std::max(kLeastNoisePx, std::isfinite(s.noise_px) ? s.noise_px : 1e9);
  if (!s.converged || s.centre_covariance.size() == 0) return which;
  for (std::size_t c = 0; c < s.cameras.size(); ++c) {
    const double sigma = s.focal_sigma[c].maxCoeff() * noise;
    if (sigma < options.most_focal_sigma * std::abs(s.cameras[c].intrinsics[0])) which.push_back(int(c));
  }
  while (which.size() > 1) {
    const auto centres = centres_of(s.cameras, which);
    const Eigen::VectorXd variance =
        rigidly_aligned(block_of(s.centre_covariance, which), centres).diagonal();
    Eigen::Index worst = 0;
    const double sigma = noise * std::sqrt(variance.maxCoeff(&worst));
    if (sigma < options.most_sigma * median_spacing(centres)) break;
    which.erase(which.begin() + worst / 3);
  }
  return which;
}

CameraSummary summary_of(const Calibration& c, int camera) {
  CameraSummary summary;
  std::vector<cv::Point2f> points;
  double sum_sq = 0;
  for (std::size_t i = 0; i < c.observations.boards.size(); ++i) {
    if (c.observations.boards[i].camera != camera) continue;
    ++summary.boards;
    for (std::size_t k = 0; k < c.solution.residuals_px[i].size(); ++k) {
      if (c.solution.outlier[i][k]) ++summary.outliers;
      const Eigen::Vector2d& r = c.solution.residuals_px[i][k];
      if (!r.allFinite()) continue;
      ++summary.inliers;
      sum_sq += r.squaredNorm();
      const Eigen::Vector2f q = c.observations.boards[i].corners_px[k].cast<float>();
      points.emplace_back(q.x(), q.y());
    }
  }
  summary.rms_px = std::sqrt(sum_sq / (2.0 * summary.inliers));
  if (points.size() > 2) {
    std::vector<cv::Point2f> hull;
    cv::convexHull(points, hull);
    const Eigen::Vector2i size = c.observations.size_px[camera];
    summary.coverage = cv::contourArea(hull) / (double(size.x()) * size.y());
  }
  if (!c.solution.focal_sigma.empty())
    summary.focal_sigma_px = c.solution.noise_px * c.solution.focal_sigma[camera];
  return summary;
}

/// Distances of the nearest and farthest inlier board corner from the plane.
void note_depths(Calibration& c) {
  const std::vector<Eigen::Vector3d> model = board_points(c.observations.board);
  double nearest = std::numeric_limits<double>::infinity(), farthest = 0;
  for (const BoardObservation& b : c.observations.boards) {
    const Pose rig_from_board = c.layout.rig_from_ref * c.solution.ref_from_board[b.set];
    for (const Eigen::Vector3d& p : model) {
      const double z = (rig_from_board * p).z();
      nearest = std::min(nearest, z);
      farthest = std::max(farthest, z);
    }
  }
  c.rig.nearest_seen_m = std::max(0.0, nearest);
  c.rig.farthest_seen_m = farthest;
}

void fill_rig(Calibration& c, const std::vector<int>& determined) {
  Rig& rig = c.rig;
  const Pose ref_from_rig = c.layout.rig_from_ref.inverse();
  set_lattice(c.layout, rig);
  for (std::size_t i = 0; i < c.solution.cameras.size(); ++i) {
    RigCamera camera;
    camera.camera = c.solution.cameras[i];
    camera.camera.cam_from_rig = c.solution.cameras[i].cam_from_rig * ref_from_rig;
    camera.row = c.layout.row[i];
    camera.col = c.layout.col[i];
    camera.determined = false;
    camera.off_lattice_m = c.layout.off_lattice_m[i];
    rig.cameras.push_back(std::move(camera));
  }
  for (const int i : determined) rig.cameras[i].determined = true;
  note_depths(c);
  if (determined.size() < 2) return;
  const Eigen::MatrixXd aligned = rigidly_aligned(block_of(c.solution.centre_covariance, determined),
                                                  centres_of(c.solution.cameras, determined));
  const auto n = static_cast<Eigen::Index>(determined.size());
  Eigen::MatrixXd turn = Eigen::MatrixXd::Zero(3 * n, 3 * n);
  for (Eigen::Index i = 0; i < n; ++i) turn.block<3, 3>(3 * i, 3 * i) = c.layout.rig_from_ref.R;
  rig.centre_covariance_m2 = std::pow(c.solution.noise_px, 2) * turn * aligned * turn.transpose();
  for (Eigen::Index i = 0; i < n; ++i)
    rig.cameras[determined[i]].position_sigma_m =
        rig.centre_covariance_m2.diagonal().segment<3>(3 * i).cwiseMax(0).cwiseSqrt();
}

std::optional<double> cross_validate(const Calibration& c, const CalibrationOptions& options,
                                     const Reporter& reporter) {
  std::vector<int> sets;
  for (const BoardObservation& b : c.observations.boards) sets.push_back(b.set);
  std::sort(sets.begin(), sets.end());
  sets.erase(std::unique(sets.begin(), sets.end()), sets.end());
  if (sets.size() < 2 || !c.solution.converged) return std::nullopt;
  const int folds = std::min(options.most_folds, static_cast<int>(sets.size()));
  HeldOutError total;
  for (int f = 0; f < folds; ++f) {
    const int set = sets[static_cast<std::size_t>(f) * sets.size() / folds];
    const HeldOutError error = held_out_error(c.observations, c.solution, set, options.solve);
    total.sum_sq_px2 += error.sum_sq_px2;
    total.count += error.count;
    reporter.at("cross-validating", f + 1, folds);
  }
  if (total.count == 0 || !std::isfinite(total.sum_sq_px2)) return std::nullopt;
  return std::sqrt(total.sum_sq_px2 / total.count);
}

/// Half as near as boards were seen, to infinity.
std::vector<double> working_depths(const Rig& rig) {
  constexpr int kDepths = 12;
  std::vector<double> depths;
  for (int i = 0; i < kDepths; ++i)
    depths.push_back(0.5 * rig.nearest_seen_m * (kDepths - 1) / (kDepths - 1.0 - i));
  return depths;
}

void judge(Calibration& c, const CalibrationOptions& options) {
  const JointSolution& s = c.solution;
  const auto bad = [&](std::string reason) { c.reasons.push_back(std::move(reason)); };
  if (!s.converged) bad("the solve did not converge");
  if (!(s.rms_px <= options.most_rms_px))
    bad(fmt::format("residuals are large: rms {:.2f} px, more than {:.2f}", s.rms_px, options.most_rms_px));
  const double share = s.outliers / std::max(1.0, double(s.inliers + s.outliers));
  if (share > 0.1) bad(fmt::format("{:.0f} % of the corners are outliers", 100 * share));
  const double spacing = std::max(c.layout.s_step_m.norm(), c.layout.t_step_m.norm());
  for (std::size_t i = 0; i < c.cameras.size(); ++i) {
    const std::string& name = c.observations.camera_names[i];
    if (!c.rig.cameras[i].determined)
      bad(fmt::format("camera {} is not determined by its {} board(s)", name, c.cameras[i].boards));
    else if (c.cameras[i].boards < 2)
      bad(fmt::format("camera {} saw one board only", name));
    if (c.cameras[i].coverage < options.least_coverage)
      bad(fmt::format("boards cover only {:.0f} % of camera {}'s picture", 100 * c.cameras[i].coverage,
                      name));
    if (c.rig.cameras[i].determined && c.rig.cameras.size() > 2 &&
        c.rig.cameras[i].off_lattice_m.norm() > 0.5 * spacing)
      bad(fmt::format("camera {} stands {:.3f} m off its place in the recorded grid", name,
                      c.rig.cameras[i].off_lattice_m.norm()));
  }
  c.good = c.reasons.empty();
}

void note_ghosting(Calibration& c, const CalibrationOptions& options) {
  Ghosting worst;
  for (const Ghosting& g : c.ghosting)
    if (g.depth_m >= c.rig.nearest_seen_m && g.depth_m <= c.rig.farthest_seen_m &&
        g.worst_px > worst.worst_px)
      worst = g;
  if (worst.worst_px > options.most_ghosting_px)
    c.notes.push_back(
        fmt::format("pictures of one point at {:.2f} m fall up to {:.2f} px apart (one sigma), more than "
                    "{:.2f}, most that of camera {}: show it more boards, out to its picture's corners",
                    worst.depth_m, worst.worst_px, options.most_ghosting_px,
                    c.observations.camera_names[worst.worst_camera]));
}

void note(Calibration& c, const Recording& recording) {
  if (!c.layout.as_recorded)
    c.notes.push_back(
        fmt::format("the recorded grid, {}x{}, does not fit where the cameras stand; rows and columns are "
                    "counted along their centres: {}x{}",
                    recording.rows, recording.cols, c.layout.rows, c.layout.cols));
  // Corners of boards that were part of the solve are predicted at their noise; of others by what the solve
  // has learnt of lenses and places.
  if (c.cross_validation_px && *c.cross_validation_px > 5 * c.solution.rms_px)
    c.notes.push_back(
        fmt::format("a board that was left out is predicted to {:.2f} px only, the boards of the solve to "
                    "{:.2f}: record more boards, tilted and out to the pictures' corners",
                    *c.cross_validation_px, c.solution.rms_px));
}

}  // namespace

std::optional<DepthRange> good_range(const std::vector<Ghosting>& ghosting, double most_px) {
  std::size_t best = 0, best_begin = 0, run = 0;
  for (std::size_t i = 0; i < ghosting.size(); ++i) {
    run = ghosting[i].worst_px <= most_px ? run + 1 : 0;
    if (run > best) best = run, best_begin = i + 1 - run;
  }
  if (best == 0) return std::nullopt;
  return DepthRange{ghosting[best_begin].depth_m, ghosting[best_begin + best - 1].depth_m};
}

std::string ghosting_text(const std::vector<Ghosting>& ghosting) {
  const auto metres = [](double m) {
    return std::isfinite(m) ? fmt::format("{:.2f} m", m) : std::string("infinity");
  };
  if (const auto range = good_range(ghosting, kFinePx))
    return fmt::format("good for {} px between {} and {}", kFinePx, metres(range->from_m),
                       metres(range->to_m));
  const auto best = std::min_element(ghosting.begin(), ghosting.end(), [](const auto& a, const auto& b) {
    return !(a.worst_px >= b.worst_px);  // NaN last
  });
  if (best == ghosting.end() || !std::isfinite(best->worst_px)) return {};
  return fmt::format("good for {:.2f} px at best, at {}", best->worst_px, metres(best->depth_m));
}

Eigen::MatrixXd rigidly_aligned(const Eigen::MatrixXd& covariance,
                                const std::vector<Eigen::Vector3d>& centres) {
  const auto n = static_cast<Eigen::Index>(centres.size());
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& c : centres) mean += c / static_cast<double>(n);
  double extent = 1e-12;
  for (const Eigen::Vector3d& c : centres) extent = std::max(extent, (c - mean).norm());
  Eigen::MatrixXd G(3 * n, 6);
  for (Eigen::Index i = 0; i < n; ++i) {
    // Of one length, so that the rank tells a line from a plane.
    const Eigen::Vector3d c = (centres[i] - mean) / extent;
    G.block<3, 6>(3 * i, 0) << Eigen::Matrix3d::Identity(), cross_matrix(c);
  }
  Eigen::JacobiSVD<Eigen::MatrixXd> svd(G, Eigen::ComputeThinU);
  svd.setThreshold(1e-6);
  const Eigen::MatrixXd U = svd.matrixU().leftCols(svd.rank());
  const Eigen::MatrixXd P = Eigen::MatrixXd::Identity(3 * n, 3 * n) - U * U.transpose();
  return P * covariance * P;
}

Calibration calibrate(Observations observations, const Recording& recording,
                      const CalibrationOptions& options, const Reporter& reporter) {
  Calibration c;
  c.observations = std::move(observations);
  reporter.at("solving", 0, 2);
  const Seed seed = seed_solve(c.observations);
  reporter.at("solving", 1, 2);
  c.solution = joint_solve(c.observations, seed, options.solve);
  reporter.at("solving", 2, 2);
  const std::vector<int> determined = determined_cameras(c.solution, options);
  std::vector<PlacedCamera> placed;
  for (std::size_t i = 0; i < c.solution.cameras.size(); ++i)
    placed.push_back(
        {c.solution.cameras[i].cam_from_rig, recording.cameras[i].row, recording.cameras[i].col, false});
  for (const int i : determined) placed[i].determined = true;
  c.layout = fit_layout(placed, recording.rows, recording.cols);
  for (std::size_t i = 0; i < placed.size(); ++i) c.cameras.push_back(summary_of(c, static_cast<int>(i)));
  fill_rig(c, determined);
  if (c.rig.nearest_seen_m > 0)
    c.ghosting = ghosting(c.solution, c.layout, determined, working_depths(c.rig));
  c.cross_validation_px = cross_validate(c, options, reporter);
  judge(c, options);
  note(c, recording);
  note_ghosting(c, options);
  return c;
}

}  // namespace stuv
