#include "core/error.h"

#include <algorithm>

namespace stuv {
namespace {

std::string one_line(std::string text) {
  std::replace(text.begin(), text.end(), '\n', ' ');
  while (!text.empty() && text.back() == ' ') text.pop_back();
  return text;
}

}  // namespace

Error::Error(const std::string& subject, const std::string& problem, const std::string& remedy)
    : std::runtime_error(one_line(subject + ": " + problem + (remedy.empty() ? "" : "; " + remedy))) {}

}  // namespace stuv
