#include "calib/solve/mrcal_problem.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace stuv {
namespace {

mrcal_point3_t point(double x, double y, double z) {
  mrcal_point3_t p = {};
  p.x = x, p.y = y, p.z = z;
  return p;
}

/// The power of two nearest to the mean distance of boards from the cameras that see them.
double length_unit(const MrcalProblem::Input& in) {
  double sum = 0;
  for (const BoardObservation& b : in.boards)
    sum += (in.cameras[b.camera].cam_from_rig * in.ref_from_board[b.set]).t.norm();
  const double mean = sum / static_cast<double>(std::max<std::size_t>(1, in.boards.size()));
  return std::isfinite(mean) && mean > 0 ? std::exp2(std::round(std::log2(mean))) : 1;
}

/// CHOLMOD's view of the arrays.
void view_of(MrcalProblem::Linearisation& l) {
  l.Jt.nrow = l.states;
  l.Jt.ncol = l.measurements;
  l.Jt.nzmax = l.value.size();
  l.Jt.p = l.column.data();
  l.Jt.i = l.row.data();
  l.Jt.x = l.value.data();
  l.Jt.itype = CHOLMOD_INT;
  l.Jt.xtype = CHOLMOD_REAL;
  l.Jt.dtype = CHOLMOD_DOUBLE;
  l.Jt.sorted = 1;
  l.Jt.packed = 1;
}

}  // namespace

MrcalProblem::MrcalProblem(const Input& input) : in_(input), unit_m_(length_unit(input)) {
  mrcal_lensmodel_from_name(&lens_, in_.cameras.front().lens_model.c_str());
  params_ = mrcal_lensmodel_num_params(&lens_);
  if (lens_.type == MRCAL_LENSMODEL_SPLINED_STEREOGRAPHIC) corner_scale_ = 10;
  in_.camera_weight.resize(in_.cameras.size(), 1);
  add_lenses();
  for (std::size_t c = 1; c < in_.cameras.size(); ++c)
    extrinsics_.push_back(to_mrcal(in_.cameras[c].cam_from_rig));
  // Sets without a board have no pose to solve for.
  frame_of_.assign(in_.ref_from_board.size(), -1);
  for (const BoardObservation& b : in_.boards) frame_of_[b.set] = 0;
  for (std::size_t s = 0; s < frame_of_.size(); ++s) {
    if (frame_of_[s] < 0) continue;
    frame_of_[s] = static_cast<int>(frames_.size());
    frames_.push_back(to_mrcal(in_.ref_from_board[s]));
  }
  warp_.x2 = in_.warp_m.x() / unit_m_;
  warp_.y2 = in_.warp_m.y() / unit_m_;
  add_observations(in_.boards);
}

void MrcalProblem::add_lenses() {
  const int lenses = 1 + *std::max_element(in_.lens_of.begin(), in_.lens_of.end());
  intrinsics_.resize(static_cast<std::size_t>(lenses * params_));
  sizes_.resize(static_cast<std::size_t>(2 * lenses));
  for (std::size_t c = in_.cameras.size(); c-- > 0;) {
    const Camera& camera = in_.cameras[c];
    const int lens = in_.lens_of[c];
    std::copy(camera.intrinsics.begin(), camera.intrinsics.end(), intrinsics_.begin() + lens * params_);
    sizes_[2 * lens] = camera.width;
    sizes_[2 * lens + 1] = camera.height;
  }
}

void MrcalProblem::add_observations(const std::vector<BoardObservation>& boards) {
  for (const BoardObservation& b : boards) {
    observations_.push_back({{in_.lens_of[b.camera], b.camera - 1}, frame_of_[b.set]});
    for (std::size_t i = 0; i < b.corners_px.size(); ++i) {
      const Eigen::Vector2d& q = b.corners_px[i];
      const double weight = (b.weights.empty() ? 1 : b.weights[i]) * in_.camera_weight[b.camera];
      const bool there = q.allFinite() && weight > 0;
      pool_.push_back(there ? point(q.x(), q.y(), corner_scale_ * weight) : point(0, 0, -1));
    }
  }
}

mrcal_pose_t MrcalProblem::to_mrcal(const Pose& pose) const {
  const Eigen::Vector3d r = vector_from_rotation(pose.R), t = pose.t / unit_m_;
  return {point(r.x(), r.y(), r.z()), point(t.x(), t.y(), t.z())};
}

Pose MrcalProblem::from_mrcal(const mrcal_pose_t& p) const {
  return {rotation_from_vector({p.r.x, p.r.y, p.r.z}), unit_m_ * Eigen::Vector3d(p.t.x, p.t.y, p.t.z)};
}

bool MrcalProblem::optimise(mrcal_problem_selections_t what) {
  // Without the prior mrcal would go back to where it did not hold.
  if (has_prior(what) && near_prior_ && approach_prior(what)) return true;
  if (!std::isfinite(mrcal_optimize(nullptr, 0, nullptr, 0, intrinsics_.data(), extrinsics_.data(),
                                    frames_.data(), nullptr, &warp_, n_lenses(), n_cameras() - 1, n_frames(),
                                    0, 0, observations_.data(), nullptr, n_boards(), 0, pool_.data(), &lens_,
                                    sizes_.data(), what, &constants_, in_.board.square_m / unit_m_,
                                    in_.board.columns, in_.board.rows, false, false)
                         .rms_reproj_error__pixels))
    return false;
  const auto finite = [](double v) { return std::isfinite(v); };
  if (!std::all_of(intrinsics_.begin(), intrinsics_.end(), finite)) return false;
  if (!has_prior(what)) return true;
  near_prior_ = approach_prior(what);
  return near_prior_;
}

bool MrcalProblem::has_prior(mrcal_problem_selections_t what) const {
  return !in_.prior.parameter.empty() && what.do_optimize_intrinsics_core &&
         what.do_optimize_intrinsics_distortions;
}

/// One measurement a row of `whiten` and lens.
void MrcalProblem::add_prior(mrcal_problem_selections_t what, Linearisation& l) const {
  const LensPrior& prior = in_.prior;
  const Eigen::VectorXd scale = state_scale(what);
  for (int lens = 0; lens < n_lenses(); ++lens) {
    const int state = mrcal_state_index_intrinsics(lens, n_lenses(), n_cameras() - 1, n_frames(), 0, 0,
                                                   n_boards(), what, &lens_);
    Eigen::VectorXd off = -prior.mean;
    for (Eigen::Index i = 0; i < off.size(); ++i) off[i] += intrinsics_[lens * params_ + prior.parameter[i]];
    const Eigen::VectorXd x = prior.whiten * off;
    for (Eigen::Index m = 0; m < x.size(); ++m) {
      l.x.push_back(x[m]);
      for (Eigen::Index i = 0; i < off.size(); ++i) {
        l.row.push_back(state + prior.parameter[i]);
        l.value.push_back(prior.whiten(m, i) * scale[state + prior.parameter[i]]);
      }
      l.column.push_back(static_cast<int>(l.row.size()));
    }
  }
  l.measurements = static_cast<int>(l.x.size());
}

double MrcalProblem::Linearisation::cost() const {
  return Eigen::Map<const Eigen::VectorXd>(x.data(), static_cast<Eigen::Index>(x.size())).squaredNorm();
}

Eigen::VectorXd MrcalProblem::Linearisation::gradient() const {
  Eigen::VectorXd g = Eigen::VectorXd::Zero(states);
  for (int m = 0; m < measurements; ++m)
    for (int k = column[m]; k < column[m + 1]; ++k) g[row[k]] += value[k] * x[m];
  return g;
}

/// Gauss-Newton, halved while the cost rises. Lenses are nearly linear in their distortions.
bool MrcalProblem::approach_prior(mrcal_problem_selections_t what) {
  constexpr int kMostSteps = 30, kMostHalvings = 10;
  constexpr double kWorth = 1e-8;  // of the cost: a hundredth of a sigma, of 1e4 corners
  Linearisation l;
  if (!linearise(what, l)) return false;
  for (int i = 0; i < kMostSteps; ++i) {
    NormalFactor factor(l);
    if (!factor.good()) return false;
    const Eigen::VectorXd gradient = l.gradient();
    Eigen::VectorXd delta = -factor.solve(gradient).col(0);
    const double cost = l.cost(), decrease = -gradient.dot(delta);
    if (!std::isfinite(decrease)) return false;
    if (decrease <= kWorth * cost) break;
    const MrcalProblem before = *this;
    int halvings = 0;
    for (; halvings < kMostHalvings; ++halvings, delta *= 0.5) {
      step(what, delta);
      if (!linearise(what, l)) return false;
      if (l.cost() < cost) break;
      *this = before;
    }
    if (halvings == kMostHalvings) break;
  }
  return true;
}

void MrcalProblem::step(mrcal_problem_selections_t what, Eigen::VectorXd packed) {
  mrcal_unpack_solver_state_vector(packed.data(), n_lenses(), n_cameras() - 1, n_frames(), 0, 0, what,
                                   &lens_);
  const auto move = [&](mrcal_pose_t& pose, int state) {
    if (state < 0) return;
    for (int i = 0; i < 3; ++i) {
      pose.r.xyz[i] += packed[state + i];
      pose.t.xyz[i] += packed[state + 3 + i];
    }
  };
  for (int lens = 0; lens < n_lenses(); ++lens) {
    const int state = mrcal_state_index_intrinsics(lens, n_lenses(), n_cameras() - 1, n_frames(), 0, 0,
                                                   n_boards(), what, &lens_);
    for (int i = 0; i < params_; ++i) intrinsics_[lens * params_ + i] += packed[state + i];
  }
  for (int c = 1; c < n_cameras(); ++c) move(extrinsics_[c - 1], pose_state(what, c));
  for (std::size_t s = 0; s < frame_of_.size(); ++s)
    if (frame_of_[s] >= 0) move(frames_[frame_of_[s]], frame_state(what, static_cast<int>(s)));
  if (what.do_optimize_calobject_warp && n_boards() > 0) {
    warp_.x2 += packed[packed.size() - 2];
    warp_.y2 += packed[packed.size() - 1];
  }
}

bool MrcalProblem::linearise(mrcal_problem_selections_t what, Linearisation& l) const {
  l.states = mrcal_num_states(n_lenses(), n_cameras() - 1, n_frames(), 0, 0, n_boards(), what, &lens_);
  l.measurements = mrcal_num_measurements(n_boards(), 0, in_.board.columns, in_.board.rows, n_lenses(),
                                          n_cameras() - 1, n_frames(), 0, 0, what, &lens_);
  const int nonzero =
      _mrcal_num_j_nonzero(n_boards(), 0, in_.board.columns, in_.board.rows, n_lenses(), n_cameras() - 1,
                           n_frames(), 0, 0, observations_.data(), nullptr, what, &lens_);
  l.x.assign(l.measurements, 0);
  l.column.assign(l.measurements + 1, 0);
  l.row.assign(nonzero, 0);
  l.value.assign(nonzero, 0);
  view_of(l);
  std::vector<double> state(l.states);
  const bool known = mrcal_optimizer_callback(
      state.data(), l.states * static_cast<int>(sizeof(double)), l.x.data(),
      l.measurements * static_cast<int>(sizeof(double)), &l.Jt, intrinsics_.data(), extrinsics_.data(),
      frames_.data(), nullptr, &warp_, n_lenses(), n_cameras() - 1, n_frames(), 0, 0, observations_.data(),
      nullptr, n_boards(), 0, pool_.data(), &lens_, sizes_.data(), what, &constants_,
      in_.board.square_m / unit_m_, in_.board.columns, in_.board.rows, false);
  for (double& x : l.x) x /= corner_scale_;
  for (double& v : l.value) v /= corner_scale_;
  if (has_prior(what)) add_prior(what, l);
  view_of(l);
  return known;
}

Eigen::VectorXd MrcalProblem::state_scale(mrcal_problem_selections_t what) const {
  const int states =
      mrcal_num_states(n_lenses(), n_cameras() - 1, n_frames(), 0, 0, n_boards(), what, &lens_);
  Eigen::VectorXd scale = Eigen::VectorXd::Ones(states);
  mrcal_unpack_solver_state_vector(scale.data(), n_lenses(), n_cameras() - 1, n_frames(), 0, 0, what, &lens_);
  for (int c = 1; c < n_cameras(); ++c)
    if (const int i = pose_state(what, c); i >= 0) scale.segment<3>(i + 3) *= unit_m_;
  for (std::size_t s = 0; s < frame_of_.size(); ++s)
    if (const int i = frame_state(what, static_cast<int>(s)); i >= 0) scale.segment<3>(i + 3) *= unit_m_;
  if (what.do_optimize_calobject_warp && n_boards() > 0) scale.tail<2>() *= unit_m_;
  return scale;
}

int MrcalProblem::lens_state(mrcal_problem_selections_t what, int camera) const {
  return mrcal_state_index_intrinsics(in_.lens_of[camera], n_lenses(), n_cameras() - 1, n_frames(), 0, 0,
                                      n_boards(), what, &lens_);
}

int MrcalProblem::pose_state(mrcal_problem_selections_t what, int camera) const {
  if (camera == 0) return -1;
  return mrcal_state_index_extrinsics(camera - 1, n_lenses(), n_cameras() - 1, n_frames(), 0, 0, n_boards(),
                                      what, &lens_);
}

int MrcalProblem::frame_state(mrcal_problem_selections_t what, int set) const {
  if (frame_of_[set] < 0) return -1;
  return mrcal_state_index_frames(frame_of_[set], n_lenses(), n_cameras() - 1, n_frames(), 0, 0, n_boards(),
                                  what, &lens_);
}

std::vector<Camera> MrcalProblem::cameras() const {
  std::vector<Camera> result = in_.cameras;
  for (int c = 0; c < n_cameras(); ++c) {
    const auto begin = intrinsics_.begin() + in_.lens_of[c] * params_;
    result[c].intrinsics.assign(begin, begin + params_);
    result[c].cam_from_rig = c == 0 ? Pose{} : from_mrcal(extrinsics_[c - 1]);
  }
  return result;
}

std::vector<Pose> MrcalProblem::ref_from_board() const {
  std::vector<Pose> result = in_.ref_from_board;
  for (std::size_t s = 0; s < result.size(); ++s)
    if (frame_of_[s] >= 0) result[s] = from_mrcal(frames_[frame_of_[s]]);
  return result;
}

int MrcalProblem::camera_of(std::size_t corner) const {
  return observations_[corner / static_cast<std::size_t>(per_board())].icam.extrinsics + 1;
}

void MrcalProblem::scale_weights(int camera, double factor) {
  in_.camera_weight[camera] *= factor;
  for (std::size_t i = 0; i < pool_.size(); ++i)
    if (pool_[i].z > 0 && camera_of(i) == camera) pool_[i].z *= factor;
}

NormalFactor::NormalFactor(MrcalProblem::Linearisation& l) : states_(l.states) {
  cholmod_start(&common_);
  common_.print = 0;
  factor_ = cholmod_analyze(&l.Jt, &common_);
  double beta[2] = {1e-9, 0};
  if (factor_ != nullptr) cholmod_factorize_p(&l.Jt, beta, nullptr, 0, factor_, &common_);
  good_ = factor_ != nullptr && common_.status == CHOLMOD_OK;
}

NormalFactor::~NormalFactor() {
  cholmod_free_factor(&factor_, &common_);
  cholmod_finish(&common_);
}

Eigen::MatrixXd NormalFactor::solve(const Eigen::MatrixXd& B) {
  cholmod_dense b = {};
  b.nrow = b.d = states_;
  b.ncol = B.cols();
  b.nzmax = B.size();
  b.x = const_cast<double*>(B.data());  // cholmod_solve reads it only
  b.xtype = CHOLMOD_REAL;
  b.dtype = CHOLMOD_DOUBLE;
  cholmod_dense* x = cholmod_solve(CHOLMOD_A, factor_, &b, &common_);
  if (x == nullptr)
    return Eigen::MatrixXd::Constant(B.rows(), B.cols(), std::numeric_limits<double>::quiet_NaN());
  Eigen::MatrixXd result = Eigen::Map<Eigen::MatrixXd>(static_cast<double*>(x->x), B.rows(), B.cols());
  cholmod_free_dense(&x, &common_);
  return result;
}

}  // namespace stuv
