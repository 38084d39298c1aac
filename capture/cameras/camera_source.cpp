#include "capture/cameras/camera_source.h"

#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <set>
#include <thread>

#include "capture/cameras/camera_clock.h"
#include "capture/cameras/capture_tally.h"
#include "capture/cameras/set_matcher.h"
#include "core/error.h"

namespace stuv {
namespace {

constexpr std::int64_t kSecond_ns = 1'000'000'000;

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

bool jpeg_is_whole(std::span<const std::byte> bytes) {
  // Drivers pad behind the end marker.
  std::size_t end = bytes.size();
  while (end > 0 && bytes[end - 1] == std::byte{0}) --end;
  return end >= 4 && bytes[0] == std::byte{0xFF} && bytes[1] == std::byte{0xD8} &&
         bytes[end - 2] == std::byte{0xFF} && bytes[end - 1] == std::byte{0xD9};
}

/// What is wrong with a frame that the driver did not flag; "" if nothing.
std::string flaw_of(const DeviceFrame& frame, const RawFormat& format) {
  if (!frame.flaw.empty()) return frame.flaw;
  if (format.fourcc == "MJPG") return jpeg_is_whole(frame.bytes) ? "" : "the JPEG is truncated";
  const std::size_t needed = raw_size(format);
  return frame.bytes.size() >= needed ? ""
                                      : fmt::format("only {} of {} bytes came", frame.bytes.size(), needed);
}

/// One camera of the rig, there or not.
struct Slot {
  CameraSettings settings;
  std::unique_ptr<CameraDevice> device;  ///< none: lost
  RawFormat format;
  CameraClock clock;
  std::int64_t retry_ns = 0, last_frame_ns = 0;
};

class CameraSource final : public Source {
 public:
  CameraSource(const CameraSourceOptions& options, const Reporter& reporter, const std::atomic<bool>* stop,
               StatusFunction status, OpenFunction open)
      : options_(options),
        reporter_(reporter),
        stop_(stop),
        status_(std::move(status)),
        open_(std::move(open)) {
    for (const CameraSettings& camera : options.cameras) {
      slots_.push_back({camera, nullptr, {}, {}, 0, 0});
      cameras_.push_back({camera.name, camera.row, camera.col});
      tallies_.emplace_back().name = camera.name;
    }
    open_all();
    start_all();
    matcher_.emplace(slots_.size(), matcher_options());
    for (std::size_t i = 0; i < slots_.size(); ++i) matcher_->set_live(i, slots_[i].device != nullptr);
    begin_ns_ = seen_live_ns_ = now_ns();
    for (Slot& slot : slots_) slot.last_frame_ns = begin_ns_;
    thread_ = std::thread([this] { poll_loop(); });
  }

  ~CameraSource() override { finish(); }

  int rows() const override { return options_.rows; }
  int cols() const override { return options_.cols; }
  const std::vector<RecordedCamera>& cameras() const override { return cameras_; }
  bool live() const override { return true; }

  Json description() const override {
    static constexpr const char* modes[] = {"free", "common-start", "trigger"};
    Json list = Json::array();
    for (std::size_t i = 0; i < slots_.size(); ++i)
      list.push_back(
          {{"name", cameras_[i].name}, {"id", slots_[i].settings.id}, {"settings", described_[i]}});
    return {{"kind", "cameras"}, {"mode", modes[static_cast<int>(options_.mode)]}, {"cameras", list}};
  }

  std::optional<SourceSet> next() override {
    std::unique_lock lock(mutex_);
    while (queue_.empty()) {
      if (!failure_.empty())
        throw Error("the cameras", failure_, "check plugs and power; finished sets stay readable");
      if (ended_) return std::nullopt;
      ready_.wait_for(lock, std::chrono::milliseconds(100));
    }
    SourceSet set = std::move(queue_.front());
    queue_.pop_front();
    count(set);
    lock.unlock();
    report_status(set);
    return set;
  }

  Json report() override {
    finish();
    const std::lock_guard lock(mutex_);
    const int width = slots_.empty() ? 0 : slots_[0].format.width;
    return report_of(tallies_, sets_, options_.motion, width,
                     1e-9 * static_cast<double>(end_ns_ - begin_ns_));
  }

 private:
  MatcherOptions matcher_options() const {
    double fps = 0;
    for (const Slot& slot : slots_)
      if (slot.device && slot.device->fps() > 0)
        fps = fps > 0 ? std::min(fps, slot.device->fps()) : slot.device->fps();
    MatcherOptions matcher;
    if (fps > 0) matcher.period_ns = std::llround(1e9 / fps);
    matcher.patience_ns = std::max(3 * matcher.period_ns, matcher.patience_ns);
    if (options_.mode == CameraSourceOptions::Mode::trigger)
      matcher.trigger_window_ns = options_.trigger_window_ms > 0
                                      ? std::llround(1e6 * options_.trigger_window_ms)
                                      : matcher.period_ns / 2;
    return matcher;
  }

  void open_all() {
    for (std::size_t i = 0; i < slots_.size(); ++i) {
      described_.emplace_back();
      attempt(i, [&] {
        slots_[i].device = open_(slots_[i].settings);
        slots_[i].format = slots_[i].device->format();
        described_[i] = slots_[i].device->settings();
        warn_of_controls(i);
      });
    }
    refuse_troubled();
  }

  /// One after the other costs milliseconds a camera on USB; threads start them together.
  void start_all() {
    if (options_.mode != CameraSourceOptions::Mode::common_start) {
      for (std::size_t i = 0; i < slots_.size(); ++i)
        if (slots_[i].device) attempt(i, [&] { slots_[i].device->start(); });
    } else {
      std::vector<std::thread> threads;
      for (std::size_t i = 0; i < slots_.size(); ++i)
        if (slots_[i].device)
          threads.emplace_back([this, i] { attempt(i, [&] { slots_[i].device->start(); }); });
      for (std::thread& thread : threads) thread.join();
    }
    refuse_troubled();
  }

  template <class F>
  void attempt(std::size_t i, const F& f) {
    try {
      f();
    } catch (const Error& error) {
      tallies_[i].trouble = error.what();
      slots_[i].device.reset();
    }
  }

  void refuse_troubled() {
    std::vector<std::string> troubles;
    for (const CameraTally& tally : tallies_)
      if (!tally.trouble.empty()) troubles.push_back(tally.trouble);
    if (troubles.empty()) return;
    if (options_.allow_missing && troubles.size() < slots_.size()) {
      for (const std::string& trouble : troubles) reporter_.warn(trouble);
      return;
    }
    if (troubles.size() == 1)
      throw Error("1 camera does not start", troubles[0], "or set source.allow_missing to begin without it");
    throw Error(fmt::format("{} of {} cameras do not start", troubles.size(), slots_.size()),
                fmt::format("{}", fmt::join(troubles, " | ")),
                "or set source.allow_missing to begin without them");
  }

  void warn_of_controls(std::size_t i) const {
    for (const Json& control : described_[i].value("controls", Json::array()))
      if (control["wanted"] != control["actual"])
        reporter_.warn(fmt::format("camera {}: {} was set to {}, and the device made it {}", cameras_[i].name,
                                   control["name"].get<std::string>(), control["wanted"].dump(),
                                   control["actual"].dump()));
  }

  // --- the polling thread ---

  void poll_loop() {
    while (!finish_ && !time_is_over()) {
      wait_for_frames();
      for (std::size_t k = 0; k < polled_.size(); ++k)
        if (polled_[k].revents != 0) take_frame(polled_slots_[k]);
      lose_silent();
      reopen_lost();
      while (std::optional<MatchedSet> set = matcher_->take(now_ns())) push(std::move(*set));
      if (nobody_left()) break;
    }
    for (Slot& slot : slots_) slot.device.reset();
    const std::lock_guard lock(mutex_);
    end_ns_ = now_ns();
    ended_ = true;
    ready_.notify_all();
  }

  bool time_is_over() const {
    if (stop_ != nullptr && *stop_) return true;
    return options_.duration_s > 0 && now_ns() - begin_ns_ > std::llround(1e9 * options_.duration_s);
  }

  void wait_for_frames() {
    polled_.clear();
    polled_slots_.clear();
    for (std::size_t i = 0; i < slots_.size(); ++i) {
      if (!slots_[i].device) continue;
      polled_.push_back({slots_[i].device->poll_fd(), POLLIN, 0});
      polled_slots_.push_back(i);
    }
    ::poll(polled_.data(), polled_.size(), 50);
  }

  void take_frame(std::size_t i) {
    try {
      if (std::optional<DeviceFrame> frame = slots_[i].device->take()) accept(i, std::move(*frame));
    } catch (const Error& error) {
      lose(i, error.what());
    }
  }

  void accept(std::size_t i, DeviceFrame frame) {
    Slot& slot = slots_[i];
    const std::int64_t arrival = slot.last_frame_ns = now_ns(), skipped = slot.clock.count(frame.sequence);
    TimedFrame timed{std::move(frame), slot.clock.sequence(), 0};
    timed.frame.flaw = flaw_of(timed.frame, slot.format);
    timed.time_ns = slot.clock.system_time_ns(timed.frame.timestamp_ns, arrival);
    {
      const std::lock_guard lock(mutex_);
      CameraTally& tally = tallies_[i];
      ++tally.frames;
      tally.clock_offset_ns = slot.clock.offset_ns();
      if (tally.frames == 1) tally.first_ns = timed.time_ns;
      tally.last_ns = timed.time_ns;
      if (skipped < 0) {
        ++tally.duplicates;
        return;
      }
      tally.dropped += static_cast<std::size_t>(skipped);
      if (!timed.frame.flaw.empty()) ++tally.flawed;
    }
    matcher_->add(i, std::move(timed));
  }

  void lose(std::size_t i, const std::string& why) {
    slots_[i].device.reset();
    slots_[i].retry_ns = now_ns() + kSecond_ns / 2;
    matcher_->set_live(i, false);
    {
      const std::lock_guard lock(mutex_);
      ++tallies_[i].lost;
      tallies_[i].trouble = why;
    }
    reporter_.warn(fmt::format("{}. The others go on; it is opened again when it is back", why));
  }

  /// Not every driver says when its camera is gone. One that waits for a trigger may be silent.
  void lose_silent() {
    if (options_.mode == CameraSourceOptions::Mode::trigger) return;
    for (std::size_t i = 0; i < slots_.size(); ++i) {
      if (!slots_[i].device) continue;
      const double fps = slots_[i].device->fps();
      const double patience_s = std::max(3.0, fps > 0 ? 10 / fps : 0.0);
      if (static_cast<double>(now_ns() - slots_[i].last_frame_ns) < 1e9 * patience_s) continue;
      lose(i,
           fmt::format("camera {}: has sent nothing for {:.0f} s: unplugged, or its cable or hub is at fault",
                       slots_[i].settings.name, patience_s));
    }
  }

  void reopen_lost() {
    for (std::size_t i = 0; i < slots_.size(); ++i) {
      Slot& slot = slots_[i];
      if (slot.device || now_ns() < slot.retry_ns) continue;
      slot.retry_ns = now_ns() + kSecond_ns;
      try {
        auto device = open_(slot.settings);
        if (device->format() != slot.format && slot.format.width > 0) continue;  // is another camera
        device->start();
        slot.format = device->format();
        slot.device = std::move(device);
      } catch (const Error&) {
        continue;  // the cause was told when it was lost
      }
      slot.clock.restart();
      slot.last_frame_ns = now_ns();
      matcher_->set_live(i, true);
      {
        const std::lock_guard lock(mutex_);
        tallies_[i].trouble.clear();
      }
      reporter_.warn(fmt::format("camera {} is back", slot.settings.name));
    }
  }

  bool nobody_left() {
    const bool any =
        std::any_of(slots_.begin(), slots_.end(), [](const Slot& slot) { return slot.device != nullptr; });
    const std::int64_t now = now_ns();
    if (any) seen_live_ns_ = now;
    if (static_cast<double>(now - seen_live_ns_) < 1e9 * options_.give_up_s) return false;
    const std::lock_guard lock(mutex_);
    failure_ = fmt::format("are all gone, the last trouble being: {}", tallies_.back().trouble);
    return true;
  }

  SourceFrame to_source_frame(std::size_t i, TimedFrame& timed) const {
    SourceFrame frame;
    frame.sequence = timed.sequence;
    frame.timestamp_ns = timed.time_ns;
    frame.problem = timed.frame.flaw;
    frame.status = frame.problem.empty() ? FrameStatus::ok : FrameStatus::error;
    if (frame.status == FrameStatus::ok)
      frame.content =
          RawFrame{timed.frame.bytes, std::move(timed.frame.hold), slots_[i].format, options_.record};
    return frame;
  }

  std::size_t queue_limit() const {
    int limit = options_.queue_sets;
    for (const Slot& slot : slots_) limit = std::min(limit, slot.settings.buffers - 4);
    return static_cast<std::size_t>(std::max(limit, 1));
  }

  void push(MatchedSet matched) {
    const std::lock_guard lock(mutex_);
    for (std::size_t i = 0; i < slots_.size(); ++i) tallies_[i].unmatched = matcher_->unmatched(i);
    if (queue_.size() >= queue_limit()) {
      ++sets_.queue_full;
      for (std::size_t i = 0; i < slots_.size(); ++i) tallies_[i].queue_full += matched.frames[i] ? 1 : 0;
      return;
    }
    SourceSet set{fmt::format("{:06}", set_number_++), std::vector<SourceFrame>(slots_.size())};
    for (std::size_t i = 0; i < slots_.size(); ++i)
      if (matched.frames[i]) set.frames[i] = to_source_frame(i, *matched.frames[i]);
    queue_.push_back(std::move(set));
    ready_.notify_one();
  }

  // --- the recording thread ---

  /// With mutex_ held.
  void count(const SourceSet& set) {
    std::int64_t first = INT64_MAX, last = INT64_MIN;
    bool complete = true;
    for (std::size_t i = 0; i < set.frames.size(); ++i) {
      const SourceFrame& frame = set.frames[i];
      complete &= frame.status == FrameStatus::ok;
      if (frame.status == FrameStatus::missing) continue;
      ++tallies_[i].recorded;
      first = std::min(first, frame.timestamp_ns);
      last = std::max(last, frame.timestamp_ns);
    }
    ++(complete ? sets_.complete : sets_.incomplete);
    if (complete) sets_.skews_ns.push_back(last - first);
  }

  void report_status(const SourceSet& set) {
    if (!status_) return;
    const std::int64_t now = now_ns();
    const double seconds = 1e-9 * static_cast<double>(now - rates_ns_);
    const bool due = seconds >= 1;
    if (due) rates_ns_ = now;
    rates_.resize(slots_.size());
    frames_before_.resize(slots_.size());
    std::vector<CameraStatus> list;
    {
      const std::lock_guard lock(mutex_);
      for (std::size_t i = 0; i < tallies_.size(); ++i) {
        const CameraTally& tally = tallies_[i];
        if (due) {
          rates_[i] = static_cast<double>(tally.frames - frames_before_[i]) / seconds;
          frames_before_[i] = tally.frames;
        }
        list.push_back({tally.name, tally.trouble.empty(), rates_[i], tally.frames, tally.dropped,
                        tally.flawed, tally.trouble});
      }
    }
    status_(list, set);
  }

  void finish() {
    finish_ = true;
    if (thread_.joinable()) thread_.join();
  }

  const CameraSourceOptions options_;
  const Reporter reporter_;
  const std::atomic<bool>* stop_;
  const StatusFunction status_;
  const OpenFunction open_;
  std::vector<RecordedCamera> cameras_;
  std::vector<Json> described_;

  // Of the polling thread, once it runs.
  std::vector<Slot> slots_;
  std::optional<SetMatcher> matcher_;
  std::vector<pollfd> polled_;
  std::vector<std::size_t> polled_slots_;  ///< whose they are
  std::int64_t begin_ns_ = 0, seen_live_ns_ = 0;
  std::size_t set_number_ = 0;

  std::mutex mutex_;  ///< guards what follows
  std::condition_variable ready_;
  std::deque<SourceSet> queue_;
  std::vector<CameraTally> tallies_;
  SetTally sets_;
  std::string failure_;
  bool ended_ = false;
  std::int64_t end_ns_ = 0;

  // Of the recording thread.
  std::int64_t rates_ns_ = 0;  ///< when rates_ were measured
  std::vector<double> rates_;
  std::vector<std::size_t> frames_before_;

  std::atomic<bool> finish_{false};
  std::thread thread_;
};

}  // namespace

std::string problem_of(const CameraSourceOptions& options) {
  if (options.rows < 1 || options.cols < 1 || options.rows > 100 || options.cols > 100)
    return fmt::format("source.rows x cols is {}x{}, each must be 1 to 100", options.rows, options.cols);
  if (options.cameras.empty()) return "there is no [[camera]]; `stuv cameras -o CONFIG.toml` writes them";
  if (options.queue_sets < 1 || options.queue_sets > 1000)
    return fmt::format("source.queue_sets is {}, must be 1 to 1000", options.queue_sets);
  if (!(options.trigger_window_ms >= 0) || !(options.duration_s >= 0) || !(options.give_up_s >= 0))
    return "source.trigger_window_ms, duration_s and give_up_s must not be negative";
  if (options.record != "raw" && options.record != "png" && options.record != "tif")
    return fmt::format("source.record is '{}', must be raw, png or tif", options.record);
  if (!(options.motion.distance_m > 0) || !(options.motion.speed_m_per_s >= 0) ||
      !(options.motion.focal_px >= 0))
    return "motion.distance_m must be above 0, speed_m_per_s and focal_px not negative";
  std::set<std::string> names, ids;
  std::set<std::pair<int, int>> places;
  for (const CameraSettings& camera : options.cameras) {
    if (camera.name.empty() || camera.name.front() == '.' || camera.name.find('/') != std::string::npos)
      return fmt::format("camera.name is '{}', must be a file's name", camera.name);
    if (!names.insert(camera.name).second) return fmt::format("camera.name '{}' comes twice", camera.name);
    if (camera.id.empty()) return fmt::format("camera {} has no id", camera.name);
    if (!ids.insert(camera.id).second) return fmt::format("camera.id '{}' comes twice", camera.id);
    if (camera.row < 0 || camera.col < 0 || camera.row >= options.rows || camera.col >= options.cols)
      return fmt::format("camera {} is at row {}, col {}, outside the {}x{} grid", camera.name, camera.row,
                         camera.col, options.rows, options.cols);
    if (!places.insert({camera.row, camera.col}).second)
      return fmt::format("camera {} shares row {}, col {} with another", camera.name, camera.row, camera.col);
    if (camera.buffers < 2 || camera.buffers > 32)
      return fmt::format("camera {}: buffers is {}, must be 2 to 32", camera.name, camera.buffers);
    if (!(camera.fps >= 0) || camera.fps > 10'000 || camera.width < 0 || camera.height < 0)
      return fmt::format("camera {}: width, height and fps must not be negative or absurd", camera.name);
  }
  return {};
}

std::unique_ptr<Source> open_cameras(const CameraSourceOptions& options, const Reporter& reporter,
                                     const std::atomic<bool>* stop, StatusFunction status,
                                     OpenFunction open) {
  return std::make_unique<CameraSource>(options, reporter, stop, std::move(status), std::move(open));
}

}  // namespace stuv
