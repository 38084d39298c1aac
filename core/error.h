#pragma once

#include <stdexcept>
#include <string>

namespace stuv {

/// A device, file or configuration failed. what() is one line: "SUBJECT: PROBLEM; REMEDY".
/// Numerical failure is never thrown: it is part of a result.
class Error : public std::runtime_error {
 public:
  /// subject: the path, device or setting; remedy: what the user can do now.
  Error(const std::string& subject, const std::string& problem, const std::string& remedy);
};

}  // namespace stuv
