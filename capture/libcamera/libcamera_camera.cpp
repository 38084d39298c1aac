#include "capture/libcamera/libcamera_camera.h"

#include <fmt/format.h>
#include <libcamera/libcamera.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <deque>
#include <mutex>

#include "capture/cameras/explain.h"
#include "core/error.h"

namespace stuv {
namespace {

namespace lc = libcamera;

/// V4L2's four characters and libcamera's (DRM's) name of the same bytes in memory. Only packed formats: two
/// of DRM's names say the colours' order in a little-endian word, backwards.
constexpr std::pair<const char*, const char*> kFormats[] = {
    {"YUYV", "YUYV"},    {"UYVY", "UYVY"},    {"NV12", "NV12"},    {"RGB3", "BGR888"},  {"BGR3", "RGB888"},
    {"GREY", "R8"},      {"MJPG", "MJPEG"},   {"BA81", "SBGGR8"},  {"GBRG", "SGBRG8"},  {"GRBG", "SGRBG8"},
    {"RGGB", "SRGGB8"},  {"BG10", "SBGGR10"}, {"GB10", "SGBRG10"}, {"BA10", "SGRBG10"}, {"RG10", "SRGGB10"},
    {"BG12", "SBGGR12"}, {"GB12", "SGBRG12"}, {"BA12", "SGRBG12"}, {"RG12", "SRGGB12"}, {"BYR2", "SBGGR16"},
    {"GB16", "SGBRG16"}, {"GR16", "SGRBG16"}, {"RG16", "SRGGB16"}};

std::string fourcc_of(const lc::PixelFormat& format) {
  for (const auto& [fourcc, name] : kFormats)
    if (format.toString() == name) return fourcc;
  return format.toString();
}

/// libcamera allows one manager in a process. It stays until the process ends: it alone notices cameras that
/// come and go.
lc::CameraManager& manager() {
  static std::mutex mutex;
  static lc::CameraManager* only = nullptr;
  const std::lock_guard lock(mutex);
  if (only != nullptr) return *only;
  // Libraries of ours do not print; libcamera's words are there on demand.
  if (std::getenv("LIBCAMERA_LOG_LEVELS") == nullptr) lc::logSetTarget(lc::LoggingTargetNone);
  auto fresh = std::make_unique<lc::CameraManager>();
  if (const int error = fresh->start(); error != 0)
    throw Error("libcamera", fmt::format("does not start: {}", std::strerror(-error)),
                "LIBCAMERA_LOG_LEVELS=*:DEBUG shows its own words");
  only = fresh.release();
  return *only;
}

std::string model_of(const lc::Camera& camera) {
  const auto& properties = camera.properties();
  return properties.contains(lc::properties::Model.id()) ? *properties.get(lc::properties::Model) : "";
}

/// The memory of a frame buffer, mapped once for all its planes.
class Mapping {
 public:
  explicit Mapping(const lc::FrameBuffer& buffer) {
    std::size_t size = 0;
    for (const lc::FrameBuffer::Plane& plane : buffer.planes())
      size = std::max<std::size_t>(size, std::size_t{plane.offset} + plane.length);
    void* map = ::mmap(nullptr, size, PROT_READ, MAP_SHARED, buffer.planes()[0].fd.get(), 0);
    if (map != MAP_FAILED) bytes_ = {static_cast<const std::byte*>(map), size};
  }
  ~Mapping() {
    if (!bytes_.empty()) ::munmap(const_cast<std::byte*>(bytes_.data()), bytes_.size());
  }
  Mapping(const Mapping&) = delete;
  Mapping& operator=(const Mapping&) = delete;
  std::span<const std::byte> bytes() const { return bytes_; }

 private:
  std::span<const std::byte> bytes_;
};

/// What libcamera's thread, the polling thread and holders of frames share.
struct Shared {
  std::mutex mutex;
  std::deque<lc::Request*> completed;
  bool gone = false;            ///< libcamera has noticed that it is unplugged
  std::size_t outstanding = 0;  ///< requests that libcamera has
  std::chrono::steady_clock::time_point last_completed;
  std::size_t cancelled = 0;      ///< requests that came back empty, one after the other
  lc::Camera* running = nullptr;  ///< while requests may be queued
  std::vector<std::unique_ptr<Mapping>> mappings;
  int event = ::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC | EFD_SEMAPHORE);
  Shared() = default;
  ~Shared() { ::close(event); }
  Shared(const Shared&) = delete;
  Shared& operator=(const Shared&) = delete;

  void wake() const {
    const std::uint64_t one = 1;
    [[maybe_unused]] const auto written = ::write(event, &one, sizeof one);
  }
  void queue(lc::Request* request) {
    const std::lock_guard lock(mutex);
    if (running == nullptr) return;
    request->reuse(lc::Request::ReuseBuffers);
    send(request);
  }
  /// With the mutex held.
  int send(lc::Request* request) {
    const int result = running->queueRequest(request);
    if (result == 0) ++outstanding;
    return result;
  }
};

struct Held {
  std::shared_ptr<Shared> shared;
  lc::Request* request;
  ~Held() { shared->queue(request); }
};

/// A camera that is acquired, with all that has to go before it is released.
struct Session {
  explicit Session(std::shared_ptr<lc::Camera> acquired)
      : camera(std::move(acquired)), shared(std::make_shared<Shared>()) {
    camera->requestCompleted.connect(this, &Session::on_completed);
    camera->disconnected.connect(this, &Session::on_disconnected);
  }
  ~Session() {
    {
      const std::lock_guard lock(shared->mutex);
      shared->running = nullptr;
    }
    if (started) camera->stop();
    camera->requestCompleted.disconnect(this);
    camera->disconnected.disconnect(this);
    requests.clear();
    allocator.reset();
    camera->release();
  }
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  // On libcamera's thread.
  void on_completed(lc::Request* request) {
    const std::lock_guard lock(shared->mutex);
    --shared->outstanding;
    shared->last_completed = std::chrono::steady_clock::now();
    shared->completed.push_back(request);
    shared->wake();
  }
  void on_disconnected() {
    const std::lock_guard lock(shared->mutex);
    shared->gone = true;
    shared->running = nullptr;
    shared->wake();
  }

  /// libcamera 0.0.3 aborts the process when a camera is stopped whose driver is gone before libcamera has
  /// noticed, or while it still has requests, which a driver that is gone may never give back. Of one that
  /// was silent for long, that has to be feared.
  bool must_wait() const {
    const std::lock_guard lock(shared->mutex);
    if (!started || shared->outstanding == 0) return false;
    const auto silent = std::chrono::steady_clock::now() - shared->last_completed;
    return shared->gone || shared->cancelled > 0 || silent > std::chrono::seconds(1);
  }

  std::shared_ptr<lc::Camera> camera;
  std::shared_ptr<Shared> shared;
  std::unique_ptr<lc::CameraConfiguration> config;
  std::unique_ptr<lc::FrameBufferAllocator> allocator;
  std::vector<std::unique_ptr<lc::Request>> requests;
  bool started = false;
};

/// Releases a session; one that must wait is kept until a later call.
void close_session(std::unique_ptr<Session> session) {
  static std::mutex mutex;
  static auto& waiting = *new std::vector<std::unique_ptr<Session>>;  // never destroyed
  const std::lock_guard lock(mutex);
  if (session && session->must_wait()) {
    {
      const std::lock_guard shared_lock(session->shared->mutex);
      session->shared->running = nullptr;
    }
    waiting.push_back(std::move(session));
  }
  std::erase_if(waiting, [](const auto& other) { return !other->must_wait(); });
}

class LibcameraCamera final : public CameraDevice {
 public:
  explicit LibcameraCamera(const CameraSettings& settings)
      : name_(settings.name), id_(settings.id.substr(settings.id.find(':') + 1)) {
    close_session(nullptr);  // perhaps this camera was unplugged, and can be released now
    std::shared_ptr<lc::Camera> camera = manager().get(id_);
    if (!camera) fail("open it", ENODEV);
    check("acquire it", camera->acquire());
    session_ = std::make_unique<Session>(camera);
    configure(settings);
    allocate();
    choose_controls(settings);
  }

  ~LibcameraCamera() override { close_session(std::move(session_)); }

  const RawFormat& format() const override { return format_; }
  double fps() const override { return fps_; }
  Json settings() const override { return settings_; }
  int poll_fd() const override { return session_->shared->event; }

  void start() override {
    lc::Camera& camera = *session_->camera;
    check("start streaming", camera.start(&controls_));
    session_->started = true;
    session_->shared->last_completed = std::chrono::steady_clock::now();
    const std::lock_guard lock(session_->shared->mutex);
    session_->shared->running = &camera;
    for (const auto& request : session_->requests)
      check("queue buffers", session_->shared->send(request.get()));
  }

  std::optional<DeviceFrame> take() override {
    Shared& shared = *session_->shared;
    const std::lock_guard lock(shared.mutex);
    std::uint64_t count = 0;
    // One count a frame (EFD_SEMAPHORE), so it stays readable while frames wait.
    [[maybe_unused]] const auto read = ::read(shared.event, &count, sizeof count);
    if (shared.gone) fail("stream", ENODEV);
    if (shared.completed.empty()) return std::nullopt;
    lc::Request* request = shared.completed.front();
    shared.completed.pop_front();
    if (request->status() != lc::Request::RequestCancelled) {
      shared.cancelled = 0;
      return frame_of(request);
    }
    // The driver did not take it.
    if (++shared.cancelled >= 2) fail("stream", ENODEV);
    request->reuse(lc::Request::ReuseBuffers);
    if (shared.running != nullptr) shared.send(request);
    return std::nullopt;
  }

 private:
  [[noreturn]] void fail(const std::string& what, int error) const {
    throw camera_error(name_, id_, what, error);
  }
  void check(const std::string& what, int result) const {
    if (result < 0) fail(what, -result);
  }

  void configure(const CameraSettings& wanted) {
    const bool bayer = is_raw_fourcc(wanted.format) && fourcc_is_bayer(wanted.format);
    session_->config =
        session_->camera->generateConfiguration({bayer ? lc::StreamRole::Raw : lc::StreamRole::Viewfinder});
    if (!session_->config || session_->config->empty()) fail("configure it", EINVAL);
    lc::StreamConfiguration& stream = session_->config->at(0);
    stream.pixelFormat = choose_format(stream, wanted.format);
    if (wanted.width > 0 && wanted.height > 0)
      stream.size = {static_cast<unsigned>(wanted.width), static_cast<unsigned>(wanted.height)};
    stream.bufferCount = static_cast<unsigned>(wanted.buffers);
    const lc::PixelFormat format = stream.pixelFormat;
    const lc::Size size = stream.size;
    if (session_->config->validate() == lc::CameraConfiguration::Invalid) fail("configure it", EINVAL);
    if (stream.pixelFormat != format || stream.size != size)
      throw Error(fmt::format("camera {} ({})", name_, id_),
                  fmt::format("makes {} {} of {} {}", stream.pixelFormat.toString(), stream.size.toString(),
                              format.toString(), size.toString()),
                  "choose a format and size that `stuv cameras` lists");
    check("configure it", session_->camera->configure(session_->config.get()));
    format_ = {fourcc_of(stream.pixelFormat),
               static_cast<int>(stream.size.width),
               static_cast<int>(stream.size.height),
               static_cast<int>(stream.stride),
               YuvMatrix::bt601,
               true};
    if (stream.colorSpace) {
      format_.full_range = stream.colorSpace->range == lc::ColorSpace::Range::Full;
      if (stream.colorSpace->ycbcrEncoding == lc::ColorSpace::YcbcrEncoding::Rec709)
        format_.matrix = YuvMatrix::bt709;
      if (stream.colorSpace->ycbcrEncoding == lc::ColorSpace::YcbcrEncoding::Rec2020)
        format_.matrix = YuvMatrix::bt2020;
    }
    settings_ = {
        {"device", id_}, {"format", format_.fourcc}, {"width", format_.width}, {"height", format_.height}};
  }

  static bool fourcc_is_bayer(const std::string& fourcc) {
    const auto* found = std::find_if(std::begin(kFormats), std::end(kFormats),
                                     [&](const auto& entry) { return fourcc == entry.first; });
    return found != std::end(kFormats) && found->second[0] == 'S';
  }

  lc::PixelFormat choose_format(const lc::StreamConfiguration& stream, const std::string& wanted) const {
    for (const lc::PixelFormat& format : stream.formats().pixelformats()) {
      const std::string fourcc = fourcc_of(format);
      if (wanted.empty() ? is_raw_fourcc(fourcc) || fourcc == "MJPG" : fourcc == wanted) return format;
    }
    throw Error(
        fmt::format("camera {} ({})", name_, id_),
        wanted.empty() ? "has no format that stuv can decode" : fmt::format("has no format '{}'", wanted),
        "choose one that `stuv cameras` lists");
  }

  void allocate() {
    lc::Stream* stream = session_->config->at(0).stream();
    session_->allocator = std::make_unique<lc::FrameBufferAllocator>(session_->camera);
    check("get buffers", session_->allocator->allocate(stream));
    for (const auto& buffer : session_->allocator->buffers(stream)) {
      session_->shared->mappings.push_back(std::make_unique<Mapping>(*buffer));
      if (session_->shared->mappings.back()->bytes().empty()) fail("map its buffers", ENOMEM);
      auto request = session_->camera->createRequest(session_->requests.size());
      if (!request) fail("get buffers", ENOMEM);
      check("get buffers", request->addBuffer(stream, buffer.get()));
      session_->requests.push_back(std::move(request));
    }
    settings_["buffers"] = session_->requests.size();
  }

  void choose_controls(const CameraSettings& wanted) {
    controls_ = lc::ControlList(session_->camera->controls());
    Json list = Json::array();
    for (const auto& [name, value] : wanted.controls) {
      const std::string theirs = name == "exposure" ? "ExposureTime" : name == "gain" ? "AnalogueGain" : name;
      controls_.set(find_control(theirs), to_control(find_control_type(theirs), value));
      list.push_back({{"name", name}, {"wanted", value}, {"actual", nullptr}});
    }
    settings_["controls"] = list;
    const auto& known = session_->camera->controls();
    if (wanted.fps > 0 && known.find(&lc::controls::FrameDurationLimits) != known.end()) {
      const auto duration_us = static_cast<std::int64_t>(std::llround(1e6 / wanted.fps));
      const std::array<std::int64_t, 2> limits = {duration_us, duration_us};
      controls_.set(lc::controls::FrameDurationLimits.id(),
                    lc::ControlValue(lc::Span<const std::int64_t>(limits)));
      fps_ = wanted.fps;
    }
    settings_["fps"] = fps_ > 0 ? Json(fps_) : Json();
  }

  const lc::ControlId& control_named(const std::string& name) const {
    std::vector<std::string> names;
    for (const auto& [id, info] : session_->camera->controls()) {
      if (id->name() == name) return *id;
      names.push_back(id->name());
    }
    throw Error("camera " + name_, fmt::format("has no control '{}'", name),
                fmt::format("it has {}", names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", "))));
  }
  unsigned find_control(const std::string& name) const { return control_named(name).id(); }
  lc::ControlType find_control_type(const std::string& name) const { return control_named(name).type(); }

  static lc::ControlValue to_control(lc::ControlType type, std::int64_t value) {
    switch (type) {
      case lc::ControlTypeBool:
        return lc::ControlValue(value != 0);
      case lc::ControlTypeFloat:
        return lc::ControlValue(static_cast<float>(value));
      case lc::ControlTypeInteger64:
        return lc::ControlValue(value);
      default:
        return lc::ControlValue(static_cast<std::int32_t>(value));
    }
  }

  DeviceFrame frame_of(lc::Request* request) const {
    const auto& [stream, buffer] = *request->buffers().begin();
    const lc::FrameMetadata& metadata = buffer->metadata();
    DeviceFrame frame;
    frame.hold = std::shared_ptr<Held>(new Held{session_->shared, request});
    std::size_t used = 0;
    for (const lc::FrameMetadata::Plane& plane : metadata.planes()) used += plane.bytesused;
    const auto bytes = session_->shared->mappings[request->cookie()]->bytes();
    frame.bytes = bytes.first(std::min(used, bytes.size()));
    frame.sequence = metadata.sequence;
    frame.timestamp_ns = static_cast<std::int64_t>(metadata.timestamp);
    frame.system_clock = true;
    if (metadata.status != lc::FrameMetadata::FrameSuccess) frame.flaw = "flagged bad by libcamera";
    return frame;
  }

  std::string name_, id_;
  std::unique_ptr<Session> session_;
  lc::ControlList controls_;
  RawFormat format_;
  double fps_ = 0;
  Json settings_;
};

}  // namespace

std::vector<CameraInfo> list_libcamera_cameras() {
  std::vector<CameraInfo> cameras;
  for (const std::shared_ptr<lc::Camera>& camera : manager().cameras()) {
    CameraInfo info;
    info.id = "libcamera:" + camera->id();
    info.device = camera->id();
    info.model = model_of(*camera);
    info.driver = "libcamera";
    const auto config = camera->generateConfiguration({lc::StreamRole::Viewfinder});
    if (config && !config->empty()) {
      const lc::StreamFormats& formats = config->at(0).formats();
      for (const lc::PixelFormat& format : formats.pixelformats())
        for (const lc::Size& size : formats.sizes(format))
          info.modes.push_back(
              {fourcc_of(format), static_cast<int>(size.width), static_cast<int>(size.height), {}});
    }
    cameras.push_back(std::move(info));
  }
  return cameras;
}

std::unique_ptr<CameraDevice> open_libcamera_camera(const CameraSettings& settings) {
  return std::make_unique<LibcameraCamera>(settings);
}

}  // namespace stuv
