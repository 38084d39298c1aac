#include "calib/solve/calibrate.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "calib/solve/groups.h"
#include "calib/solve/lens_likeness.h"
#include "calib/solve/set_weights.h"
#include "calib/solve/verdict.h"
#include "core/error.h"
#include "core/parallel.h"

namespace stuv {
namespace {

CameraSummary summary_of(const Calibration& c, int camera) {
  const JointSolution& s = c.solution;
  CameraSummary summary;
  summary.seen = coverage_of(c.observations, s, camera);
  summary.boards = summary.seen.boards;
  summary.inliers = summary.seen.inliers;
  summary.outliers = summary.seen.outliers;
  summary.rms_px = summary.seen.rms_px;
  summary.coverage = summary.seen.hull;
  summary.noise_px = s.noise_px / s.camera_weight[camera];
  if (const Eigen::Index at = camera * s.camera_states; s.solved[camera] && s.camera_covariance.size() > 0) {
    const auto m = static_cast<Eigen::Index>(s.cameras[camera].intrinsics.size());
    const Eigen::MatrixXd C = s.camera_covariance.block(at, at, m, m);
    if (!C.isZero()) summary.lens_covariance = s.sigma_px * s.sigma_px * C;
  }
  if (!s.focal_sigma.empty()) summary.focal_sigma_px = s.sigma_px * s.focal_sigma[camera];
  return summary;
}

/// Distances of the nearest and farthest inlier board corner from the plane.
void note_depths(Calibration& c) {
  const std::vector<Eigen::Vector3d> model = board_points(c.observations.board);
  double nearest = std::numeric_limits<double>::infinity(), farthest = 0;
  for (const BoardObservation& b : c.observations.boards) {
    if (!c.solution.solved[b.camera]) continue;
    const Pose rig_from_board = c.layout.rig_from_ref * c.solution.ref_from_board[b.set];
    for (const Eigen::Vector3d& p : model) {
      const double z = (rig_from_board * p).z();
      nearest = std::min(nearest, z);
      farthest = std::max(farthest, z);
    }
  }
  c.rig.nearest_seen_m = std::isfinite(nearest) ? std::max(0.0, nearest) : 0;
  c.rig.farthest_seen_m = farthest;
}

/// A camera that was not solved is at no place and has a lens that says nothing: a pinhole as wide as its
/// picture, for files need one.
void make_placeholder(Camera& camera) {
  camera.width = std::max(1, camera.width);
  camera.height = std::max(1, camera.height);
  camera.lens_model = "LENSMODEL_PINHOLE";
  camera.intrinsics = {double(camera.width), double(camera.width), 0.5 * (camera.width - 1),
                       0.5 * (camera.height - 1)};
  camera.cam_from_rig = {};
}

void fill_rig(Calibration& c, const std::vector<int>& determined) {
  Rig& rig = c.rig;
  const Pose ref_from_rig = c.layout.rig_from_ref.inverse();
  set_lattice(c.layout, rig);
  for (std::size_t i = 0; i < c.solution.cameras.size(); ++i) {
    RigCamera camera;
    camera.camera = c.solution.cameras[i];
    camera.camera.cam_from_rig = c.solution.cameras[i].cam_from_rig * ref_from_rig;
    if (!c.solution.solved[i]) make_placeholder(camera.camera);
    camera.row = c.layout.row[i];
    camera.col = c.layout.col[i];
    camera.determined = false;
    if (c.solution.solved[i]) camera.off_lattice_m = c.layout.off_lattice_m[i];
    rig.cameras.push_back(std::move(camera));
  }
  for (const int i : determined) rig.cameras[i].determined = true;
  note_depths(c);
  if (determined.size() < 2) return;
  std::vector<Eigen::Vector3d> centres;
  for (const int i : determined) centres.push_back(c.solution.cameras[i].cam_from_rig.centre());
  const Eigen::MatrixXd aligned =
      std::pow(c.solution.sigma_px, 2) *
      rigidly_aligned_poses(block_of(c.solution.pose_covariance, determined, 6), centres);
  const auto n = static_cast<Eigen::Index>(determined.size());
  const Eigen::Matrix3d& R = c.layout.rig_from_ref.R;
  rig.centre_covariance_m2.resize(3 * n, 3 * n);
  for (Eigen::Index i = 0; i < n; ++i) {
    for (Eigen::Index j = 0; j < n; ++j)
      rig.centre_covariance_m2.block<3, 3>(3 * i, 3 * j) =
          R * aligned.block<3, 3>(6 * i + 3, 6 * j + 3) * R.transpose();
    const Eigen::Matrix3d turn = R * aligned.block<3, 3>(6 * i, 6 * i) * R.transpose();
    c.cameras[determined[i]].rotation_sigma_rad = turn.diagonal().cwiseMax(0).cwiseSqrt();
    rig.cameras[determined[i]].position_sigma_m =
        rig.centre_covariance_m2.diagonal().segment<3>(3 * i).cwiseMax(0).cwiseSqrt();
  }
}

/// Half as near as boards were seen, to infinity.
std::vector<double> working_depths(const Rig& rig) {
  constexpr int kDepths = 12;
  std::vector<double> depths;
  for (int i = 0; i < kDepths; ++i)
    depths.push_back(0.5 * rig.nearest_seen_m * (kDepths - 1) / (kDepths - 1.0 - i));
  return depths;
}

/// Where the projections' uncertainty is mapped: at the nearest and the middle board distance in 1/z, and at
/// infinity.
void map_projections(Calibration& c, const std::vector<int>& determined) {
  if (c.solution.camera_covariance.size() == 0 || !(c.rig.nearest_seen_m > 0)) return;
  const double middle = 2 / (1 / c.rig.nearest_seen_m + 1 / c.rig.farthest_seen_m);
  c.map_distances_m = {c.rig.nearest_seen_m, middle, std::numeric_limits<double>::infinity()};
  parallel_for(static_cast<int>(determined.size()), [&](int i) {
    for (const double distance : c.map_distances_m)
      c.cameras[determined[i]].maps.push_back(projection_map(c.solution, determined[i], distance));
  });
}

/// Views with too few corners to tell a pose are taken out; how many they were.
int drop_small_views(Observations& observations) {
  return static_cast<int>(std::erase_if(observations.boards, [](const BoardObservation& b) {
    int there = 0;
    for (std::size_t k = 0; k < b.corners_px.size(); ++k)
      there += b.corners_px[k].allFinite() && (b.weights.empty() || b.weights[k] > 0) ? 1 : 0;
    return there < 6;
  }));
}

/// The lenses of `known` that the cameras of the part are to keep, in order.
std::vector<Camera> known_lenses(const std::vector<Camera>& known, const Observations& part) {
  std::vector<Camera> lenses;
  if (known.empty()) return lenses;
  for (std::size_t c = 0; c < part.camera_names.size(); ++c) {
    const std::string& name = part.camera_names[c];
    const auto lens =
        std::find_if(known.begin(), known.end(), [&](const Camera& k) { return k.name == name; });
    if (lens == known.end())
      throw Error("camera " + name, "has no lens among those that are known", "calibrate with lenses free");
    if (Eigen::Vector2i(lens->width, lens->height) != part.size_px[c])
      throw Error("camera " + name,
                  fmt::format("has pictures of {}x{}, its known lens was calibrated at {}x{}",
                              part.size_px[c].x(), part.size_px[c].y(), lens->width, lens->height),
                  "record at that size");
    if (lens->lens_model != known.front().lens_model)
      throw Error("camera " + name, "has a known lens of another model than " + known.front().name,
                  "calibrate the lenses with one model");
    lenses.push_back(*lens);
  }
  return lenses;
}

/// What residuals tell of frames that were not taken together: lenses by each camera's own boards, and places
/// that are known less well than independent errors would make them.
void weigh_structure(Calibration& c, const SolveOptions& options) {
  c.structure = residual_structure(c.observations, c.solution);
  const int n = static_cast<int>(c.solution.cameras.size());
  if (!c.structure.frames_apart() || std::count(c.solution.solved.begin(), c.solution.solved.end(), true) < 2)
    return;
  if (!(c.validation->sigma.freedom > 0)) {
    c.place_scale = c.structure.view_ratio;
    c.solution.pose_covariance *= c.place_scale * c.place_scale;
  }
  if (!options.known.empty() || options.shared_lens || options.lens == Lens::splined) return;
  c.own_lenses.resize(n);
  parallel_for(n, [&](int i) {
    if (!c.solution.solved[i]) return;
    c.own_lenses[i] = own_lens(c.observations, c.solution, i, options);
    c.own_lenses[i].focal_sigma_px *= c.validation->sigma.scale;
  });
}

int sets_with_boards(const Observations& observations) {
  std::set<int> sets;
  for (const BoardObservation& b : observations.boards) sets.insert(b.set);
  return static_cast<int>(sets.size());
}

/// Where opencv4 does not fit: opencv5, with distortions that are alike in cameras of one make. `options` are
/// then those of the solution. It does not fit if k3 would lower the cost by more than kClear times what
/// the noise would make it, errors that solves without some of the sets show counted.
void choose_lens(const Observations& observations, const Seed& seed, int most_folds, SolveOptions& options,
                 JointSolution& solution) {
  constexpr double kClear = 4;
  constexpr int kFewestSets = 3;  // of two nothing is left to check a richer model by when one is left out
  if (!solution.converged || sets_with_boards(observations) < kFewestSets) return;
  SolveOptions richer = options;
  richer.lens = Lens::opencv5;
  const JointSolution start = as_opencv5(solution);
  const double gain = gain_of_k3(observations, start, richer) / static_cast<double>(solution.cameras.size());
  if (!(gain > kClear * std::pow(solution.noise_px, 2))) return;
  const double scale = validate_solution(observations, solution, options, most_folds).sigma.scale;
  if (!(gain > kClear * std::pow(scale * solution.noise_px, 2))) return;
  const std::vector<bool> every(observations.set_names.size(), true);
  JointSolution free = solve_again(observations, start, every, richer);
  free.sigma_px *= scale;
  const auto alike = lens_likeness(free);
  if (!alike) return;
  richer.prior = *alike;
  // From the beginning: what opencv4 did not fit it took for outliers.
  const JointSolution other = joint_solve(observations, seed, richer);
  if (!other.converged || !(other.rms_px < solution.rms_px)) return;
  options = richer;
  solution = other;
}

/// Solves the largest group of cameras; all cameras are in the result. `wanted` comes back as it was solved.
JointSolution solve_largest_group(Observations& all, const CameraGroups& groups, int most_folds,
                                  SolveOptions& wanted) {
  ObservedPart part = part_of(all, groups.groups.front());
  SolveOptions options = wanted;
  options.known = known_lenses(wanted.known, part.observations);
  if (options.shared_lens)
    for (const Eigen::Vector2i& size : part.observations.size_px)
      if (size != part.observations.size_px.front())
        throw Error("cameras of a shared lens", "have pictures of different sizes", "solve a lens each");
  const SeedLens lens = options.lens == Lens::splined ? SeedLens::stereographic : SeedLens::pinhole;
  const Seed seed = seed_solve(part.observations, lens, options.known);
  JointSolution solution = joint_solve(part.observations, seed, options);
  if (options.reweight && solution.converged && reweight_sets(solution, part.observations))
    solution = joint_solve(part.observations, seed, options);
  if (options.choose_lens && options.known.empty() && !options.shared_lens)
    choose_lens(part.observations, seed, most_folds, options, solution);
  wanted.lens = options.lens;
  wanted.prior = options.prior;
  // The seed may have brought corners into another order.
  for (std::size_t i = 0; i < part.board_of.size(); ++i) {
    all.boards[part.board_of[i]].corners_px = part.observations.boards[i].corners_px;
    all.boards[part.board_of[i]].weights = part.observations.boards[i].weights;
  }
  return as_of_all(solution, part, all);
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
  Eigen::MatrixXd poses = Eigen::MatrixXd::Zero(6 * n, 6 * n), result(3 * n, 3 * n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j)
      poses.block<3, 3>(6 * i + 3, 6 * j + 3) = covariance.block<3, 3>(3 * i, 3 * j);
  poses = rigidly_aligned_poses(poses, centres);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j)
      result.block<3, 3>(3 * i, 3 * j) = poses.block<3, 3>(6 * i + 3, 6 * j + 3);
  return result;
}

Calibration calibrate(Observations observations, const Recording& recording,
                      const CalibrationOptions& options, const Reporter& reporter) {
  Calibration c;
  c.observations = std::move(observations);
  const int small_views = drop_small_views(c.observations);
  const auto n = static_cast<int>(c.observations.camera_names.size());
  const CameraGroups groups = camera_groups(c.observations.boards, n);
  if (groups.groups.empty())
    throw Error("board " + board_spec(c.observations.board),
                "has fewer than 6 finite corners in every picture", "show more of it");
  reporter.at("solving", 0, 1);
  SolveOptions solve = options.solve;
  c.solution = solve_largest_group(c.observations, groups, options.most_folds, solve);
  reporter.at("solving", 1, 1);
  c.lens = solve.lens;
  c.lenses_alike = !solve.prior.parameter.empty();
  // First of all, for it says how large the sigmas are that all else is judged by.
  c.validation = validate_solution(c.observations, c.solution, solve, options.most_folds, reporter);
  if (c.validation->left_out) c.cross_validation_px = c.validation->left_out->rms_px;
  c.solution.sigma_px *= c.validation->sigma.scale;
  weigh_structure(c, solve);
  for (int i = 0; i < n; ++i) c.cameras.push_back(summary_of(c, i));
  note_undetermined(c, groups, options);
  // Lenses were judged by their own boards; what is said of pictures depends on places as well.
  c.solution.camera_covariance *= c.place_scale * c.place_scale;
  std::vector<PlacedCamera> placed;
  std::vector<int> determined;
  for (int i = 0; i < n; ++i) {
    const bool known = c.cameras[i].undetermined.empty();
    placed.push_back(
        {c.solution.cameras[i].cam_from_rig, recording.cameras[i].row, recording.cameras[i].col, known});
    if (known) determined.push_back(i);
  }
  c.layout = fit_layout(placed, recording.rows, recording.cols);
  fill_rig(c, determined);
  c.lattice_sigma = lattice_sigma(c.solution, placed, recording.rows, recording.cols);
  map_projections(c, determined);
  if (c.rig.nearest_seen_m > 0)
    c.ghosting = ghosting(c.solution, c.layout, determined, working_depths(c.rig));
  if (small_views > 0)
    c.notes.push_back(
        fmt::format("{} view(s) with fewer than 6 corners of the board took no part", small_views));
  judge(c, recording, options);
  return c;
}

}  // namespace stuv
