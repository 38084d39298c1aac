#include "core/files.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/uio.h>
#include <unistd.h>

#include <atomic>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <fstream>
#include <sstream>
#include <system_error>

#include "core/error.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

/// Hidden, unique to this process, and with the same extension: image writers choose the format by it.
fs::path beside(const fs::path& target) {
  static std::atomic<unsigned> counter{0};
  const std::string name = fmt::format(".{}.{}.{}.partial{}", target.stem().string(), ::getpid(), counter++,
                                       target.extension().string());
  return target.parent_path() / name;
}

fs::path without_trailing_slash(const fs::path& path) {
  return path.has_filename() ? path : path.parent_path();
}

/// --force is meant for what this program made, not for whatever folder a slip of the keyboard names.
void require_replaceable(const fs::path& folder) {
  std::error_code ec;
  if (!fs::exists(folder, ec)) return;
  for (const char* manifest : {"recording.json", "rig.json", "lightfield.json", "keyframes.json",
                               "overlay.json", "two_view.json", "export.json"})
    if (fs::exists(folder / manifest, ec)) return;
  if (fs::is_directory(folder, ec) && fs::is_empty(folder, ec)) return;
  throw Error(folder.string(), "exists and was not made by stuv",
              "choose another name; --force replaces folders of stuv's only");
}

[[noreturn]] void throw_write_error(const fs::path& file, int error) {
  throw Error(
      file.string(), fmt::format("cannot be written: {}", std::strerror(error)),
      error == ENOSPC ? "free some space or choose another disk" : "check the folder and its permissions");
}

}  // namespace

std::string read_text(const fs::path& file) {
  std::error_code ec;
  if (fs::is_directory(file, ec))
    throw Error(file.string(), "is a folder, not a file", "name the file in it");
  std::ifstream in(file, std::ios::binary);
  if (!in)
    throw Error(file.string(), fmt::format("cannot be read: {}", std::strerror(errno)), "check the path");
  std::ostringstream text;
  text << in.rdbuf();
  return std::move(text).str();
}

void write_text(const fs::path& file, std::string_view text) {
  const fs::path work = beside(file);
  const int fd = ::open(work.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (fd < 0) throw_write_error(file, errno);
  int error = 0;
  for (std::size_t done = 0; done < text.size() && error == 0;) {
    const ssize_t n = ::write(fd, text.data() + done, text.size() - done);
    if (n > 0) done += static_cast<std::size_t>(n);
    if (n < 0 && errno != EINTR) error = errno;
  }
  if (error == 0 && ::fsync(fd) != 0 && errno != EINVAL) error = errno;
  if (::close(fd) != 0 && error == 0) error = errno;
  if (error == 0 && ::rename(work.c_str(), file.c_str()) != 0) error = errno;
  if (error != 0) {
    ::unlink(work.c_str());
    throw_write_error(file, error);
  }
}

void write_new_file(const fs::path& file, std::span<const std::byte> first,
                    std::span<const std::byte> second) {
  const int fd = ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (fd < 0) throw_write_error(file, errno);
  int error = 0;
  while (first.size() + second.size() > 0 && error == 0) {
    const iovec parts[] = {{const_cast<std::byte*>(first.data()), first.size()},
                           {const_cast<std::byte*>(second.data()), second.size()}};
    const ssize_t n = ::writev(fd, parts, 2);
    if (n < 0 && errno != EINTR) error = errno;
    const std::size_t written = n > 0 ? static_cast<std::size_t>(n) : 0,
                      of_first = std::min(written, first.size());
    first = first.subspan(of_first);
    second = second.subspan(written - of_first);
  }
  if (::close(fd) != 0 && error == 0) error = errno;
  if (error != 0) throw_write_error(file, error);
}

void check_output(const fs::path& path, bool force) {
  const fs::path target = without_trailing_slash(path);
  std::error_code ec;
  if (fs::exists(target, ec) && !force)
    throw Error(target.string(), "exists already", "choose another name, or --force to replace it");
  const fs::path parent = target.has_parent_path() ? target.parent_path() : fs::path(".");
  if (!fs::is_directory(parent, ec)) throw Error(parent.string(), "is no folder", "create it first");
  // Root passes access() on a read-only file system, so try the real thing.
  const fs::path probe = beside(parent / "probe");
  const int fd = ::open(probe.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (fd < 0) throw_write_error(target, errno);
  ::close(fd);
  ::unlink(probe.c_str());
}

void sync_to_disk(const fs::path& path) {
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (fd < 0) return;
  ::fsync(fd);
  ::close(fd);
}

AtomicOutput::AtomicOutput(const fs::path& target, Kind kind, bool force)
    : target_(without_trailing_slash(target)), force_(force) {
  check_output(target_, force);
  if (kind == Kind::folder) require_replaceable(target_);
  work_ = beside(target_);
  if (kind != Kind::folder) return;
  std::error_code ec;
  if (!fs::create_directory(work_, ec)) throw_write_error(target_, ec.value());
}

AtomicOutput::~AtomicOutput() {
  std::error_code ec;
  if (!committed_) fs::remove_all(work_, ec);
}

void AtomicOutput::commit() {
  sync_to_disk(work_);
  std::error_code ec;
  fs::path old;
  // rename() replaces a file by itself but not a folder that holds something.
  if (force_ && fs::is_directory(target_, ec)) {
    old = beside(target_);
    fs::rename(target_, old, ec);
    if (ec) throw_write_error(target_, ec.value());
  }
  fs::rename(work_, target_, ec);
  if (ec) {
    std::error_code ignored;
    if (!old.empty()) fs::rename(old, target_, ignored);
    throw_write_error(target_, ec.value());
  }
  committed_ = true;
  sync_to_disk(target_.has_parent_path() ? target_.parent_path() : fs::path("."));
  if (!old.empty()) fs::remove_all(old, ec);
}

bool natural_less(std::string_view a, std::string_view b) {
  const auto is_digit = [](char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; };
  const auto digits = [&](std::string_view text, std::size_t i) {
    std::size_t end = i;
    while (end < text.size() && is_digit(text[end])) ++end;
    return text.substr(i, end - i);
  };
  const auto significant = [](std::string_view number) {
    return number.substr(std::min(number.find_first_not_of('0'), number.size()));
  };
  std::size_t i = 0, j = 0;
  while (i < a.size() && j < b.size()) {
    if (is_digit(a[i]) && is_digit(b[j])) {
      const std::string_view run_a = digits(a, i), run_b = digits(b, j);
      const std::string_view na = significant(run_a), nb = significant(run_b);
      if (na.size() != nb.size()) return na.size() < nb.size();
      if (na != nb) return na < nb;
      i += run_a.size();
      j += run_b.size();
    } else {
      if (a[i] != b[j]) return a[i] < b[j];
      ++i;
      ++j;
    }
  }
  if (i < a.size() || j < b.size()) return i >= a.size();
  return a < b;  // "cam01" and "cam1" are different names: keep the order strict
}

}  // namespace stuv
