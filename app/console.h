#pragma once

#include <CLI/CLI.hpp>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "core/camera.h"
#include "core/json.h"
#include "core/progress.h"
#include "core/view.h"

namespace stuv {

/// Exit codes of every command.
enum ExitCode { kDone = 0, kFailed = 1, kWrongUsage = 2, kVerdictNotGood = 3 };

/// A combination of flags that makes no sense: printed in one line, exit code 2.
class UsageError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Flags that every command that writes has.
struct CommonFlags {
  bool force = false;
  std::filesystem::path json_file;
};
void add_common_flags(CLI::App& command, CommonFlags& flags);
/// Writes `result` if --json was given.
void write_result(const CommonFlags& flags, const Json& result);

/// A progress bar on a terminal, plain lines otherwise; warnings as lines on stderr.
Reporter console_reporter();

/// "A,B" to two numbers, "ROWSxCOLS" or "WxH" to two whole numbers > 0. Throw UsageError naming the flag.
std::pair<double, double> parse_pair(const std::string& flag, const std::string& text);
std::pair<int, int> parse_size(const std::string& flag, const std::string& text);
/// --disparity MIN,MAX: finite, MIN <= MAX.
std::pair<double, double> parse_disparity(const std::string& text);
/// --camera: a .cameramodel or WxH,fx,fy,cx,cy.
Camera parse_camera(const std::string& text);
/// Bound of whole-number options (planes, views, pixels), so that help and errors stay readable.
inline constexpr int kMostCount = 100'000;
/// --no-skip: names of what `fast` is not to leave out (skip_names) switched off.
Skips parse_skips(const std::string& text);
std::string skip_names();
/// "a,b,c" to its parts; empty parts are an error of the flag.
std::vector<std::string> parse_list(const std::string& flag, const std::string& text);

/// Before any work: that a file of that name can hold what goes into it; an empty one is not asked for.
/// Throws UsageError.
void check_name(const std::string& flag, const std::filesystem::path& file,
                const std::vector<std::string>& extensions);

}  // namespace stuv
