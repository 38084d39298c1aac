#include "calib/solve/joint_solve.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "calib/solve/groups.h"
#include "calib/solve/mrcal_problem.h"
#include "core/median.h"

namespace stuv {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
using Linearisation = MrcalProblem::Linearisation;

std::string lens_name(Lens lens, const Eigen::Vector2i& size_px, double focal_px) {
  if (lens == Lens::opencv4) return "LENSMODEL_OPENCV4";
  if (lens == Lens::opencv5) return "LENSMODEL_OPENCV5";
  if (lens == Lens::opencv8) return "LENSMODEL_OPENCV8";
  // Cubic splines over a tenth more than the field of view, knots square in the picture.
  const double half_rad = std::min(0.9 * M_PI, 1.1 * 2 * std::atan(0.25 * size_px.x() / focal_px));
  // No fewer than one in ten degrees: equidistant lenses are not stereographic, and the splines have to bend.
  const int nx = std::max(11, static_cast<int>(std::lround(2 * half_rad * 18 / M_PI)));
  const int ny = std::max(5, static_cast<int>(std::lround(nx * size_px.y() / double(size_px.x()))));
  return fmt::format("LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={}_Ny={}_fov_x_deg={}", nx, ny,
                     std::lround(2 * half_rad * 180 / M_PI));
}

mrcal_problem_selections_t selections(const SolveOptions& options, bool core, bool all) {
  const bool lens = options.known.empty();
  mrcal_problem_selections_t s = {};
  s.do_optimize_extrinsics = true;
  s.do_optimize_frames = true;
  // The splines of a splined lens express focal length and centre too, so its core stays where it is.
  s.do_optimize_intrinsics_core = lens && core && !(all && options.lens == Lens::splined);
  s.do_optimize_intrinsics_distortions = lens && all;
  s.do_optimize_calobject_warp = all && options.board_warp;
  s.do_apply_regularization = lens && options.regularise && core;
  return s;
}

double deviation(double sum_sq, std::size_t count) { return std::sqrt(sum_sq / static_cast<double>(count)); }

/// A median absolute deviation is this part of a Gaussian's sigma.
constexpr double kMadOfSigma = 0.6745;

/// Takes out the corners whose x or y residual is beyond kOutlierSigmas deviations of the inliers; returns
/// whether it found one that is worth another solve. (mrcal's own rejection does the same and writes to
/// stderr.)
bool reject_outliers(MrcalProblem& problem, const Linearisation& l) {
  constexpr double kOutlierSigmas = 4, kWorthSigmas = 5;
  double sum_sq = 0;
  std::vector<double> sizes;
  for (std::size_t i = 0; i < problem.corners(); ++i) {
    if (problem.weight(i) <= 0) continue;
    for (const double x : {l.x[2 * i], l.x[2 * i + 1]}) {
      sum_sq += x * x;
      sizes.push_back(std::abs(x));
    }
  }
  if (sizes.empty()) return false;
  const double worst = *std::max_element(sizes.begin(), sizes.end());
  const double sigma = std::min(deviation(sum_sq, sizes.size()), 2 * median(sizes) / kMadOfSigma);
  // Below a thousandth of a pixel deviations are those of arithmetic: exact corners have no outliers.
  if (!(worst > kWorthSigmas * sigma) || worst < 5e-3) return false;
  for (std::size_t i = 0; i < problem.corners(); ++i)
    if (std::max(std::abs(l.x[2 * i]), std::abs(l.x[2 * i + 1])) > kOutlierSigmas * std::max(sigma, 1e-3))
      problem.reject(i);
  return true;
}

/// Weighs each camera's corners by the deviation of its residuals, robustly, where they differ enough for it
/// to matter, and else all alike; returns whether that changed anything.
bool reweight_cameras(MrcalProblem& problem, const Linearisation& l, int cameras) {
  constexpr double kWorth = 1.25;
  std::vector<std::vector<double>> sizes(cameras);
  for (std::size_t i = 0; i < problem.corners(); ++i) {
    if (problem.weight(i) <= 0) continue;
    const int c = problem.camera_of(i);
    for (const double x : {l.x[2 * i], l.x[2 * i + 1]})
      sizes[c].push_back(std::abs(x) / (kMadOfSigma * problem.camera_weight(c)));
  }
  std::vector<double> sigma, sorted;
  for (auto& s : sizes) sigma.push_back(median(s));
  for (const double s : sigma)
    if (std::isfinite(s)) sorted.push_back(s);
  const double usual = median(sorted);
  if (!(usual > 1e-3)) return false;
  // A median of n residuals is uncertain by 1.2 / sqrt(n): few corners are no reason to weigh differently.
  const auto differs = [&](int c) {
    const double slack = 1 + 4 / std::sqrt(1.0 + static_cast<double>(sizes[c].size()));
    return sigma[c] > kWorth * slack * usual || sigma[c] * kWorth * slack < usual;
  };
  bool any = false, changed = false;
  for (int c = 0; c < cameras; ++c) any = any || differs(c);
  for (int c = 0; c < cameras; ++c) {
    const bool own = any && (sizes[c].size() > 100 || differs(c));
    const double factor = (own ? usual / std::max(0.1 * usual, sigma[c]) : 1) / problem.camera_weight(c);
    if (!(std::abs(factor - 1) > 0.01)) continue;
    problem.scale_weights(c, factor);
    changed = true;
  }
  return changed;
}

/// mrcal wants observations in the order of their sets.
std::vector<int> solving_order(const std::vector<BoardObservation>& boards) {
  std::vector<int> order(boards.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    return std::pair(boards[a].set, boards[a].camera) < std::pair(boards[b].set, boards[b].camera);
  });
  return order;
}

std::vector<BoardObservation> in_order(const std::vector<BoardObservation>& boards,
                                       const std::vector<int>& order) {
  std::vector<BoardObservation> result;
  for (const int i : order) result.push_back(boards[i]);
  return result;
}

std::vector<int> lenses_of(std::size_t cameras, bool shared) {
  std::vector<int> lens_of(cameras, 0);
  if (!shared) std::iota(lens_of.begin(), lens_of.end(), 0);
  return lens_of;
}

std::vector<Camera> seed_cameras(const Observations& in, const Seed& seed, const SolveOptions& options) {
  std::vector<Camera> cameras;
  // One lens model for all: that of the first picture where it has a field of view.
  const std::string model = lens_name(options.lens, in.size_px.front(), seed.focal_px.front());
  mrcal_lensmodel_t parsed;
  mrcal_lensmodel_from_name(&parsed, model.c_str());
  for (std::size_t c = 0; c < in.camera_names.size(); ++c) {
    Camera camera{in.camera_names[c], model, {}, in.size_px[c].x(), in.size_px[c].y(), seed.cam_from_ref[c]};
    if (!options.known.empty()) {
      camera.lens_model = options.known[c].lens_model;
      camera.intrinsics = options.known[c].intrinsics;
    } else {
      camera.intrinsics.assign(mrcal_lensmodel_num_params(&parsed), 0);
      camera.intrinsics[0] = camera.intrinsics[1] = seed.focal_px[c];
      camera.intrinsics[2] = 0.5 * (camera.width - 1);
      camera.intrinsics[3] = 0.5 * (camera.height - 1);
    }
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

/// Residuals, outliers and their statistics; `order` as the problem's boards were given.
void note_residuals(const Observations& in, const std::vector<int>& order, const MrcalProblem& problem,
                    const Linearisation& l, JointSolution& out) {
  const auto corners = static_cast<std::size_t>(in.board.corners());
  out.residuals_px.assign(in.boards.size(), std::vector<Eigen::Vector2d>(corners, {kNaN, kNaN}));
  out.outlier.assign(in.boards.size(), std::vector<bool>(corners, false));
  double sum_sq = 0, weighted_sum_sq = 0;
  for (std::size_t k = 0; k < order.size(); ++k) {
    const BoardObservation& b = in.boards[order[k]];
    for (std::size_t i = 0; i < corners; ++i) {
      if (!b.corners_px[i].allFinite() || (!b.weights.empty() && !(b.weights[i] > 0))) continue;
      const double weight = problem.weight(k * corners + i);
      if (weight <= 0) {
        out.outlier[order[k]][i] = true;
        ++out.outliers;
        continue;
      }
      const double* x = &l.x[2 * (k * corners + i)];
      const Eigen::Vector2d r(-x[0] / weight, -x[1] / weight);
      out.residuals_px[order[k]][i] = r;
      ++out.inliers;
      sum_sq += r.squaredNorm();
      weighted_sum_sq += x[0] * x[0] + x[1] * x[1];
      out.worst_px = std::max(out.worst_px, r.norm());
    }
  }
  out.rms_px = std::sqrt(weighted_sum_sq / (2.0 * out.inliers));
  out.rms_unweighted_px = std::sqrt(sum_sq / (2.0 * out.inliers));
  const double freedom = 2.0 * out.inliers - l.states;
  out.noise_px = freedom > 0 ? std::sqrt(weighted_sum_sq / freedom) : kNaN;
  out.sigma_px = out.noise_px;
  for (std::size_t c = 0; c < out.cameras.size(); ++c)
    out.camera_weight.push_back(problem.camera_weight(static_cast<int>(c)));
}

/// d (dtheta, dc) / d (r, t) of x_cam = R(r) x + t. The camera's axes in the reference frame turn by
/// dtheta = -J_r(r) dr; its centre is c = -R^T t: dc/dt = -R^T, dc/dr = [c]x J_r(r).
Eigen::Matrix<double, 6, 6> pose_jacobian(const Pose& cam_from_ref) {
  const Eigen::Matrix3d Jr = right_jacobian(vector_from_rotation(cam_from_ref.R));
  Eigen::Matrix<double, 6, 6> J;
  J << -Jr, Eigen::Matrix3d::Zero(), cross_matrix(cam_from_ref.centre()) * Jr, -cam_from_ref.R.transpose();
  return J;
}

/// d (omega, tau) / d (r, t) of x_ref = R(r) x + t: omega = R J_r(r) dr, tau = dt - omega x t.
Eigen::Matrix<double, 6, 6> motion_jacobian(const Pose& ref_from_board) {
  const Eigen::Matrix3d turn = ref_from_board.R * right_jacobian(vector_from_rotation(ref_from_board.R));
  Eigen::Matrix<double, 6, 6> J;
  J << turn, Eigen::Matrix3d::Zero(), cross_matrix(ref_from_board.t) * turn, Eigen::Matrix3d::Identity();
  return J;
}

/// The step that Gauss and Newton would still take lowers the cost by no part worth having.
bool at_minimum(NormalFactor& factor, const Linearisation& l) {
  const Eigen::VectorXd gradient = l.gradient();
  const double cost = l.cost();
  const double decrease = gradient.dot(factor.solve(gradient).col(0));
  return std::isfinite(cost) && decrease <= 1e-4 * cost + 1e-10 * l.measurements;
}

/// What the covariances are read off: a solved problem at its last stage.
struct Solved {
  const MrcalProblem& problem;
  mrcal_problem_selections_t what;
  NormalFactor& factor;
  Eigen::VectorXd scale;  ///< of the packed state
};

/// Columns of lens parameters, rotation vector and translation of each camera, and of the mean motion.
void note_camera_covariance(const Solved& s, JointSolution& out) {
  const int n = static_cast<int>(out.cameras.size());
  const int lens_states = static_cast<int>(out.cameras.front().intrinsics.size());
  const int per_camera = lens_states + 6, columns = n * per_camera + 6;
  if (columns > kMostCameraStates) return;
  // Without its core a lens's states begin behind it.
  const int held = s.what.do_optimize_intrinsics_core ? 0 : 4;
  Eigen::MatrixXd At = Eigen::MatrixXd::Zero(s.scale.size(), columns);
  const auto pick = [&](int column, int state) { At(state, column) = s.scale[state]; };
  for (int c = 0; c < n; ++c) {
    if (const int lens = s.problem.lens_state(s.what, c);
        lens >= 0 && s.what.do_optimize_intrinsics_distortions)
      for (int k = held; k < lens_states; ++k) pick(c * per_camera + k, lens + k - held);
    if (const int pose = s.problem.pose_state(s.what, c); pose >= 0)
      for (int k = 0; k < 6; ++k) pick(c * per_camera + lens_states + k, pose + k);
  }
  std::vector<int> sets;
  for (std::size_t i = 0; i < out.ref_from_board.size(); ++i)
    if (s.problem.frame_state(s.what, static_cast<int>(i)) >= 0) sets.push_back(static_cast<int>(i));
  for (const int set : sets) {
    const int frame = s.problem.frame_state(s.what, set);
    At.block(frame, columns - 6, 6, 6) =
        s.scale.segment<6>(frame).asDiagonal() *
        (motion_jacobian(out.ref_from_board[set]).transpose() / static_cast<double>(sets.size()));
  }
  out.camera_states = per_camera;
  out.camera_covariance = At.transpose() * s.factor.solve(At);
}

void note_covariance(const Solved& s, JointSolution& out) {
  const int n = static_cast<int>(out.cameras.size());
  // Columns of A^T map the packed state to turns and centres, and to focal lengths.
  Eigen::MatrixXd At = Eigen::MatrixXd::Zero(s.scale.size(), 8 * n);
  for (int c = 0; c < n; ++c) {
    if (const int pose = s.problem.pose_state(s.what, c); pose >= 0)
      At.block(pose, 6 * c, 6, 6) = pose_jacobian(out.cameras[c].cam_from_rig).transpose();
    if (const int lens = s.problem.lens_state(s.what, c); lens >= 0 && s.what.do_optimize_intrinsics_core)
      At(lens, 6 * n + 2 * c) = At(lens + 1, 6 * n + 2 * c + 1) = 1;
  }
  At = s.scale.asDiagonal() * At;
  const Eigen::MatrixXd covariance = At.transpose() * s.factor.solve(At);
  out.pose_covariance = covariance.topLeftCorner(6 * n, 6 * n);
  out.pose_covariance = 0.5 * (out.pose_covariance + out.pose_covariance.transpose()).eval();
  for (int c = 0; c < n; ++c)
    out.focal_sigma.emplace_back(std::sqrt(covariance(6 * n + 2 * c, 6 * n + 2 * c)),
                                 std::sqrt(covariance(6 * n + 2 * c + 1, 6 * n + 2 * c + 1)));
  note_camera_covariance(s, out);
}

/// Only the corners that were inliers of `solution`.
std::vector<BoardObservation> inliers_only(const Observations& in, const JointSolution& solution) {
  std::vector<BoardObservation> boards = in.boards;
  for (std::size_t i = 0; i < boards.size(); ++i) {
    boards[i].weights.resize(boards[i].corners_px.size(), 1);
    for (std::size_t k = 0; k < boards[i].weights.size(); ++k)
      if (!solution.residuals_px[i][k].allFinite()) boards[i].weights[k] = 0;
  }
  return boards;
}

/// `boards`: the inliers, and the corners that were taken out but are predicted within 3.5 sigma after all;
/// how many these are.
int take_back(const Observations& in, const JointSolution& s, std::vector<BoardObservation>& boards) {
  const std::vector<Eigen::Vector3d> model = board_points(in.board);
  boards = inliers_only(in, s);
  int count = 0;
  for (std::size_t i = 0; i < in.boards.size(); ++i) {
    const BoardObservation& b = in.boards[i];
    const Pose cam_from_board = s.cameras[b.camera].cam_from_rig * s.ref_from_board[b.set];
    std::vector<Eigen::Vector3d> points;
    std::vector<std::size_t> which;
    for (std::size_t k = 0; k < model.size(); ++k)
      if (s.outlier[i][k]) points.push_back(cam_from_board * model[k]), which.push_back(k);
    if (which.empty()) continue;
    const std::vector<Eigen::Vector2d> predicted = project(s.cameras[b.camera], points);
    for (std::size_t j = 0; j < which.size(); ++j) {
      const double most = 3.5 * s.noise_px / s.camera_weight[b.camera];
      if (!((predicted[j] - b.corners_px[which[j]]).cwiseAbs().maxCoeff() < most)) continue;
      boards[i].weights[which[j]] = b.weights.empty() ? 1 : b.weights[which[j]];
      ++count;
    }
  }
  return count;
}

void reject_suspects(const Seed& seed, const std::vector<int>& order, MrcalProblem& problem) {
  std::size_t corner = 0;
  for (const int i : order)
    for (const bool suspect : seed.suspect[i]) {
      if (suspect && problem.weight(corner) > 0) problem.reject(corner);
      ++corner;
    }
}

/// Rounds of rejection until no corner is worth another solve.
bool settle(MrcalProblem& problem, mrcal_problem_selections_t what, Linearisation& l,
            const SolveOptions& options) {
  constexpr int kMostRounds = 20;
  bool solved = true;
  for (int round = 0; solved && options.reject_outliers && round < kMostRounds; ++round) {
    if (!reject_outliers(problem, l)) break;
    solved = problem.optimise(what) && problem.linearise(what, l);
  }
  return solved;
}

JointSolution solution_of(const Observations& in, const std::vector<int>& order, const MrcalProblem& problem,
                          const Linearisation& l) {
  JointSolution out;
  out.cameras = problem.cameras();
  out.solved.assign(out.cameras.size(), true);
  out.ref_from_board = problem.ref_from_board();
  out.warp_m = problem.warp_m();
  note_residuals(in, order, problem, l, out);
  return out;
}

void finish(const MrcalProblem& problem, mrcal_problem_selections_t what, bool solved, Linearisation& l,
            const SolveOptions& options, JointSolution& out) {
  NormalFactor factor(l);
  out.converged = solved && factor.good() && out.inliers > 0 && at_minimum(factor, l);
  if (options.covariance && factor.good())
    note_covariance({problem, what, factor, problem.state_scale(what)}, out);
}

}  // namespace

JointSolution joint_solve(const Observations& in, const Seed& seed, const SolveOptions& options) {
  const std::vector<int> order = solving_order(in.boards);
  MrcalProblem problem({in.board,
                        seed_cameras(in, seed, options),
                        lenses_of(in.camera_names.size(), options.shared_lens),
                        seed.ref_from_board,
                        {0, 0},
                        in_order(in.boards, order),
                        {},
                        options.prior});
  if (options.reject_outliers) reject_suspects(seed, order, problem);
  const auto all = selections(options, true, true);
  bool solved = problem.optimise(selections(options, false, false));
  if (options.known.empty()) solved = solved && problem.optimise(selections(options, true, false));
  solved = solved && problem.optimise(all);
  Linearisation l;
  solved = problem.linearise(all, l) && solved;
  const int cameras = static_cast<int>(in.camera_names.size());
  const auto reweight = [&] {
    if (solved && options.reweight && reweight_cameras(problem, l, cameras))
      solved = problem.optimise(all) && problem.linearise(all, l);
  };
  reweight();
  solved = solved && settle(problem, all, l, options);
  reweight();
  JointSolution out = solution_of(in, order, problem, l);
  std::vector<BoardObservation> boards;
  if (solved && options.reject_outliers && take_back(in, out, boards) > 0) {
    MrcalProblem again({in.board, out.cameras, lenses_of(in.camera_names.size(), options.shared_lens),
                        out.ref_from_board, out.warp_m, in_order(boards, order), out.camera_weight,
                        options.prior});
    solved = again.optimise(all) && again.linearise(all, l) && settle(again, all, l, options);
    out = solution_of(in, order, again, l);
    finish(again, all, solved, l, options, out);
    return out;
  }
  finish(problem, all, solved, l, options, out);
  return out;
}

JointSolution as_of_all(const JointSolution& part, const ObservedPart& map, const Observations& all) {
  const std::size_t n = all.camera_names.size();
  const auto corners = static_cast<std::size_t>(all.board.corners());
  JointSolution out = part;
  out.solved.assign(n, false);
  out.cameras.assign(n, {});
  out.camera_weight.assign(n, 1);
  out.residuals_px.assign(all.boards.size(), std::vector<Eigen::Vector2d>(corners, {kNaN, kNaN}));
  out.outlier.assign(all.boards.size(), std::vector<bool>(corners, false));
  const bool covariance = part.pose_covariance.size() > 0, of_all = part.camera_covariance.size() > 0;
  const Eigen::Index k = part.camera_states;
  if (covariance) out.focal_sigma.assign(n, {0, 0});
  if (covariance) out.pose_covariance = Eigen::MatrixXd::Zero(6 * n, 6 * n);
  if (of_all) out.camera_covariance = Eigen::MatrixXd::Zero(k * n + 6, k * n + 6);
  for (std::size_t c = 0; c < n; ++c) {
    out.cameras[c].name = all.camera_names[c];
    out.cameras[c].width = all.size_px[c].x();
    out.cameras[c].height = all.size_px[c].y();
  }
  for (std::size_t a = 0; a < map.camera_of.size(); ++a) {
    const int c = map.camera_of[a];
    out.solved[c] = true;
    out.cameras[c] = part.cameras[a];
    out.camera_weight[c] = part.camera_weight[a];
    if (covariance) out.focal_sigma[c] = part.focal_sigma[a];
    for (std::size_t b = 0; b < map.camera_of.size(); ++b) {
      const int d = map.camera_of[b];
      if (covariance)
        out.pose_covariance.block<6, 6>(6 * c, 6 * d) = part.pose_covariance.block<6, 6>(6 * a, 6 * b);
      if (of_all)
        out.camera_covariance.block(k * c, k * d, k, k) = part.camera_covariance.block(k * a, k * b, k, k);
    }
    if (!of_all) continue;
    out.camera_covariance.block(k * c, k * n, k, 6) =
        part.camera_covariance.block(k * a, part.camera_covariance.cols() - 6, k, 6);
    out.camera_covariance.block(k * n, k * c, 6, k) =
        out.camera_covariance.block(k * c, k * n, k, 6).transpose();
  }
  if (of_all)
    out.camera_covariance.bottomRightCorner<6, 6>() = part.camera_covariance.bottomRightCorner<6, 6>();
  for (std::size_t i = 0; i < map.board_of.size(); ++i) {
    out.residuals_px[map.board_of[i]] = part.residuals_px[i];
    out.outlier[map.board_of[i]] = part.outlier[i];
  }
  return out;
}

JointSolution solve_again(const Observations& in, const JointSolution& start,
                          const std::vector<bool>& with_set, const SolveOptions& options) {
  Observations all = in;
  all.boards = inliers_only(in, start);
  std::vector<BoardObservation> chosen;
  for (const BoardObservation& b : all.boards)
    if (with_set[b.set] && start.solved[b.camera]) chosen.push_back(b);
  all.boards = chosen;
  const CameraGroups groups = camera_groups(all.boards, static_cast<int>(in.camera_names.size()));
  JointSolution nothing;
  nothing.solved.assign(in.camera_names.size(), false);
  if (groups.groups.empty()) return nothing;
  const ObservedPart part = part_of(all, groups.groups[0]);
  SolveOptions settings = options;
  settings.known.clear();
  std::vector<Camera> cameras;
  std::vector<double> weight;
  for (const int c : part.camera_of) {
    cameras.push_back(start.cameras[c]);
    weight.push_back(start.camera_weight[c]);
    if (!options.known.empty()) settings.known.push_back(start.cameras[c]);
  }
  const Pose ref_from_new = cameras.front().cam_from_rig.inverse();
  for (Camera& c : cameras) c.cam_from_rig = c.cam_from_rig * ref_from_new;
  std::vector<Pose> frames = start.ref_from_board;
  for (Pose& f : frames) f = ref_from_new.inverse() * f;
  const std::vector<int> order = solving_order(part.observations.boards);
  MrcalProblem problem({in.board, cameras, lenses_of(cameras.size(), options.shared_lens), frames,
                        start.warp_m, in_order(part.observations.boards, order), weight, options.prior});
  const auto what = selections(settings, true, true);
  Linearisation l;
  const bool solved = problem.optimise(what) && problem.linearise(what, l);
  if (!solved) return nothing;
  JointSolution out = solution_of(part.observations, order, problem, l);
  finish(problem, what, solved, l, settings, out);
  out = as_of_all(out, part, all);
  out.residuals_px.clear();
  out.outlier.clear();
  return out;
}

JointSolution as_opencv5(JointSolution solution) {
  for (Camera& camera : solution.cameras) {
    camera.lens_model = lens_name(Lens::opencv5, {}, 0);
    camera.intrinsics.push_back(0);
  }
  return solution;
}

double gain_of_k3(const Observations& in, const JointSolution& s, const SolveOptions& options) {
  const std::vector<int> order = solving_order(in.boards);
  const MrcalProblem problem({in.board,
                              s.cameras,
                              lenses_of(s.cameras.size(), options.shared_lens),
                              s.ref_from_board,
                              s.warp_m,
                              in_order(inliers_only(in, s), order),
                              s.camera_weight,
                              {}});
  Linearisation l;
  if (!problem.linearise(selections(options, true, true), l)) return 0;
  NormalFactor factor(l);
  const Eigen::VectorXd gradient = l.gradient();
  return factor.good() ? gradient.dot(factor.solve(gradient).col(0)) : 0;
}

HeldOutError held_out_error(const Observations& in, const JointSolution& solution, int set,
                            const JointSolution& inliers_of) {
  std::vector<BoardObservation> held;
  for (const BoardObservation& b : inliers_only(in, inliers_of))
    if (b.set == set && solution.solved[b.camera] &&
        std::any_of(b.weights.begin(), b.weights.end(), [](double w) { return w > 0; }))
      held.push_back(b);
  if (held.empty()) return {};
  std::vector<Camera> solved;
  std::vector<double> weight;
  std::vector<int> new_index(solution.cameras.size(), -1);
  Pose new_from_ref;
  for (std::size_t c = 0; c < solution.cameras.size(); ++c) {
    if (!solution.solved[c]) continue;
    // The first one's frame is this solution's reference.
    if (solved.empty()) new_from_ref = inliers_of.cameras[c].cam_from_rig;
    new_index[c] = static_cast<int>(solved.size());
    solved.push_back(solution.cameras[c]);
    weight.push_back(inliers_of.camera_weight[c]);
  }
  for (BoardObservation& b : held) b.camera = new_index[b.camera];
  mrcal_problem_selections_t pose_only = {};
  pose_only.do_optimize_frames = true;
  std::vector<Pose> frames(inliers_of.ref_from_board.size());
  frames[set] = new_from_ref * inliers_of.ref_from_board[set];
  MrcalProblem check(
      {in.board, solved, lenses_of(solved.size(), false), frames, solution.warp_m, held, weight, {}});
  Linearisation l;
  if (!check.optimise(pose_only) || !check.linearise(pose_only, l)) return {};
  HeldOutError error;
  for (std::size_t k = 0; k < l.x.size(); ++k) {
    const double w = check.weight(k / 2);
    if (w <= 0) continue;
    error.sum_sq_px2 += l.x[k] * l.x[k];
    ++error.count;
  }
  error.ref_from_board = check.ref_from_board()[set];
  return error;
}

}  // namespace stuv
