#pragma once

#include <cstddef>
#include <functional>
#include <string_view>

namespace stuv {

/// How a library tells its caller what it is doing; it prints nothing itself. Calls may come from any
/// thread, one at a time. An empty function is allowed everywhere.
struct Reporter {
  std::function<void(std::string_view stage, std::size_t done, std::size_t total)> progress;
  std::function<void(std::string_view line)> warning;

  void at(std::string_view stage, std::size_t done, std::size_t total) const {
    if (progress) progress(stage, done, total);
  }
  void warn(std::string_view line) const {
    if (warning) warning(line);
  }
};

}  // namespace stuv
