#include "calib/tracking/tracker.h"

#include <fmt/format.h>

#include <tbb/parallel_invoke.h>

#include "calib/tracking/tracker_state.h"
#include "core/error.h"

namespace stuv::tracking {
namespace {

/// A frame's keypoints are drawn from again where the pose that comes out is no good.
constexpr int kStarts = 3;

std::vector<Keyframe> normalised_keyframes(std::vector<Keyframe> taught, const Normalisation& norm) {
  for (Keyframe& k : taught) {
    k.cam_from_object = norm.into(k.cam_from_object);
    for (Eigen::Vector3d& x : k.points) x = norm.point(x);
  }
  return taught;
}

}  // namespace

Tracker::State::State(const ObjectModel& object, const Camera& camera,
                      const std::vector<Keyframe>& taught_frames, const TrackerOptions& o)
    : options(o),
      norm{object.centre(), object.radius()},
      model(normalised(object, norm)),
      lens(camera),
      keyframes(normalised_keyframes(taught_frames, norm)),
      matcher(keyframes),
      arena(o.threads > 0 ? o.threads : tbb::task_arena::automatic),
      taught(model, lens) {
  options.texture = options.texture && options.polish;
  if (options.texture) taught.teach(keyframes);
}

TrackedFrame Tracker::State::track(const Grey& frame) {
  TrackedFrame out;
  ++frame_number;
  random.seed(options.seed * 7919 + frame_number);
  // The two need nothing of each other.
  tbb::parallel_invoke(
      [&] {
        const StageClock clock(out.seconds.gradient);
        gradient_of(frame, 1.0, options.contrast, gradient);
      },
      [&] {
        const StageClock clock(out.seconds.texture);
        if (!taught.empty()) taught.look_at(frame);
        follow_motion(frame);
      });
  for (int start = 0; start < kStarts; ++start) {
    // The last try is by looks, should keypoints mislead.
    if (options.filter ? !predict(frame, start + 1 == kStarts, out) : !predict_alone(frame, out)) return out;
    estimate_pose(frame, out);
    if (!lost || !out.initialised) break;
  }
  if (options.filter && !out.initialised && !lost && is_doubtful(out)) out = second_opinion(frame, out);
  if (!lost)
    usual_deviation = usual_deviation > 0 ? 0.9 * usual_deviation + 0.1 * out.deviation_px : out.deviation_px;
  out.lost = lost || !is_certain(out);
  if (!out.lost) good_particles = particles, good_estimate = estimate;
  frames_lost = out.lost ? frames_lost + 1 : 0;
  return out;
}

/// The frame again, from its keypoints; the answer with the smaller residuals stands.
TrackedFrame Tracker::State::second_opinion(const Grey& frame, const TrackedFrame& first) {
  const std::vector<Particle> first_particles = particles;
  const Pose first_estimate = estimate;
  const Twist first_drift = drift;
  TrackedFrame second;
  second.seconds = first.seconds;
  std::vector<Particle> fresh;
  bool found = false;
  texture_points.clear();
  {
    const StageClock clock(second.seconds.keypoints);
    found = particles_from_keypoints(frame, options.particles, fresh);
  }
  if (found) {
    restart(std::move(fresh));
    second.initialised = true;
    estimate_pose(frame, second);
    if (!lost && second.deviation_px < 0.7 * first.deviation_px) return second;
  }
  particles = first_particles;
  estimate = first_estimate;
  drift = first_drift;
  lost = false;
  TrackedFrame kept = first;
  kept.seconds = second.seconds;
  return kept;
}

Tracker::Tracker(const ObjectModel& model, const Camera& camera, const std::vector<Keyframe>& keyframes,
                 const TrackerOptions& options)
    : state_(std::make_unique<State>(model, camera, keyframes, options)) {}

Tracker::~Tracker() = default;

void Tracker::start(const Pose& cam_from_object) {
  Particle p;
  p.pose = state_->norm.into(cam_from_object);
  state_->restart(std::vector<Particle>(static_cast<std::size_t>(state_->options.particles), p));
  state_->estimate = p.pose;
  state_->known = true;
  state_->lost = false;
  state_->frames_seen = kConfirmations;
}

TrackedFrame Tracker::track(const Grey& frame) {
  if (frame.width != state_->lens.width() || frame.height != state_->lens.height())
    throw Error(state_->lens.camera().name,
                fmt::format("is a camera of {}x{}, the frame is {}x{}", state_->lens.width(),
                            state_->lens.height(), frame.width, frame.height),
                "give the camera that took the frames, at their size");
  TrackedFrame out;
  double seconds = 0;
  {
    const StageClock clock(seconds);
    state_->arena.execute([&] { out = state_->track(frame); });
  }
  out.seconds.total = seconds;
  return out;
}

}  // namespace stuv::tracking
