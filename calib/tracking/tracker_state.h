#pragma once

#include <chrono>
#include <optional>
#include <random>

#include <tbb/task_arena.h>

#include "calib/tracking/object_units.h"
#include "calib/tracking/taught_views.h"
#include "calib/tracking/tracker.h"

// The tracker's own: its state, and the steps that the files tracker*.cpp share.
namespace stuv::tracking {

/// Frames that an object without print must be seen for after a start to be believed.
inline constexpr int kConfirmations = 3;
/// Print that is this like the taught one is the object; this unlike, it is not.
inline constexpr double kSamePrint = 0.9, kOtherPrint = 0.3;
/// Frames after a loss during which the old states are kept among the particles.
inline constexpr int kKeptFrames = 15;

/// A refinement that makes the object this much less like its view is not taken.
inline constexpr double kWorse = 0.04;

/// Adds the time until it ends.
class StageClock {
 public:
  explicit StageClock(double& seconds) : seconds_(seconds), begin_(std::chrono::steady_clock::now()) {}
  ~StageClock() {
    seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count();
  }
  StageClock(const StageClock&) = delete;
  StageClock& operator=(const StageClock&) = delete;

 private:
  double& seconds_;
  std::chrono::steady_clock::time_point begin_;
};

struct Measured {
  std::vector<EdgeSample> samples;
  double log_weight = 0, looks = 0;
  Pose refined;
};

struct Tracker::State {
  State(const ObjectModel& object, const Camera& camera, const std::vector<Keyframe>& taught_frames,
        const TrackerOptions& o);

  // tracker.cpp: one frame
  TrackedFrame track(const Grey& frame);
  TrackedFrame second_opinion(const Grey& frame, const TrackedFrame& first);

  // tracker_start.cpp: where particles come from when there are none
  bool particles_from_keypoints(const Grey& frame, int count, std::vector<Particle>& out);
  void follow_keypoints(const std::vector<Hypothesis>& drawn);
  bool particles_from_views(const Grey& frame, int count, std::vector<Particle>& out);
  bool predict(const Grey& frame, bool by_views, TrackedFrame& out);
  std::vector<Particle> starting_particles(const std::vector<Particle>& fresh);
  std::vector<Particle> scattered_particles();
  void restart(std::vector<Particle> fresh);
  bool predict_alone(const Grey& frame, TrackedFrame& out);

  // tracker_filter.cpp: one step of the filter
  double gaussian();
  Twist noise_at(const Pose& pose, double noise_px);
  void move_particles();
  void follow_motion(const Grey& frame);
  void propose_by_looks();
  std::vector<Particle> particles_around(const std::vector<Place>& places, int count);
  std::vector<EdgeSample> edges_at(const Pose& pose, double spacing_px, double range) const;
  void measure(const Pose& pose, double range, double pixels, Measured& out) const;
  double texture_likelihood(const Pose& pose) const;
  void refine_one(const Pose& pose, Measured& m) const;
  void weigh_particles();
  bool is_same_mode(const Pose& a, const Pose& b) const;
  Pose mean_pose(const std::vector<double>& weights) const;
  double rival_weight() const;
  int wanted_particles(const std::vector<double>& weights) const;
  bool is_sure(const std::vector<double>& weights) const;
  void run_filter(const Grey& frame, TrackedFrame& out);

  // tracker_estimate.cpp: the pose and its covariance out of the particles
  PosePrior prior_by_looks(const Pose& pose, const MatchSummary& edges) const;
  Refined polish(const Grey& frame, Pose pose, TrackedFrame& out) const;
  void describe(const Grey& frame, const Pose& pose, TrackedFrame& out) const;
  Matrix6 covariance_of(const Refined& r) const;
  void estimate_pose(const Grey& frame, TrackedFrame& out);

  // tracker_verdict.cpp: whether the pose is to be believed
  bool has_taught_size(const Pose& pose) const;
  bool is_near_last() const;
  bool has_enough_edges(const TrackedFrame& f, bool must_compare, double alike) const;
  bool is_lost(const TrackedFrame& f) const;
  bool determines(const Matrix6& covariance) const;
  bool is_certain(const TrackedFrame& f);
  bool is_doubtful(const TrackedFrame& f) const;

  TrackerOptions options;
  Normalisation norm;
  ObjectModel model;
  Lens lens;
  std::vector<Keyframe> keyframes;
  KeypointMatcher matcher;
  tbb::task_arena arena;
  TaughtViews taught;

  GradientPicture gradient;  ///< of this frame
  std::mt19937_64 random;
  std::vector<Particle> particles;
  std::vector<Particle> good_particles;  ///< when the object was last seen
  std::vector<Pose> before;
  std::vector<KeypointMatch> matches;      ///< keypoints of frame number `matches_frame`
  std::vector<PointMatch> texture_points;  ///< of this frame, where the motion so far led
  std::optional<Pose> texture_found;       ///< and the pose that they tell
  std::uint64_t matches_frame = 0;
  Pose estimate, estimate_now, good_estimate;
  Twist drift = Twist::Zero();
  bool known = false, lost = false;
  double usual_deviation = 0;            ///< running mean of deviation_px; 0: none yet
  bool is_determined = false;            ///< the estimate, by its own covariance
  int frames_lost = 0, frames_seen = 0;  ///< since it was last believed; since it started
  std::uint64_t frame_number = 0;
};

}  // namespace stuv::tracking
