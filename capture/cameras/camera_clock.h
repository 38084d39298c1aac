#pragma once

#include <cstdint>
#include <optional>

namespace stuv {

/// Makes a driver's counters continuous: sequence numbers of 32 bit that wrap, and timestamps on the system's
/// clock.
///
/// A timestamp stays as it is while it lies within a second of the frame's arrival: it is the system's
/// clock. A camera with a clock of its own gets the offset of its least delayed frame so far; a jump of that
/// clock by over a second starts anew. So cameras of both kinds can be matched by time.
class CameraClock {
 public:
  /// Frames that the driver counted but never delivered before this one; -1 if it counts no further than
  /// before (the same number twice, or one of the past).
  std::int64_t count(std::uint32_t sequence);
  /// Continued over 32 bit.
  std::int64_t sequence() const { return sequence_; }

  /// The frame's time on the system's clock, whose time is `arrival_ns` now.
  std::int64_t system_time_ns(std::int64_t timestamp_ns, std::int64_t arrival_ns);
  /// System's clock minus the camera's; 0: they are the same.
  std::int64_t offset_ns() const { return offset_ns_; }

  /// The driver starts counting anew.
  void restart() { last_.reset(); }

 private:
  std::optional<std::uint32_t> last_;
  std::int64_t sequence_ = -1, offset_ns_ = 0;
};

}  // namespace stuv
