#pragma once

#include <fcntl.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <chrono>
#include <memory>

#include "capture/cameras/camera_device.h"
#include "core/error.h"

namespace stuv::test {

inline std::int64_t monotonic_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

/// A camera that delivers the same few frames over and over at an even rate.
struct FakeCameraOptions {
  RawFormat format;
  std::vector<std::vector<std::byte>> frames;
  double fps = 100;
  std::int64_t fails_after = -1;   ///< frames; then take() throws
  std::int64_t silent_after = -1;  ///< frames; then there are no more
};

class FakeCamera final : public CameraDevice {
 public:
  FakeCamera(const CameraSettings& settings, FakeCameraOptions options)
      : name_(settings.name),
        options_(std::move(options)),
        timer_(::timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK)) {}
  ~FakeCamera() override { ::close(timer_); }
  const RawFormat& format() const override { return options_.format; }
  double fps() const override { return options_.fps; }
  Json settings() const override { return {{"format", options_.format.fourcc}}; }
  int poll_fd() const override { return timer_; }
  void start() override {
    itimerspec time{};
    time.it_value.tv_nsec = 1;
    time.it_interval.tv_nsec = static_cast<long>(1e9 / options_.fps);
    ::timerfd_settime(timer_, 0, &time, nullptr);
  }
  std::optional<DeviceFrame> take() override {
    std::uint64_t ticks = 0;
    if (::read(timer_, &ticks, sizeof ticks) != sizeof ticks) return std::nullopt;
    if (options_.silent_after >= 0 && sequence_ >= options_.silent_after) return std::nullopt;
    if (options_.fails_after >= 0 && sequence_ >= options_.fails_after)
      throw Error("camera " + name_, "is gone", "plug it in");
    DeviceFrame frame;
    frame.bytes = options_.frames[static_cast<std::size_t>(sequence_) % options_.frames.size()];
    frame.sequence =
        static_cast<std::uint32_t>(sequence_++);  // a busy machine makes it late, not the numbers
    frame.timestamp_ns = monotonic_ns();
    frame.system_clock = true;
    return frame;
  }

 private:
  std::string name_;
  FakeCameraOptions options_;
  int timer_;
  std::int64_t sequence_ = 0;
};

}  // namespace stuv::test
