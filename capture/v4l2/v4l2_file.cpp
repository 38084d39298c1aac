#include "capture/v4l2/v4l2_file.h"

#include <fcntl.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <cerrno>

namespace stuv {

V4l2File::V4l2File(const std::string& device)
    : fd_(::open(device.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC)) {}

V4l2File::~V4l2File() {
  if (fd_ >= 0) ::close(fd_);
}

int V4l2File::control(unsigned long request, void* argument) const {
  while (::ioctl(fd_, request, argument) != 0)
    if (errno != EINTR) return errno;
  return 0;
}

std::string fourcc_text(unsigned code) {
  std::string text(4, ' ');
  for (unsigned i = 0; i < 4; ++i) text[i] = static_cast<char>(code >> (8 * i) & 0x7F);
  return text;
}

unsigned fourcc_code(const std::string& text) {
  unsigned code = 0;
  for (unsigned i = 0; i < 4; ++i) {
    const char c = i < text.size() ? text[i] : ' ';
    code |= static_cast<unsigned>(static_cast<unsigned char>(c)) << (8 * i);
  }
  return code;
}

}  // namespace stuv
