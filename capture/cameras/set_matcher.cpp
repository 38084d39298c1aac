#include "capture/cameras/set_matcher.h"

#include <algorithm>
#include <cmath>

#include "core/median.h"

namespace stuv {
namespace {

std::int64_t modulo(std::int64_t a, std::int64_t n) { return (a % n + n) % n; }

/// A gap on the circle of phases: its middle in [0, period) and its width.
struct Gap {
  std::int64_t middle, width;
};

/// Gaps between neighbouring phases (in any order, at least one).
std::vector<Gap> gaps_between(std::vector<std::int64_t> phases, std::int64_t period) {
  std::sort(phases.begin(), phases.end());
  std::vector<Gap> gaps;
  for (std::size_t i = 0; i < phases.size(); ++i) {
    const std::int64_t next = i + 1 < phases.size() ? phases[i + 1] : phases[0] + period;
    gaps.push_back({modulo(phases[i] + (next - phases[i]) / 2, period), next - phases[i]});
  }
  return gaps;
}

Gap largest(const std::vector<Gap>& gaps) {
  return *std::max_element(gaps.begin(), gaps.end(),
                           [](const Gap& a, const Gap& b) { return a.width < b.width; });
}

}  // namespace

SetMatcher::SetMatcher(std::size_t cameras, const MatcherOptions& options)
    : options_(options), cameras_(cameras) {}

/// Gains of the loop that follows a camera's beat, for its phase and its interval: critically damped, half of
/// an error is gone after some ten frames.
constexpr double kPhaseGain = 1.0 / 8, kIntervalGain = kPhaseGain * kPhaseGain / 4;

std::int64_t SetMatcher::follow(Camera& camera, const TimedFrame& frame) const {
  if (camera.interval_ns <= 0) camera.interval_ns = static_cast<double>(options_.period_ns);
  if (!camera.last_ns || frame.sequence <= camera.last_sequence) return frame.time_ns;
  const auto steps = static_cast<double>(frame.sequence - camera.last_sequence);
  const std::int64_t expected = camera.last_beat_ns + std::llround(camera.interval_ns * steps);
  const auto late = static_cast<double>(frame.time_ns - expected);
  if (std::abs(late) > camera.interval_ns / 2) {
    // More than jitter: the camera has another beat, or another rate than it says.
    const auto step = static_cast<double>(frame.time_ns - *camera.last_ns);
    if (step > 0) camera.interval_ns = step / steps;
    return frame.time_ns;
  }
  camera.interval_ns += kIntervalGain * late / steps;
  return expected + std::llround(kPhaseGain * late);
}

void SetMatcher::add(std::size_t index, TimedFrame frame) {
  Camera& camera = cameras_[index];
  frame.beat_ns = options_.trigger_window_ns > 0 ? frame.time_ns : follow(camera, frame);
  camera.last_ns = frame.time_ns;
  camera.last_beat_ns = frame.beat_ns;
  camera.last_sequence = frame.sequence;
  if (cut_ns_ && frame.beat_ns < *cut_ns_)
    ++camera.unmatched;  // its set is gone
  else
    camera.pending.push_back(std::move(frame));
}

void SetMatcher::set_live(std::size_t camera, bool live) {
  cameras_[camera].live = live;
  if (live) return;
  cameras_[camera].last_ns.reset();
  cameras_[camera].interval_ns = 0;
}

std::int64_t SetMatcher::period_ns() const {
  std::vector<double> intervals;
  for (const Camera& camera : cameras_)
    if (camera.live && camera.interval_ns > 0) intervals.push_back(camera.interval_ns);
  if (intervals.empty()) return options_.period_ns;
  return std::max<std::int64_t>(1, std::llround(median(std::move(intervals))));
}

/// Finds the first cut, once every live camera has delivered. False: not yet.
bool SetMatcher::begin(std::int64_t now_ns, bool flush) {
  std::vector<std::int64_t> first;
  bool all = true;
  for (const Camera& camera : cameras_) {
    if (!camera.pending.empty()) first.push_back(camera.pending.front().beat_ns);
    all &= !camera.live || camera.pending.size() >= 2;
  }
  if (first.empty()) return false;
  const std::int64_t period = period_ns(), oldest = *std::min_element(first.begin(), first.end());
  if (!all && !flush && now_ns < oldest + 4 * period + options_.patience_ns) return false;
  if (options_.trigger_window_ns > 0) {
    cut_ns_ = oldest;
    return true;
  }
  std::vector<std::int64_t> phases;
  for (const std::int64_t time : first) phases.push_back(modulo(time, period));
  // The first cut after which every camera has a frame within one period.
  const std::int64_t after = *std::max_element(first.begin(), first.end()) - period;
  cut_ns_ = after + 1 + modulo(largest(gaps_between(phases, period)).middle - after - 1, period);
  for (Camera& camera : cameras_)
    while (!camera.pending.empty() && camera.pending.front().beat_ns < *cut_ns_) {
      camera.pending.pop_front();
      ++camera.early;
    }
  return true;
}

std::int64_t SetMatcher::end_of_set() const {
  if (options_.trigger_window_ns == 0) return next_cut(*cut_ns_ + period_ns());
  std::int64_t oldest = INT64_MAX;
  for (const Camera& camera : cameras_)
    if (!camera.pending.empty()) oldest = std::min(oldest, camera.pending.front().beat_ns);
  return oldest == INT64_MAX ? *cut_ns_ : oldest + options_.trigger_window_ns;
}

/// Moves the end of a set to the middle of the gap that it lies in, or of the largest.
std::int64_t SetMatcher::next_cut(std::int64_t end_ns) const {
  const std::int64_t period = period_ns();
  std::vector<std::int64_t> phases;
  for (const Camera& camera : cameras_)
    if (camera.live && camera.last_ns) phases.push_back(modulo(camera.last_beat_ns - end_ns, period));
  if (phases.empty()) return end_ns;
  const std::vector<Gap> gaps = gaps_between(phases, period);
  const Gap best = largest(gaps);
  const auto distance = [&](const Gap& gap) { return std::min(gap.middle, period - gap.middle); };
  Gap chosen = best;
  for (const Gap& gap : gaps)
    if (distance(gap) <= gap.width / 2 && gap.width >= best.width / 4) chosen = gap;
  return end_ns + (chosen.middle > period / 2 ? chosen.middle - period : chosen.middle);
}

bool SetMatcher::finished(std::int64_t end_ns, std::int64_t now_ns) const {
  if (now_ns > end_ns + options_.patience_ns) return true;
  const std::int64_t needed = options_.trigger_window_ns > 0 ? INT64_MIN : *cut_ns_;
  for (const Camera& camera : cameras_)
    if (camera.live && (camera.pending.empty() || camera.pending.back().beat_ns < needed)) return false;
  return true;
}

std::optional<TimedFrame> SetMatcher::pick(Camera& camera, std::int64_t begin_ns, std::int64_t end_ns) {
  const std::int64_t middle = begin_ns + (end_ns - begin_ns) / 2;
  std::optional<TimedFrame> best;
  while (!camera.pending.empty() && camera.pending.front().beat_ns < end_ns) {
    TimedFrame frame = std::move(camera.pending.front());
    camera.pending.pop_front();
    if (best) ++camera.unmatched;
    if (!best || std::abs(frame.beat_ns - middle) < std::abs(best->beat_ns - middle)) best = std::move(frame);
  }
  return best;
}

std::optional<MatchedSet> SetMatcher::take(std::int64_t now_ns, bool flush) {
  if (!cut_ns_ && !begin(now_ns, flush)) return std::nullopt;
  const bool anything = std::any_of(cameras_.begin(), cameras_.end(),
                                    [](const Camera& camera) { return !camera.pending.empty(); });
  while (anything) {
    const std::int64_t end = end_of_set();
    if (!flush && !finished(end, now_ns)) return std::nullopt;
    MatchedSet set;
    bool empty = true;
    for (Camera& camera : cameras_) {
      set.frames.push_back(pick(camera, *cut_ns_, end));
      empty &= !set.frames.back();
    }
    cut_ns_ = end;
    if (!empty) return set;  // a period in which no camera delivered is no set
  }
  return std::nullopt;
}

}  // namespace stuv
