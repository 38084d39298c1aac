#pragma once

#include <Eigen/Dense>
#include <string>
#include <vector>

extern "C" {
#include <mrcal/mrcal.h>
}
#include <suitesparse/cholmod.h>

#include "calib/solve/lens_prior.h"
#include "calib/solve/observations.h"
#include "core/camera.h"
#include "core/pose.h"

namespace stuv {

/// One problem as mrcal's functions take it: arrays of lenses, camera poses, board poses, board's bend and
/// corners. The first camera is the reference.
///
/// mrcal scales its states for lengths about a metre. So lengths are handed to it in units of `unit_m`, a
/// power of two near the boards' mean distance: a rig of 1e-3 or 1e3 times the size is the same problem, bit
/// by bit where the factor is a power of two.
///
/// mrcal pulls splines towards a stereographic lens. On equidistant fisheyes of 180 degrees that moves
/// cameras by eight sigma, so corners of splined problems weigh ten times as much in there, which leaves a
/// hundredth of the pull: enough to hold knots that nothing was seen of.
class MrcalProblem {
 public:
  struct Input {
    Board board;
    std::vector<Camera> cameras;       ///< where to start from; cam_from_rig is from the reference
    std::vector<int> lens_of;          ///< of each camera: cameras of one number share their lens
    std::vector<Pose> ref_from_board;  ///< of each set
    Eigen::Vector2d warp_m = {0, 0};
    std::vector<BoardObservation> boards;  ///< in the order of their sets
    std::vector<double> camera_weight;     ///< on top of the corners' own; empty: 1
    LensPrior prior;                       ///< takes part where all of a lens is solved for
  };
  explicit MrcalProblem(const Input& input);

  /// Whether it was solved without losing finiteness: by mrcal, and from there by Gauss-Newton steps if there
  /// is a prior, which mrcal has no place for.
  bool optimise(mrcal_problem_selections_t what);

  struct Linearisation {
    int states = 0, measurements = 0;
    std::vector<double> x;         ///< the boards' measurements first, then regularisation, then the prior
    std::vector<int> column, row;  ///< J^T by columns: one a measurement
    std::vector<double> value;
    cholmod_sparse Jt = {};

    double cost() const;               ///< x^T x
    Eigen::VectorXd gradient() const;  ///< J^T x: half the cost's
  };
  /// Residuals and Jacobian (of the packed state) at the present values.
  bool linearise(mrcal_problem_selections_t what, Linearisation& l) const;

  /// Of each packed state, what one of it is in metres, radians, pixels.
  Eigen::VectorXd state_scale(mrcal_problem_selections_t what) const;
  /// First state of a camera's lens, a camera's pose (rotation vector, translation), a set's board pose;
  /// below 0 if it is none.
  int lens_state(mrcal_problem_selections_t what, int camera) const;
  int pose_state(mrcal_problem_selections_t what, int camera) const;
  int frame_state(mrcal_problem_selections_t what, int set) const;

  std::vector<Camera> cameras() const;
  std::vector<Pose> ref_from_board() const;
  Eigen::Vector2d warp_m() const { return unit_m_ * Eigen::Vector2d(warp_.x2, warp_.y2); }

  std::size_t corners() const { return pool_.size(); }
  double weight(std::size_t corner) const { return pool_[corner].z / corner_scale_; }
  void reject(std::size_t corner) { pool_[corner].z = -1; }
  int camera_of(std::size_t corner) const;
  double camera_weight(int camera) const { return in_.camera_weight[camera]; }
  void scale_weights(int camera, double factor);

 private:
  void add_lenses();
  bool has_prior(mrcal_problem_selections_t what) const;
  void add_prior(mrcal_problem_selections_t what, Linearisation& l) const;
  bool approach_prior(mrcal_problem_selections_t what);
  void step(mrcal_problem_selections_t what, Eigen::VectorXd packed);
  void add_observations(const std::vector<BoardObservation>& boards);
  mrcal_pose_t to_mrcal(const Pose& pose) const;
  Pose from_mrcal(const mrcal_pose_t& pose) const;
  int n_lenses() const { return static_cast<int>(sizes_.size() / 2); }
  int n_cameras() const { return static_cast<int>(in_.cameras.size()); }
  int n_frames() const { return static_cast<int>(frames_.size()); }
  int n_boards() const { return static_cast<int>(observations_.size()); }
  int per_board() const { return in_.board.columns * in_.board.rows; }

  Input in_;
  double unit_m_ = 1;
  bool near_prior_ = false;  ///< a solution with the prior was found from about here
  double corner_scale_ = 1;  ///< of corners' weights against regularisation, taken out again by linearise
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

/// A CHOLMOD session with its factor of J^T J (+ a hair, so that free directions get a finite variance).
class NormalFactor {
 public:
  explicit NormalFactor(MrcalProblem::Linearisation& l);
  ~NormalFactor();
  NormalFactor(const NormalFactor&) = delete;
  NormalFactor& operator=(const NormalFactor&) = delete;

  bool good() const { return good_; }
  /// (J^T J)^-1 B; B: states x n.
  Eigen::MatrixXd solve(const Eigen::MatrixXd& B);

 private:
  cholmod_common common_ = {};
  cholmod_factor* factor_ = nullptr;
  std::size_t states_ = 0;
  bool good_ = false;
};

}  // namespace stuv
