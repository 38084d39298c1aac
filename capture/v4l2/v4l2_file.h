#pragma once

#include <string>
#include <utility>

namespace stuv {

/// An open device file; ioctl() is repeated when a signal interrupts it.
class V4l2File {
 public:
  explicit V4l2File(const std::string& device);  ///< fd() is -1, with errno, if it cannot be opened
  ~V4l2File();
  V4l2File(V4l2File&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  V4l2File(const V4l2File&) = delete;
  V4l2File& operator=(const V4l2File&) = delete;

  int fd() const { return fd_; }
  /// 0, or errno.
  int control(unsigned long request, void* argument) const;

 private:
  int fd_ = -1;
};

std::string fourcc_text(unsigned code);
unsigned fourcc_code(const std::string& text);

}  // namespace stuv
