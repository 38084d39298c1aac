#pragma once

#include <atomic>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "capture/cameras/camera_device.h"
#include "capture/source.h"
#include "core/progress.h"

namespace stuv {

/// How a moving object's speed becomes pixels of skew: px = speed * skew * focal_px / distance.
struct MotionOptions {
  double speed_m_per_s = 1, distance_m = 2;
  double focal_px = 0;  ///< 0: as many as the picture is wide, a field of view of 53 degrees
};

struct CameraSourceOptions {
  enum class Mode {
    free,          ///< every camera by its own clock
    common_start,  ///< the same, started together, each by a thread of its own
    trigger        ///< a trigger outside; the cameras' controls say that they wait for it
  };
  int rows = 1, cols = 1;
  std::vector<CameraSettings> cameras;
  Mode mode = Mode::free;
  double trigger_window_ms = 0;  ///< 0: half a period
  double duration_s = 0;         ///< 0: until stopped
  /// Sets that wait for the disk; more are dropped, and counted. Their frames stay in the drivers' buffers,
  /// so it is never more than the fewest buffers of a camera but four.
  int queue_sets = 12;
  bool allow_missing = false;  ///< begin although cameras do not start
  double give_up_s = 10;       ///< with all cameras gone for so long
  std::string record = "raw";  ///< or "png", "tif"
  MotionOptions motion;
};

/// "" if the options can be used, else the setting and the constraint it breaks.
std::string problem_of(const CameraSourceOptions& options);

/// What is known of a camera while it streams.
struct CameraStatus {
  std::string name;
  bool live = false;
  double fps = 0;  ///< over the last second
  std::size_t frames = 0, dropped = 0, flawed = 0;
  std::string trouble;  ///< why it is not live
};

/// Called by Source::next with every set that it returns, and how the cameras are.
using StatusFunction = std::function<void(const std::vector<CameraStatus>&, const SourceSet&)>;

/// How a device is opened: open_camera, but for tests.
using OpenFunction = std::function<std::unique_ptr<CameraDevice>(const CameraSettings&)>;

/// Real cameras as a source.
///
/// One thread polls all devices and matches their frames into sets (SetMatcher); the frames stay in the
/// drivers' buffers, so that memory is bounded by their number. next() waits for a set; sets that find the
/// queue full are dropped whole and counted. A camera that fails while streaming is closed, its sets are
/// incomplete, and it is opened again, once a second, by its identity. Throws Error listing every camera that
/// does not start, unless `allow_missing`. next() ends when `stop` is set or the duration is over; throws
/// Error when no camera is left for `give_up_s`.
std::unique_ptr<Source> open_cameras(const CameraSourceOptions& options, const Reporter& reporter = {},
                                     const std::atomic<bool>* stop = nullptr, StatusFunction status = {},
                                     OpenFunction open = open_camera);

}  // namespace stuv
