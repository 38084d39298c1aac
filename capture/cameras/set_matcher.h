#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <vector>

#include "capture/cameras/camera_device.h"

namespace stuv {

struct TimedFrame {
  DeviceFrame frame;
  std::int64_t sequence = -1;
  std::int64_t time_ns = 0;  ///< on the clock of all cameras
  std::int64_t beat_ns = 0;  ///< the matcher's: time_ns without the jitter of a busy machine
};

/// One frame, or none, of each camera.
struct MatchedSet {
  std::vector<std::optional<TimedFrame>> frames;
};

struct MatcherOptions {
  std::int64_t period_ns = 33'333'333;  ///< nominal; the real one is measured
  /// > 0: cameras are triggered from outside, at times that need not be even: the frames within so long after
  /// the first make a set. 0: cameras run by their own clocks.
  std::int64_t trigger_window_ns = 0;
  std::int64_t patience_ns = 200'000'000;  ///< how long to wait for a frame after its set's end
};

/// Sorts frames into sets by time.
///
/// Cameras that run freely deliver one frame per period T each, at phases that differ and drift. Time is cut
/// into sets in the middle of the largest gap between the phases, on the circle of length T: that makes the
/// sets' skew as small as it can be, and leaves the most room for jitter. T is the median of the cameras'
/// measured intervals. Phases are those of each camera's beat, which its sequence numbers keep and its stamps
/// correct by an eighth: a stamp may be late where a machine is busy, the camera is not. The cut follows its
/// gap while that stays at least a quarter of the largest one, and then moves to the largest. A set is
/// finished when every live camera has a frame in it or after it, or after options.patience_ns. Of two frames
/// of a camera in one set the one nearer to the set's middle is taken.
class SetMatcher {
 public:
  SetMatcher(std::size_t cameras, const MatcherOptions& options);

  void add(std::size_t camera, TimedFrame frame);
  /// Sets no longer wait for a camera that is not live.
  void set_live(std::size_t camera, bool live);
  /// The next finished set, oldest first. `flush`: without waiting for more.
  std::optional<MatchedSet> take(std::int64_t now_ns, bool flush = false);

  /// Frames of a camera that came before the first set, and those for which a set had no place.
  std::size_t early(std::size_t camera) const { return cameras_[camera].early; }
  std::size_t unmatched(std::size_t camera) const { return cameras_[camera].unmatched; }
  std::int64_t period_ns() const;

 private:
  struct Camera {
    std::deque<TimedFrame> pending;
    std::optional<std::int64_t> last_ns;  ///< stamp of the last frame; its beat and number:
    std::int64_t last_beat_ns = 0, last_sequence = 0;
    double interval_ns = 0;  ///< followed; 0: nothing came yet
    bool live = true;
    std::size_t early = 0, unmatched = 0;
  };

  /// The frame's beat; the camera's interval learns from it.
  std::int64_t follow(Camera& camera, const TimedFrame& frame) const;
  bool begin(std::int64_t now_ns, bool flush);
  bool finished(std::int64_t end_ns, std::int64_t now_ns) const;
  std::int64_t end_of_set() const;
  std::int64_t next_cut(std::int64_t end_ns) const;
  std::optional<TimedFrame> pick(Camera& camera, std::int64_t begin_ns, std::int64_t end_ns);

  MatcherOptions options_;
  std::vector<Camera> cameras_;
  std::optional<std::int64_t> cut_ns_;  ///< begin of the set that is being filled
};

}  // namespace stuv
