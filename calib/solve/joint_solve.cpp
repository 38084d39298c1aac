#include "calib/solve/joint_solve.h"

#include <fmt/format.h>
#include <suitesparse/cholmod.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

extern "C" {
#include <mrcal/mrcal.h>
}

namespace stuv {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

std::string lens_name(Lens lens, const Eigen::Vector2i& size_px, double focal_px) {
  if (lens == Lens::opencv4) return "LENSMODEL_OPENCV4";
  if (lens == Lens::opencv8) return "LENSMODEL_OPENCV8";
  // Cubic splines over a tenth more than the field of view, knots square in the picture.
  const double half_rad = std::atan(0.5 * size_px.x() / focal_px);
  const int nx = 11;
  const int ny = std::max(5, static_cast<int>(std::lround(nx * size_px.y() / double(size_px.x()))));
  return fmt::format("LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx={}_Ny={}_fov_x_deg={}", nx, ny,
                     std::lround(1.1 * 2 * half_rad * 180 / M_PI));
}

mrcal_point3_t point(double x, double y, double z) {
  mrcal_point3_t p = {};
  p.x = x, p.y = y, p.z = z;
  return p;
}

mrcal_pose_t to_mrcal(const Pose& pose) {
  const Eigen::Vector3d r = vector_from_rotation(pose.R);
  return {point(r.x(), r.y(), r.z()), point(pose.t.x(), pose.t.y(), pose.t.z())};
}

Pose from_mrcal(const mrcal_pose_t& p) {
  return {rotation_from_vector({p.r.x, p.r.y, p.r.z}), {p.t.x, p.t.y, p.t.z}};
}

mrcal_problem_selections_t selections(const SolveOptions& options, bool core, bool all) {
  mrcal_problem_selections_t s = {};
  s.do_optimize_extrinsics = true;
  s.do_optimize_frames = true;
  // The splines of a splined lens express focal length and centre too, so its core stays where it is.
  s.do_optimize_intrinsics_core = core && !(all && options.lens == Lens::splined);
  s.do_optimize_intrinsics_distortions = all;
  s.do_optimize_calobject_warp = all && options.board_warp;
  s.do_apply_regularization = options.regularise && core;
  return s;
}

/// The arrays that mrcal's functions take.
class Problem {
 public:
  /// cameras: where to start from, the first one is the reference; `boards` index cameras and sets.
  Problem(const Board& board, const std::vector<Camera>& cameras, const std::vector<Pose>& ref_from_board,
          const Eigen::Vector2d& warp_m, const std::vector<BoardObservation>& boards)
      : board_(board), cameras_(cameras), ref_from_board_(ref_from_board) {
    mrcal_lensmodel_from_name(&lens_, cameras.front().lens_model.c_str());
    params_ = mrcal_lensmodel_num_params(&lens_);
    for (const Camera& c : cameras) {
      intrinsics_.insert(intrinsics_.end(), c.intrinsics.begin(), c.intrinsics.end());
      sizes_.insert(sizes_.end(), {c.width, c.height});
      if (&c != &cameras.front()) extrinsics_.push_back(to_mrcal(c.cam_from_rig));
    }
    // Sets without a board have no pose to solve for.
    frame_of_.assign(ref_from_board.size(), -1);
    for (const BoardObservation& b : boards) frame_of_[b.set] = 0;
    for (std::size_t s = 0; s < ref_from_board.size(); ++s) {
      if (frame_of_[s] < 0) continue;
      frame_of_[s] = static_cast<int>(frames_.size());
      frames_.push_back(to_mrcal(ref_from_board[s]));
    }
    warp_.x2 = warp_m.x();
    warp_.y2 = warp_m.y();
    add_observations(boards);
  }

  /// Whether mrcal solved it without losing finiteness.
  bool optimise(mrcal_problem_selections_t what) {
    if (!std::isfinite(mrcal_optimize(nullptr, 0, nullptr, 0, intrinsics_.data(), extrinsics_.data(),
                                      frames_.data(), nullptr, &warp_, n_cameras(), n_cameras() - 1,
                                      n_frames(), 0, 0, observations_.data(), nullptr, n_boards(), 0,
                                      pool_.data(), &lens_, sizes_.data(), what, &constants_, board_.square_m,
                                      board_.columns, board_.rows, false, false)
                           .rms_reproj_error__pixels))
      return false;
    const auto finite = [](double v) { return std::isfinite(v); };
    return std::all_of(intrinsics_.begin(), intrinsics_.end(), finite);
  }

  struct Linearisation {
    int states = 0, measurements = 0;
    std::vector<double> x;         // the boards' measurements first, then regularisation
    std::vector<int> column, row;  // J^T by columns: one a measurement
    std::vector<double> value;
    cholmod_sparse Jt = {};
  };

  /// Residuals and Jacobian at the present values.
  bool linearise(mrcal_problem_selections_t what, Linearisation& l) const {
    l.states = mrcal_num_states(n_cameras(), n_cameras() - 1, n_frames(), 0, 0, n_boards(), what, &lens_);
    l.measurements = mrcal_num_measurements(n_boards(), 0, board_.columns, board_.rows, n_cameras(),
                                            n_cameras() - 1, n_frames(), 0, 0, what, &lens_);
    const int nonzero =
        _mrcal_num_j_nonzero(n_boards(), 0, board_.columns, board_.rows, n_cameras(), n_cameras() - 1,
                             n_frames(), 0, 0, observations_.data(), nullptr, what, &lens_);
    l.x.assign(l.measurements, 0);
    l.column.assign(l.measurements + 1, 0);
    l.row.assign(nonzero, 0);
    l.value.assign(nonzero, 0);
    l.Jt.nrow = l.states;
    l.Jt.ncol = l.measurements;
    l.Jt.nzmax = nonzero;
    l.Jt.p = l.column.data();
    l.Jt.i = l.row.data();
    l.Jt.x = l.value.data();
    l.Jt.itype = CHOLMOD_INT;
    l.Jt.xtype = CHOLMOD_REAL;
    l.Jt.dtype = CHOLMOD_DOUBLE;
    l.Jt.sorted = 1;
    l.Jt.packed = 1;
    std::vector<double> state(l.states);
    return mrcal_optimizer_callback(state.data(), l.states * static_cast<int>(sizeof(double)), l.x.data(),
                                    l.measurements * static_cast<int>(sizeof(double)), &l.Jt,
                                    intrinsics_.data(), extrinsics_.data(), frames_.data(), nullptr, &warp_,
                                    n_cameras(), n_cameras() - 1, n_frames(), 0, 0, observations_.data(),
                                    nullptr, n_boards(), 0, pool_.data(), &lens_, sizes_.data(), what,
                                    &constants_, board_.square_m, board_.columns, board_.rows, false);
  }

  /// Packed state (unitless, as in J) to metres, radians and pixels: scales the vector in place.
  void unpack(mrcal_problem_selections_t what, double* state) const {
    mrcal_unpack_solver_state_vector(state, n_cameras(), n_cameras() - 1, n_frames(), 0, 0, what, &lens_);
  }
  /// First state of a camera's lens or pose; below 0 if it is none.
  int lens_state(mrcal_problem_selections_t what, int camera) const {
    return mrcal_state_index_intrinsics(camera, n_cameras(), n_cameras() - 1, n_frames(), 0, 0, n_boards(),
                                        what, &lens_);
  }
  int pose_state(mrcal_problem_selections_t what, int camera) const {
    if (camera == 0) return -1;
    return mrcal_state_index_extrinsics(camera - 1, n_cameras(), n_cameras() - 1, n_frames(), 0, 0,
                                        n_boards(), what, &lens_);
  }

  std::vector<Camera> cameras() const {
    std::vector<Camera> result = cameras_;
    for (int c = 0; c < n_cameras(); ++c) {
      result[c].intrinsics.assign(intrinsics_.begin() + c * params_, intrinsics_.begin() + (c + 1) * params_);
      result[c].cam_from_rig = c == 0 ? Pose{} : from_mrcal(extrinsics_[c - 1]);
    }
    return result;
  }
  std::vector<Pose> ref_from_board() const {
    std::vector<Pose> result = ref_from_board_;
    for (std::size_t s = 0; s < result.size(); ++s)
      if (frame_of_[s] >= 0) result[s] = from_mrcal(frames_[frame_of_[s]]);
    return result;
  }
  Eigen::Vector2d warp() const { return {warp_.x2, warp_.y2}; }
  double weight(std::size_t i) const { return pool_[i].z; }
  void reject(std::size_t i) { pool_[i].z = -1; }

 private:
  void add_observations(const std::vector<BoardObservation>& boards) {
    for (const BoardObservation& b : boards) {
      observations_.push_back({{b.camera, b.camera - 1}, frame_of_[b.set]});
      for (std::size_t i = 0; i < b.corners_px.size(); ++i) {
        const Eigen::Vector2d& q = b.corners_px[i];
        const double weight = b.weights.empty() ? 1 : b.weights[i];
        const bool there = q.allFinite() && weight > 0;
        pool_.push_back(there ? point(q.x(), q.y(), weight) : point(0, 0, -1));
      }
    }
  }
  int n_cameras() const { return static_cast<int>(cameras_.size()); }
  int n_frames() const { return static_cast<int>(frames_.size()); }
  int n_boards() const { return static_cast<int>(observations_.size()); }

  Board board_;
  std::vector<Camera> cameras_;
  std::vector<Pose> ref_from_board_;
  mrcal_lensmodel_t lens_ = {};
  int params_ = 0;
  std::vector<double> intrinsics_;
  std::vector<mrcal_pose_t> extrinsics_, frames_;
  std::vector<int> frame_of_, sizes_;
  mrcal_calobject_warp_t warp_ = {};
  std::vector<mrcal_observation_board_t> observations_;
  std::vector<mrcal_point3_t> pool_;
  mrcal_problem_constants_t constants_ = {0.01, 1e5};  // of single points, which we have none of
};

/// Takes out the corners whose x or y residual is beyond kOutlierSigmas deviations of the inliers; returns
/// whether it found one that is worth another solve. (mrcal's own rejection does the same and writes to
/// stderr.)
bool reject_outliers(Problem& problem, const Problem::Linearisation& l, std::size_t corners) {
  constexpr double kOutlierSigmas = 4.5, kWorthSigmas = 5;
  double sum_sq = 0;
  std::size_t count = 0;
  for (std::size_t i = 0; i < corners; ++i) {
    if (problem.weight(i) <= 0) continue;
    sum_sq += l.x[2 * i] * l.x[2 * i] + l.x[2 * i + 1] * l.x[2 * i + 1];
    count += 2;
  }
  const double sigma = std::sqrt(sum_sq / static_cast<double>(count));
  double worst = 0;
  for (std::size_t i = 0; i < corners; ++i)
    if (problem.weight(i) > 0) worst = std::max({worst, std::abs(l.x[2 * i]), std::abs(l.x[2 * i + 1])});
  // Below a thousandth of a pixel deviations are those of arithmetic: exact corners have no outliers.
  if (!(worst > kWorthSigmas * sigma) || sigma < 1e-3) return false;
  for (std::size_t i = 0; i < corners; ++i)
    if (std::max(std::abs(l.x[2 * i]), std::abs(l.x[2 * i + 1])) > kOutlierSigmas * sigma) problem.reject(i);
  return true;
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

std::vector<Camera> seed_cameras(const Observations& in, const Seed& seed, Lens lens) {
  std::vector<Camera> cameras;
  // One lens model for all: that of the widest picture where it has a field of view.
  const std::string model = lens_name(lens, in.size_px.front(), seed.focal_px.front());
  mrcal_lensmodel_t parsed;
  mrcal_lensmodel_from_name(&parsed, model.c_str());
  for (std::size_t c = 0; c < in.camera_names.size(); ++c) {
    Camera camera{in.camera_names[c], model, {}, in.size_px[c].x(), in.size_px[c].y(), seed.cam_from_ref[c]};
    camera.intrinsics.assign(mrcal_lensmodel_num_params(&parsed), 0);
    camera.intrinsics[0] = camera.intrinsics[1] = seed.focal_px[c];
    camera.intrinsics[2] = 0.5 * (camera.width - 1);
    camera.intrinsics[3] = 0.5 * (camera.height - 1);
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

/// Residuals, outliers and their statistics; `order` as the problem's boards were given.
void note_residuals(const Observations& in, const std::vector<int>& order, const Problem& problem,
                    const Problem::Linearisation& l, JointSolution& out) {
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
  out.rms_px = std::sqrt(sum_sq / (2.0 * out.inliers));
  const double freedom = 2.0 * out.inliers - l.states;
  out.noise_px = freedom > 0 ? std::sqrt(weighted_sum_sq / freedom) : kNaN;
}

/// d centre / d (r, t) of x_cam = R(r) x + t: centre c = -R^T t, dc/dt = -R^T, dc/dr = [c]x J_r(r).
Eigen::Matrix<double, 3, 6> centre_jacobian(const Pose& cam_from_ref) {
  Eigen::Matrix<double, 3, 6> J;
  J << cross_matrix(cam_from_ref.centre()) * right_jacobian(vector_from_rotation(cam_from_ref.R)),
      -cam_from_ref.R.transpose();
  return J;
}

/// A CHOLMOD session with its factor of J^T J (+ a hair, so that free directions get a finite variance).
class Factor {
 public:
  explicit Factor(Problem::Linearisation& l) : states_(l.states) {
    cholmod_start(&common_);
    common_.print = 0;
    factor_ = cholmod_analyze(&l.Jt, &common_);
    double beta[2] = {1e-9, 0};
    if (factor_ != nullptr) cholmod_factorize_p(&l.Jt, beta, nullptr, 0, factor_, &common_);
    good_ = factor_ != nullptr && common_.status == CHOLMOD_OK;
  }
  ~Factor() {
    cholmod_free_factor(&factor_, &common_);
    cholmod_finish(&common_);
  }
  Factor(const Factor&) = delete;
  Factor& operator=(const Factor&) = delete;

  bool good() const { return good_; }

  /// (J^T J)^-1 B; B: states x n.
  Eigen::MatrixXd solve(Eigen::MatrixXd B) {
    cholmod_dense b = {};
    b.nrow = b.d = states_;
    b.ncol = B.cols();
    b.nzmax = B.size();
    b.x = B.data();
    b.xtype = CHOLMOD_REAL;
    b.dtype = CHOLMOD_DOUBLE;
    cholmod_dense* x = cholmod_solve(CHOLMOD_A, factor_, &b, &common_);
    if (x == nullptr) return Eigen::MatrixXd::Constant(B.rows(), B.cols(), kNaN);
    Eigen::MatrixXd result = Eigen::Map<Eigen::MatrixXd>(static_cast<double*>(x->x), B.rows(), B.cols());
    cholmod_free_dense(&x, &common_);
    return result;
  }

 private:
  cholmod_common common_ = {};
  cholmod_factor* factor_ = nullptr;
  std::size_t states_ = 0;
  bool good_ = false;
};

/// The step that Gauss and Newton would still take lowers the cost by no part worth having.
bool at_minimum(Factor& factor, const Problem::Linearisation& l) {
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(l.states);
  double cost = 0;
  for (int m = 0; m < l.measurements; ++m) {
    cost += l.x[m] * l.x[m];
    for (int k = l.column[m]; k < l.column[m + 1]; ++k) gradient[l.row[k]] += l.value[k] * l.x[m];
  }
  const double decrease = gradient.dot(factor.solve(gradient).col(0));
  return std::isfinite(cost) && decrease <= 1e-4 * cost + 1e-10 * l.measurements;
}

/// `scale`: of the packed state.
void note_camera_covariance(const Problem& problem, mrcal_problem_selections_t what, Factor& factor,
                            const Eigen::VectorXd& scale, JointSolution& out) {
  const int n = static_cast<int>(out.cameras.size());
  const int lens_states = static_cast<int>(out.cameras.front().intrinsics.size());
  const int per_camera = lens_states + 6;
  if (n * per_camera > kMostCameraStates) return;
  // Without its core a lens's states begin behind it.
  const int held = what.do_optimize_intrinsics_core ? 0 : 4;
  Eigen::MatrixXd At = Eigen::MatrixXd::Zero(scale.size(), n * per_camera);
  const auto pick = [&](int column, int state) { At(state, column) = scale[state]; };
  for (int c = 0; c < n; ++c) {
    if (const int lens = problem.lens_state(what, c); lens >= 0)
      for (int k = held; k < lens_states; ++k) pick(c * per_camera + k, lens + k - held);
    if (const int pose = problem.pose_state(what, c); pose >= 0)
      for (int k = 0; k < 6; ++k) pick(c * per_camera + lens_states + k, pose + k);
  }
  out.camera_states = per_camera;
  out.camera_covariance = At.transpose() * factor.solve(At);
}

void note_covariance(const Problem& problem, mrcal_problem_selections_t what, Factor& factor, int states,
                     JointSolution& out) {
  const int n = static_cast<int>(out.cameras.size());
  // Rows of A map the packed state to centres and to focal lengths.
  Eigen::VectorXd scale = Eigen::VectorXd::Ones(states);
  problem.unpack(what, scale.data());
  Eigen::MatrixXd At = Eigen::MatrixXd::Zero(states, 5 * n);
  for (int c = 0; c < n; ++c) {
    if (const int pose = problem.pose_state(what, c); pose >= 0)
      At.block(pose, 3 * c, 6, 3) = centre_jacobian(out.cameras[c].cam_from_rig).transpose();
    if (const int lens = problem.lens_state(what, c); lens >= 0 && what.do_optimize_intrinsics_core)
      At(lens, 3 * n + 2 * c) = At(lens + 1, 3 * n + 2 * c + 1) = 1;
  }
  At = scale.asDiagonal() * At;
  const Eigen::MatrixXd covariance = At.transpose() * factor.solve(At);
  out.centre_covariance = covariance.topLeftCorner(3 * n, 3 * n);
  out.centre_covariance = 0.5 * (out.centre_covariance + out.centre_covariance.transpose()).eval();
  note_camera_covariance(problem, what, factor, scale, out);
  for (int c = 0; c < n; ++c)
    out.focal_sigma.emplace_back(std::sqrt(covariance(3 * n + 2 * c, 3 * n + 2 * c)),
                                 std::sqrt(covariance(3 * n + 2 * c + 1, 3 * n + 2 * c + 1)));
}

std::vector<BoardObservation> in_order(const std::vector<BoardObservation>& boards,
                                       const std::vector<int>& order) {
  std::vector<BoardObservation> result;
  for (const int i : order) result.push_back(boards[i]);
  return result;
}

/// Outliers found before take no part.
std::vector<BoardObservation> inliers_only(const Observations& in, const JointSolution& solution) {
  std::vector<BoardObservation> boards = in.boards;
  for (std::size_t i = 0; i < boards.size(); ++i) {
    boards[i].weights.resize(boards[i].corners_px.size(), 1);
    for (std::size_t k = 0; k < boards[i].weights.size(); ++k)
      if (!solution.residuals_px[i][k].allFinite()) boards[i].weights[k] = 0;
  }
  return boards;
}

/// Whether all cameras hang together through the sets of `boards`.
bool connected(const std::vector<BoardObservation>& boards, int cameras) {
  std::vector<int> group(cameras);
  std::iota(group.begin(), group.end(), 0);
  for (const BoardObservation& a : boards)
    for (const BoardObservation& b : boards)
      if (a.set == b.set && group[a.camera] != group[b.camera])
        std::replace(group.begin(), group.end(), int(group[a.camera]), int(group[b.camera]));
  return std::all_of(group.begin(), group.end(), [&](int g) { return g == group.front(); });
}

}  // namespace

JointSolution joint_solve(const Observations& in, const Seed& seed, const SolveOptions& options) {
  const std::vector<int> order = solving_order(in.boards);
  Problem problem(in.board, seed_cameras(in, seed, options.lens), seed.ref_from_board, {0, 0},
                  in_order(in.boards, order));
  const auto all = selections(options, true, true);
  bool solved = problem.optimise(selections(options, false, false)) &&
                problem.optimise(selections(options, true, false)) && problem.optimise(all);
  constexpr int kMostRounds = 20;
  Problem::Linearisation l;
  solved = problem.linearise(all, l) && solved;
  for (int round = 0; solved && options.reject_outliers && round < kMostRounds; ++round) {
    if (!reject_outliers(problem, l, order.size() * static_cast<std::size_t>(in.board.corners()))) break;
    solved = problem.optimise(all) && problem.linearise(all, l);
  }
  JointSolution out;
  out.cameras = problem.cameras();
  out.ref_from_board = problem.ref_from_board();
  out.warp_m = problem.warp();
  note_residuals(in, order, problem, l, out);
  Factor factor(l);
  out.converged = solved && factor.good() && out.inliers > 0 && at_minimum(factor, l);
  if (options.covariance && factor.good()) note_covariance(problem, all, factor, l.states, out);
  return out;
}

HeldOutError held_out_error(const Observations& in, const JointSolution& solution, int left_out_set,
                            const SolveOptions& options) {
  std::vector<BoardObservation> rest, held;
  std::vector<int> new_index(solution.cameras.size(), -1);
  for (const BoardObservation& b : inliers_only(in, solution)) {
    if (b.set == left_out_set) held.push_back(b);
    if (b.set != left_out_set) rest.push_back(b), new_index[b.camera] = 0;
  }
  std::vector<Camera> cameras;
  for (std::size_t c = 0; c < new_index.size(); ++c) {
    if (new_index[c] < 0) continue;
    new_index[c] = static_cast<int>(cameras.size());
    cameras.push_back(solution.cameras[c]);
  }
  if (cameras.empty() || held.empty()) return {};
  const Pose ref_from_new = cameras.front().cam_from_rig.inverse();
  for (Camera& c : cameras) c.cam_from_rig = c.cam_from_rig * ref_from_new;
  std::vector<Pose> frames = solution.ref_from_board;
  for (Pose& f : frames) f = ref_from_new.inverse() * f;
  for (BoardObservation& b : rest) b.camera = new_index[b.camera];
  // A camera that saw only this board cannot be predicted.
  std::erase_if(held, [&](const BoardObservation& b) { return new_index[b.camera] < 0; });
  for (BoardObservation& b : held) b.camera = new_index[b.camera];
  if (held.empty() || !connected(rest, static_cast<int>(cameras.size()))) return {};

  Problem problem(in.board, cameras, frames, solution.warp_m, in_order(rest, solving_order(rest)));
  if (!problem.optimise(selections(options, true, true))) return {};
  mrcal_problem_selections_t pose_only = {};
  pose_only.do_optimize_frames = true;
  held = in_order(held, solving_order(held));
  Problem check(in.board, problem.cameras(), frames, problem.warp(), held);
  Problem::Linearisation l;
  if (!check.optimise(pose_only) || !check.linearise(pose_only, l)) return {};
  HeldOutError error;
  for (std::size_t k = 0; k < l.x.size(); ++k) {
    if (check.weight(k / 2) <= 0) continue;
    error.sum_sq_px2 += l.x[k] * l.x[k];
    ++error.count;
  }
  return error;
}

}  // namespace stuv
