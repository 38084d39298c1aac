#include "app/console.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <mutex>

#include "core/files.h"

namespace stuv {
namespace {

/// Draws at most ten times a second; a stage shorter than a second leaves no trace.
class ProgressPrinter {
 public:
  void at(std::string_view stage, std::size_t done, std::size_t total) {
    if (total == 0) return;  // nobody knows how much it will be
    const std::lock_guard lock(mutex_);
    const auto now = std::chrono::steady_clock::now();
    if (stage != stage_) {
      stage_ = stage;
      begin_ = now;
      shown_ = begin_;
      drawn_ = false;
    }
    const bool last = done >= total;
    if (terminal_) {
      const bool due =
          now - begin_ > std::chrono::seconds(1) && now - shown_ > std::chrono::milliseconds(100);
      if (due || (last && drawn_)) draw(done, total, last);
      if (due) shown_ = now;
    } else if (now - shown_ > std::chrono::seconds(10) || (last && now - begin_ > std::chrono::seconds(1))) {
      fmt::print(stderr, "{}: {} of {}\n", stage_, done, total);
      shown_ = now;
    }
  }

  void warn(std::string_view line) {
    const std::lock_guard lock(mutex_);
    fmt::print(stderr, "{}warning: {}\n", drawn_ ? "\n" : "", line);
    drawn_ = false;
  }

 private:
  void draw(std::size_t done, std::size_t total, bool last) {
    constexpr std::size_t width = 30;
    const std::size_t filled = total > 0 ? std::min(width, width * done / total) : width;
    fmt::print(stderr, "\r{:<28} [{:#<{}}{:.<{}}] {}/{}{}", stage_, "", filled, "", width - filled, done,
               total, last ? "\n" : "");
    std::fflush(stderr);
    drawn_ = !last;
  }

  const bool terminal_ = ::isatty(STDERR_FILENO) != 0;
  bool drawn_ = false;
  std::string stage_;
  std::chrono::steady_clock::time_point begin_, shown_;
  std::mutex mutex_;
};

template <class T>
bool parse_number(std::string_view text, T& value) {
  if (!text.empty() && text.front() == '+') text.remove_prefix(1);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() && !text.empty();
}

}  // namespace

void add_common_flags(CLI::App& command, CommonFlags& flags) {
  command.add_flag("--force", flags.force, "Replace outputs that exist");
  command.add_option("--json", flags.json_file, "Write the whole result to this file")->type_name("FILE");
  // Before any work, not after it.
  command.parse_complete_callback([&flags] {
    if (!flags.json_file.empty()) check_output(flags.json_file, flags.force);
  });
}

void write_result(const CommonFlags& flags, const Json& result) {
  if (!flags.json_file.empty()) write_json(flags.json_file, result);
}

Reporter console_reporter() {
  auto printer = std::make_shared<ProgressPrinter>();
  return {[printer](std::string_view stage, std::size_t done, std::size_t total) {
            printer->at(stage, done, total);
          },
          [printer](std::string_view line) { printer->warn(line); }};
}

std::pair<double, double> parse_pair(const std::string& flag, const std::string& text) {
  const std::size_t comma = text.find(',');
  double a = 0, b = 0;
  if (comma == std::string::npos || !parse_number(std::string_view(text).substr(0, comma), a) ||
      !parse_number(std::string_view(text).substr(comma + 1), b) || std::isnan(a) || std::isnan(b))
    throw UsageError(fmt::format("{} wants two numbers A,B, not '{}'", flag, text));
  return {a, b};
}

std::pair<double, double> parse_disparity(const std::string& text) {
  const auto range = parse_pair("--disparity", text);
  if (!(range.first <= range.second) || !std::isfinite(range.first) || !std::isfinite(range.second))
    throw UsageError("--disparity wants finite MIN,MAX with MIN <= MAX (larger is nearer)");
  return range;
}

std::pair<int, int> parse_size(const std::string& flag, const std::string& text) {
  const std::size_t x = text.find('x');
  int a = 0, b = 0;
  if (x == std::string::npos || !parse_number(std::string_view(text).substr(0, x), a) ||
      !parse_number(std::string_view(text).substr(x + 1), b) || a <= 0 || b <= 0)
    throw UsageError(fmt::format("{} wants two whole numbers AxB above 0, not '{}'", flag, text));
  return {a, b};
}

Camera parse_camera(const std::string& text) {
  const std::size_t comma = text.find(',');
  if (comma == std::string::npos || std::filesystem::exists(text)) return read_cameramodel(text);
  Camera camera;
  camera.name = text;
  std::tie(camera.width, camera.height) = parse_size("--camera", text.substr(0, comma));
  for (const std::string& part : parse_list("--camera", text.substr(comma + 1))) {
    double value = 0;
    if (!parse_number(part, value) || !std::isfinite(value))
      throw UsageError(fmt::format("--camera: '{}' is no number", part));
    camera.intrinsics.push_back(value);
  }
  if (camera.intrinsics.size() != 4 || !(camera.intrinsics[0] > 0) || !(camera.intrinsics[1] > 0))
    throw UsageError("--camera wants a .cameramodel or WxH,fx,fy,cx,cy with fx, fy > 0");
  return camera;
}

std::vector<std::string> parse_list(const std::string& flag, const std::string& text) {
  std::vector<std::string> parts;
  std::size_t begin = 0;
  while (true) {
    const std::size_t end = std::min(text.find(',', begin), text.size());
    if (end == begin) throw UsageError(fmt::format("{} wants a list a,b,c, not '{}'", flag, text));
    parts.push_back(text.substr(begin, end - begin));
    if (end == text.size()) return parts;
    begin = end + 1;
  }
}

namespace {

constexpr std::pair<const char*, bool Skips::*> kSkips[] = {
    {"empty-planes", &Skips::empty_planes},   {"tile-planes", &Skips::tile_planes},
    {"flat-tiles", &Skips::flat_tiles},       {"tile-margins", &Skips::tile_margins},
    {"colour-costs", &Skips::colour_costs},   {"idle-cameras", &Skips::idle_cameras},
    {"second-filter", &Skips::second_filter}, {"unread-tiles", &Skips::unread_tiles},
    {"previous-view", &Skips::previous_view}};

}  // namespace

std::string skip_names() {
  std::string names;
  for (const auto& [name, member] : kSkips) names += (names.empty() ? "" : ", ") + std::string(name);
  return names;
}

Skips parse_skips(const std::string& text) {
  Skips skips;
  if (text.empty()) return skips;
  for (const std::string& part : parse_list("--no-skip", text)) {
    const auto* found = std::find_if(std::begin(kSkips), std::end(kSkips),
                                     [&](const auto& entry) { return part == entry.first; });
    if (found == std::end(kSkips))
      throw UsageError(fmt::format("--no-skip: there is no '{}'; {}", part, skip_names()));
    skips.*(found->second) = false;
  }
  return skips;
}

void check_name(const std::string& flag, const std::filesystem::path& file,
                const std::vector<std::string>& extensions) {
  if (file.empty()) return;
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  if (std::find(extensions.begin(), extensions.end(), extension) == extensions.end())
    throw UsageError(fmt::format("{} {}: name it {}", flag, file.string(), fmt::join(extensions, ", ")));
}

}  // namespace stuv
