#include "capture/v4l2/v4l2_camera.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <sys/mman.h>

#include <atomic>
#include <cerrno>
#include <cmath>

#include "capture/cameras/explain.h"
#include "capture/v4l2/v4l2_controls.h"

namespace stuv {
namespace {

constexpr int kCapture = V4L2_BUF_TYPE_VIDEO_CAPTURE;

/// The open device and its mapped buffers: lives as long as anybody holds a frame.
struct Buffers {
  explicit Buffers(const std::string& device) : file(device) {}
  ~Buffers() {
    for (const std::span<std::byte>& map : maps) ::munmap(map.data(), map.size());
  }
  Buffers(const Buffers&) = delete;
  Buffers& operator=(const Buffers&) = delete;

  /// Gives a buffer to the driver. Returns 0 or errno.
  int queue(std::uint32_t index) const {
    v4l2_buffer buffer{};
    buffer.type = kCapture;
    buffer.memory = V4L2_MEMORY_MMAP;
    buffer.index = index;
    return file.control(VIDIOC_QBUF, &buffer);
  }

  V4l2File file;
  std::vector<std::span<std::byte>> maps;
  std::atomic<bool> streaming{false};
};

/// A frame that is held: gives the buffer back at the end.
struct Held {
  std::shared_ptr<Buffers> buffers;
  std::uint32_t index;
  ~Held() {
    // An error here shows as the device's own at the next take().
    if (buffers->streaming) buffers->queue(index);
  }
};

YuvMatrix matrix_of(const v4l2_pix_format& pix) {
  const auto usual = static_cast<std::uint32_t>(V4L2_MAP_YCBCR_ENC_DEFAULT(pix.colorspace));
  const std::uint32_t encoding = pix.ycbcr_enc != V4L2_YCBCR_ENC_DEFAULT ? pix.ycbcr_enc : usual;
  if (encoding == V4L2_YCBCR_ENC_709 || encoding == V4L2_YCBCR_ENC_XV709) return YuvMatrix::bt709;
  return encoding == V4L2_YCBCR_ENC_BT2020 ? YuvMatrix::bt2020 : YuvMatrix::bt601;
}

bool is_full_range(const v4l2_pix_format& pix, bool rgb) {
  const auto usual =
      static_cast<std::uint32_t>(V4L2_MAP_QUANTIZATION_DEFAULT(rgb, pix.colorspace, pix.ycbcr_enc));
  const std::uint32_t range = pix.quantization != V4L2_QUANTIZATION_DEFAULT ? pix.quantization : usual;
  return range == V4L2_QUANTIZATION_FULL_RANGE;
}

class V4l2Camera final : public CameraDevice {
 public:
  V4l2Camera(const CameraSettings& settings, const std::string& device)
      : name_(settings.name), device_(device), buffers_(std::make_shared<Buffers>(device)) {
    if (buffers_->file.fd() < 0) fail("open it", errno);
    set_format(settings);
    set_rate(settings);
    settings_["controls"] = Json::array();
    for (const ControlState& state : set_controls(buffers_->file, settings.controls, name_, device_))
      settings_["controls"].push_back(
          {{"name", state.name}, {"wanted", state.wanted}, {"actual", state.actual}});
    request_buffers(settings.buffers);
  }

  ~V4l2Camera() override {
    buffers_->streaming = false;
    int type = kCapture;
    buffers_->file.control(VIDIOC_STREAMOFF, &type);
  }

  const RawFormat& format() const override { return format_; }
  double fps() const override { return fps_; }
  Json settings() const override { return settings_; }
  int poll_fd() const override { return buffers_->file.fd(); }

  void start() override {
    buffers_->streaming = true;
    for (std::uint32_t i = 0; i < buffers_->maps.size(); ++i) check("queue buffers", buffers_->queue(i));
    int type = kCapture;
    check("start streaming", buffers_->file.control(VIDIOC_STREAMON, &type));
  }

  std::optional<DeviceFrame> take() override {
    v4l2_buffer buffer{};
    buffer.type = kCapture;
    buffer.memory = V4L2_MEMORY_MMAP;
    const int error = buffers_->file.control(VIDIOC_DQBUF, &buffer);
    if (error == EAGAIN) {
      refuse_dead_device();
      return std::nullopt;
    }
    check("stream", error);
    DeviceFrame frame;
    frame.hold = std::shared_ptr<Held>(new Held{buffers_, buffer.index});
    frame.bytes = std::span<const std::byte>(buffers_->maps[buffer.index]).first(buffer.bytesused);
    frame.sequence = buffer.sequence;
    // Unsigned: a clock that runs over 2^63 ns goes on counting.
    frame.timestamp_ns =
        static_cast<std::int64_t>(static_cast<std::uint64_t>(buffer.timestamp.tv_sec) * 1'000'000'000U +
                                  static_cast<std::uint64_t>(buffer.timestamp.tv_usec) * 1000U);
    frame.system_clock = (buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) == V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
    if ((buffer.flags & V4L2_BUF_FLAG_ERROR) != 0) frame.flaw = "flagged bad by the driver";
    return frame;
  }

 private:
  [[noreturn]] void fail(const std::string& what, int error) const {
    throw camera_error(name_, device_, what, error);
  }
  void check(const std::string& what, int error) const {
    if (error != 0) fail(what, error);
  }

  /// poll() wakes for a device that is gone or broken, too, and DQBUF does not always say so.
  void refuse_dead_device() const {
    pollfd poll{poll_fd(), POLLIN, 0};
    if (::poll(&poll, 1, 0) <= 0) return;
    if ((poll.revents & POLLHUP) != 0) fail("stream", ENODEV);
    if ((poll.revents & POLLERR) != 0) {
      v4l2_capability capability{};
      const int error = buffers_->file.control(VIDIOC_QUERYCAP, &capability);
      fail("stream", error != 0 ? error : EIO);
    }
  }

  std::string first_known_format() const {
    v4l2_fmtdesc description{};
    description.type = kCapture;
    for (; buffers_->file.control(VIDIOC_ENUM_FMT, &description) == 0; ++description.index) {
      const std::string text = fourcc_text(description.pixelformat);
      if (is_raw_fourcc(text) || text == "MJPG") return text;
    }
    throw Error("camera " + name_, "has no format that stuv can decode", "`stuv cameras` lists what it has");
  }

  void set_format(const CameraSettings& wanted) {
    v4l2_format format{};
    format.type = kCapture;
    check("read its format", buffers_->file.control(VIDIOC_G_FMT, &format));
    v4l2_pix_format& pix = format.fmt.pix;
    const std::string now = fourcc_text(pix.pixelformat);
    std::string fourcc = wanted.format;
    if (fourcc.empty()) fourcc = is_raw_fourcc(now) || now == "MJPG" ? now : first_known_format();
    fourcc.resize(4, ' ');
    if (!is_raw_fourcc(fourcc) && fourcc != "MJPG")
      throw Error("camera " + name_, fmt::format("format is '{}', which stuv cannot decode", fourcc),
                  "choose another of those that `stuv cameras` lists");
    pix.pixelformat = fourcc_code(fourcc);
    if (wanted.width > 0) pix.width = static_cast<std::uint32_t>(wanted.width);
    if (wanted.height > 0) pix.height = static_cast<std::uint32_t>(wanted.height);
    pix.field = V4L2_FIELD_NONE;
    pix.bytesperline = 0;
    check(fmt::format("set {} {}x{}", fourcc, pix.width, pix.height),
          buffers_->file.control(VIDIOC_S_FMT, &format));
    format_ = {fourcc_text(pix.pixelformat),
               static_cast<int>(pix.width),
               static_cast<int>(pix.height),
               static_cast<int>(pix.bytesperline),
               matrix_of(pix),
               true};
    const bool rgb = format_.fourcc == "RGB3" || format_.fourcc == "BGR3";
    format_.full_range = is_full_range(pix, rgb);
    const bool as_wanted = format_.fourcc == fourcc && (wanted.width == 0 || format_.width == wanted.width) &&
                           (wanted.height == 0 || format_.height == wanted.height);
    if (!as_wanted)
      throw Error(fmt::format("camera {} ({})", name_, device_),
                  fmt::format("makes {} {}x{} of {} {}x{}", format_.fourcc, format_.width, format_.height,
                              fourcc, wanted.width, wanted.height),
                  "choose a format and size that `stuv cameras` lists");
    settings_.update({{"device", device_},
                      {"format", format_.fourcc},
                      {"width", format_.width},
                      {"height", format_.height}});
  }

  void set_rate(const CameraSettings& wanted) {
    v4l2_streamparm parameters{};
    parameters.type = kCapture;
    if (buffers_->file.control(VIDIOC_G_PARM, &parameters) != 0) return;  // a device without rates
    v4l2_fract& interval = parameters.parm.capture.timeperframe;
    if (wanted.fps > 0) {
      interval = {1000, static_cast<std::uint32_t>(std::lround(wanted.fps * 1000))};
      check(fmt::format("set {} frames a second", wanted.fps),
            buffers_->file.control(VIDIOC_S_PARM, &parameters));
    }
    if (interval.numerator > 0) fps_ = static_cast<double>(interval.denominator) / interval.numerator;
    settings_["fps"] = fps_;
    if (wanted.fps > 0) settings_["fps_wanted"] = wanted.fps;
  }

  void request_buffers(int count) {
    v4l2_requestbuffers request{};
    request.count = static_cast<std::uint32_t>(count);
    request.type = kCapture;
    request.memory = V4L2_MEMORY_MMAP;
    check("get buffers", buffers_->file.control(VIDIOC_REQBUFS, &request));
    for (std::uint32_t i = 0; i < request.count; ++i) {
      v4l2_buffer buffer{};
      buffer.type = kCapture;
      buffer.memory = V4L2_MEMORY_MMAP;
      buffer.index = i;
      check("get buffers", buffers_->file.control(VIDIOC_QUERYBUF, &buffer));
      void* map =
          ::mmap(nullptr, buffer.length, PROT_READ | PROT_WRITE, MAP_SHARED, poll_fd(), buffer.m.offset);
      if (map == MAP_FAILED) fail("map its buffers", errno);
      buffers_->maps.emplace_back(static_cast<std::byte*>(map), buffer.length);
    }
    settings_["buffers"] = request.count;
  }

  std::string name_, device_;
  std::shared_ptr<Buffers> buffers_;
  RawFormat format_;
  double fps_ = 0;
  Json settings_;
};

}  // namespace

std::unique_ptr<CameraDevice> open_v4l2_camera(const CameraSettings& settings, const std::string& device) {
  return std::make_unique<V4l2Camera>(settings, device);
}

}  // namespace stuv
