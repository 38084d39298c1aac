#pragma once

#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "calib/tracking/keyframes.h"
#include "calib/tracking/measurement.h"
#include "calib/tracking/particle_filter.h"

namespace stuv::tracking {

// Lengths below are given in pixels: the tracker converts them at the object's depth, so a model of 1 mm and
// one of 100 m are tracked alike.
struct TrackerOptions {
  int particles = 100;
  bool adaptive = false;  ///< between a quarter of `particles` and all, as the spread of the states asks for
  int threads = 0;        ///< 0: all
  std::uint64_t seed = 1;
  double autoregression = 0.5;  ///< a of equation 4; 0: random walk
  double noise_px = 4;          ///< standard deviation of the noise, by how far each twist moves the outline
  double spacing_px = 10;       ///< of the sample points
  double search_px = 20;        ///< range of the search along the normal
  double contrast = 2.5;        ///< weakest picture edge [grey levels per px]
  double least_cosine = 0.85;   ///< between the edge's normal and the picture's gradient
  LikelihoodOptions likelihood;
  int refine_iterations = 4;  ///< 0: no IRLS
  bool filter = true;         ///< false: IRLS alone, from the last pose
  bool reweigh = true;        ///< weigh refined particles again instead of equation 11
  bool polish = true;   ///< refine the mean on all edges; false: the mean of the particles is the estimate
  bool texture = true;  ///< use the keyframes' pictures as texture, where there are keyframes and `polish`
  double effective_part = 0.05;  ///< N_thres of equation 13 as part of the particles
  double lost_part = 0.6;        ///< of the samples matched within lost_px: below it the object is lost
  double lost_px = 3;
  double lost_correlation = 0.3;  ///< with the keyframe's texture: below it the object is lost
};

/// Time spent in each stage of one frame, and on all of it [s]. Gradient and texture run side by side.
struct StageSeconds {
  double gradient = 0, keypoints = 0, texture = 0, filter = 0, estimate = 0, total = 0;
};

struct TrackedFrame {
  bool lost = true;          ///< then the pose is the best guess and not to be relied on
  bool has_pose = false;     ///< false: never initialised
  bool initialised = false;  ///< particles came from keypoints in this frame
  Pose cam_from_object;
  /// Of the twist mu in X exp(mu) at cam_from_object, (v [m], w [rad]). Directions that the picture does not
  /// determine have standard deviations of an object's size and of pi.
  Matrix6 covariance = Matrix6::Zero();
  double n_eff = 0;
  int particles = 0;
  MatchSummary edges;  ///< at the estimate, over lost_px
  int texture_points = 0;
  double deviation_px = 0;  ///< robust, of all residuals at the estimate
  double correlation = 0;   ///< with the keyframe's texture; NaN: not known
  double likeness = std::numeric_limits<double>::quiet_NaN();  ///< as correlation, of smoothed brightness
  double fit =
      std::numeric_limits<double>::quiet_NaN();  ///< part of the brightness that taught views explain
  double print = std::numeric_limits<double>::quiet_NaN();  ///< of each face apart; NaN: not known, or plain
  double rivals = 0;  ///< weight of the poses elsewhere that explain the picture nearly as well, 0 .. 1
  StageSeconds seconds;
};

/// Choi and Christensen's particle filter on SE(3) over the frames of one camera that moves past a known
/// object.
///
/// Each frame: particles move (equation 3) or, at the start and when lost, come from keypoints (5, 6);
/// edges are sampled with hidden lines removed and searched for; weights (7, 8); refinement (9, 10); weights
/// again, or kept (11); resampling; mean; then the mean alone is refined on all edges and on the keyframes'
/// texture. The same input and seed give the same output for any number of threads.
class Tracker {
 public:
  Tracker(const ObjectModel& model, const Camera& camera, const std::vector<Keyframe>& keyframes,
          const TrackerOptions& options = {});
  ~Tracker();
  Tracker(const Tracker&) = delete;
  Tracker& operator=(const Tracker&) = delete;

  /// Starts at a known pose instead of from keypoints.
  void start(const Pose& cam_from_object);
  /// Throws Error if the frame's size is not the camera's.
  TrackedFrame track(const Grey& frame);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace stuv::tracking
