#include "capture/cameras/explain.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "core/files.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

struct Advice {
  std::string problem, remedy;
};

Advice advice_for(int error, const std::string& what, const fs::path& device) {
  switch (error) {
    case ENOSPC:
      return {fmt::format("cannot {}: its USB controller has no bandwidth left (ENOSPC)", what),
              "run `stuv capture CONFIG --check`, which adds up the bandwidth and proposes sizes and rates "
              "that fit"};
    case EBUSY: {
      const std::string holders = holders_of(device);
      return {fmt::format("cannot {}: it is in use by {} (EBUSY)", what,
                          holders.empty() ? "another program" : holders),
              holders.empty() ? fmt::format("`sudo fuser -v {}` tells which; end it", device.string())
                              : "end that program"};
    }
    case EACCES:
    case EPERM:
      return {fmt::format("cannot {}: this user may not open it (EACCES)", what),
              "add the user to the group video (`sudo usermod -aG video $USER`) and log in again"};
    case ENODEV:
    case ENXIO:
    case ENOENT:
      return {fmt::format("cannot {}: it is gone, unplugged or reset ({})", what,
                          error == ENODEV ? "ENODEV" : "not there"),
              "check its plug and its hub's power; `stuv cameras` lists what is there"};
    case EPROTO:
      return {fmt::format("cannot {}: its USB transfers fail (EPROTO)", what),
              "use a shorter or better cable, another port, or a hub with its own power supply"};
    case EIO:
      return {fmt::format("cannot {}: the device reports a fatal error (EIO)", what),
              "unplug it and plug it in again; `dmesg` has the driver's own words"};
    case EINVAL:
      return {fmt::format("cannot {}: the driver refuses (EINVAL)", what),
              "compare format, size and rate with what `stuv cameras` lists"};
    case ENOMEM:
      return {fmt::format("cannot {}: no memory for its buffers (ENOMEM)", what),
              "ask for fewer buffers or smaller pictures"};
    default:
      return {fmt::format("cannot {}: {}", what, std::strerror(error)), "`dmesg` has the driver's own words"};
  }
}

bool is_number(const std::string& text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; });
}

bool has_open(const fs::path& process, const fs::path& device) {
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(process / "fd", ec))
    if (fs::read_symlink(entry.path(), ec) == device) return true;
  return false;
}

std::string name_of_process(const fs::path& process) {
  try {
    std::string name = read_text(process / "comm");
    return name.substr(0, name.find('\n'));
  } catch (const Error&) {
    return "?";  // has ended meanwhile
  }
}

}  // namespace

std::string holders_of(const fs::path& device, const fs::path& proc) {
  std::string holders;
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(proc, ec)) {
    const std::string pid = entry.path().filename().string();
    if (!is_number(pid) || pid == std::to_string(::getpid()) || !has_open(entry.path(), device)) continue;
    holders += fmt::format("{}pid {} ({})", holders.empty() ? "" : ", ", pid, name_of_process(entry.path()));
  }
  return holders;
}

Error camera_error(const std::string& camera, const fs::path& device, const std::string& what, int error) {
  const Advice advice = advice_for(error, what, device);
  return {fmt::format("camera {} ({})", camera, device.string()), advice.problem, advice.remedy};
}

}  // namespace stuv
