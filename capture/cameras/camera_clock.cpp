#include "capture/cameras/camera_clock.h"

#include <algorithm>

namespace stuv {
namespace {
// Either way: some drivers stamp a frame with the time at which its last row will have been sent.
constexpr std::int64_t kPlausible_ns = 1'000'000'000;
}  // namespace

std::int64_t CameraClock::count(std::uint32_t sequence) {
  if (!last_) {
    last_ = sequence;
    sequence_ = sequence_ < 0 ? std::int64_t{sequence} : sequence_ + 1;
    return 0;
  }
  const std::uint32_t step = sequence - *last_;  // modulo 2^32
  if (step == 0 || step > UINT32_MAX / 2) return -1;
  last_ = sequence;
  sequence_ += step;
  return std::int64_t{step} - 1;
}

std::int64_t CameraClock::system_time_ns(std::int64_t timestamp_ns, std::int64_t arrival_ns) {
  // Unsigned, as clocks may run over 2^63.
  const auto offset = static_cast<std::int64_t>(static_cast<std::uint64_t>(arrival_ns) -
                                                static_cast<std::uint64_t>(timestamp_ns));
  if (offset > -kPlausible_ns && offset < kPlausible_ns) {
    offset_ns_ = 0;
    return timestamp_ns;
  }
  const bool jumped =
      offset_ns_ == 0 || offset > offset_ns_ + kPlausible_ns || offset < offset_ns_ - kPlausible_ns;
  offset_ns_ = jumped ? offset : std::min(offset, offset_ns_);
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(timestamp_ns) +
                                   static_cast<std::uint64_t>(offset_ns_));
}

}  // namespace stuv
