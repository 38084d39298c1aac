#pragma once

#include <sys/wait.h>
#include <catch2/catch.hpp>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "core/files.h"

namespace stuv::test {

/// ../shared/data beside the checkout, or STUV_SHARED_DATA; empty if there is none.
inline std::filesystem::path shared_data() {
  if (const char* set = std::getenv("STUV_SHARED_DATA")) return set;
  const auto path = std::filesystem::path(STUV_SOURCE_DIR).parent_path() / "shared" / "data";
  return std::filesystem::is_directory(path) ? path : std::filesystem::path();
}

/// A fresh folder that goes away with the test.
class TempFolder {
 public:
  TempFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "stuv-test-XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) throw std::runtime_error("no temporary folder");
    path_ = name;
  }
  ~TempFolder() {
    std::error_code ec;
    std::filesystem::remove_all(path_, ec);
  }
  TempFolder(const TempFolder&) = delete;
  TempFolder& operator=(const TempFolder&) = delete;
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

struct ProgramResult {
  int exit_code = -1;
  std::string out, err;
};

/// Runs the built program with a command line in shell syntax.
inline ProgramResult run_stuv(const std::string& arguments) {
  const TempFolder folder;
  const std::string line = std::string(STUV_PROGRAM) + " " + arguments + " >" + (folder / "out").string() +
                           " 2>" + (folder / "err").string() + " </dev/null";
  const int status = std::system(line.c_str());
  return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), read_text(folder / "out"),
          read_text(folder / "err")};
}

/// Number of lines of a program's stderr.
inline int line_count(const std::string& text) {
  return static_cast<int>(std::count(text.begin(), text.end(), '\n'));
}

}  // namespace stuv::test

/// Catch2 2.13 has no SKIP(): CTest counts a test as skipped when it prints this word (tests/CMakeLists.txt).
#define STUV_SKIP(why)                 \
  do {                                 \
    std::printf("SKIPPED: %s\n", why); \
    SUCCEED("skipped");                \
    return;                            \
  } while (false)

/// The folder of real data as `name`, or the test is skipped.
#define STUV_NEED_SHARED_DATA(name)                             \
  const std::filesystem::path name = stuv::test::shared_data(); \
  if (name.empty()) STUV_SKIP("no ../shared/data beside the checkout")
