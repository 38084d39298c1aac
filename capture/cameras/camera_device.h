#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/json.h"
#include "core/raw_frame.h"

namespace stuv {

/// What one camera shall deliver. Whatever the device makes of it is read back: see CameraDevice::settings.
struct CameraSettings {
  /// What stays the same when it is plugged in again: "serial:...", "path:...", "bus:...", "libcamera:...",
  /// or a device's file.
  std::string id;
  std::string name;  ///< of the camera in the recording
  int row = 0, col = 0;
  std::string format;  ///< V4L2's four characters; empty: the first of the device's that can be decoded
  int width = 0, height = 0;  ///< 0: as the device stands
  double fps = 0;             ///< 0: as the device stands
  /// Names of the driver's controls, or exposure, gain, white_balance, focus, which switch the automatic off
  /// first.
  std::map<std::string, std::int64_t> controls;
  int buffers = 16;  ///< of the driver: frames that wait for their set or for the disk lie there
};

/// A frame in the driver's memory. The driver gets the buffer back when the last copy of `hold` is gone.
struct DeviceFrame {
  std::span<const std::byte> bytes;
  std::shared_ptr<const void> hold;
  std::uint32_t sequence = 0;     ///< as the driver counts: wraps
  std::int64_t timestamp_ns = 0;  ///< as the driver says
  bool system_clock = false;      ///< whether the timestamp is said to be CLOCK_MONOTONIC
  std::string flaw;               ///< not empty: delivered, but not to be used
};

/// One camera that is open and configured. take() and start() belong to one thread; `hold` may be let go on
/// any.
class CameraDevice {
 public:
  virtual ~CameraDevice() = default;

  /// Format of the frames; MJPG for JPEG pictures.
  virtual const RawFormat& format() const = 0;
  virtual double fps() const = 0;  ///< as read back; 0: the device does not say
  /// What was set and what the device made of it: format, size, rate, controls.
  virtual Json settings() const = 0;

  virtual void start() = 0;
  /// Becomes readable when take() has something to say.
  virtual int poll_fd() const = 0;
  /// The next frame; none: not yet. Throws Error, in words, when the device fails or is gone.
  virtual std::optional<DeviceFrame> take() = 0;
};

/// Finds the camera of that identity, opens and configures it. Throws Error naming camera, cause and next
/// step.
std::unique_ptr<CameraDevice> open_camera(const CameraSettings& settings);

/// A size with its rates, a format with its sizes, as a device lists them.
struct CameraMode {
  std::string fourcc;
  int width = 0, height = 0;
  std::vector<double> fps;  ///< falling
};

struct CameraInfo {
  std::string id;                  ///< for CameraSettings::id
  std::string device;              ///< the file or libcamera's name today
  std::string model, driver, bus;  ///< as the driver says
  std::string serial, path;        ///< "" where there is none
  std::string sysfs;               ///< folder of the device in sysfs; "" for libcamera
  std::vector<CameraMode> modes;
};

}  // namespace stuv
