#pragma once

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <optional>
#include <string>

namespace stuv::test {

/// An X server without a screen, for as long as this lives. It picks its number itself (-displayfd), so that
/// tests can run side by side.
class VirtualDisplay {
 public:
  VirtualDisplay() {
    int ends[2];
    if (::pipe(ends) != 0) return;
    server_ = ::fork();
    if (server_ == 0) {
      ::prctl(PR_SET_PDEATHSIG, SIGKILL);
      const int quiet = ::open("/dev/null", O_RDWR);
      for (const int stream : {0, 1, 2}) ::dup2(quiet, stream);
      const std::string end = std::to_string(ends[1]);
      ::execlp("Xvfb", "Xvfb", "-displayfd", end.c_str(), "-screen", "0", "1600x1000x24", "-nolisten", "tcp",
               nullptr);
      ::_exit(127);
    }
    ::close(ends[1]);
    char c = 0;
    while (::read(ends[0], &c, 1) == 1 && c != '\n') number_ += c;
    ::close(ends[0]);
  }
  ~VirtualDisplay() {
    if (server_ <= 0) return;
    ::kill(server_, SIGTERM);
    ::waitpid(server_, nullptr, 0);
  }
  VirtualDisplay(const VirtualDisplay&) = delete;
  VirtualDisplay& operator=(const VirtualDisplay&) = delete;

  /// What a command line begins with to be shown here; empty where no server starts.
  std::optional<std::string> prefix() const {
    if (number_.empty()) return {};
    return "env -u WAYLAND_DISPLAY DISPLAY=:" + number_ + " ";
  }

 private:
  pid_t server_ = -1;
  std::string number_;
};

}  // namespace stuv::test
