#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>

namespace stuv {

/// The whole file as text. Throws Error if it cannot be read.
std::string read_text(const std::filesystem::path& file);

/// Writes beside the file and renames: the file is there whole or as it was before. Synced to disk.
void write_text(const std::filesystem::path& file, std::string_view text);

/// Writes a file that does not exist yet, in two parts, straight to its name and without waiting for the
/// disk: for files in a folder that itself appears whole.
void write_new_file(const std::filesystem::path& file, std::span<const std::byte> first,
                    std::span<const std::byte> second = {});

/// Throws Error if `path` exists and `force` is false, or if its parent folder cannot be written to.
/// Commands call it before they start working.
void check_output(const std::filesystem::path& path, bool force);

/// Asks the system to bring a file or folder to the disk now; quietly does nothing where that is not
/// possible.
void sync_to_disk(const std::filesystem::path& path);

/// A folder (or file) that appears whole or not at all: work in path(), then commit() puts it in the place of
/// `target`. What was not committed is removed by the destructor. With `force`, a folder in its place is
/// replaced only if it is empty or holds a manifest of ours.
class AtomicOutput {
 public:
  enum class Kind { folder, file };
  AtomicOutput(const std::filesystem::path& target, Kind kind, bool force);
  ~AtomicOutput();
  AtomicOutput(const AtomicOutput&) = delete;
  AtomicOutput& operator=(const AtomicOutput&) = delete;

  /// Where to write: beside the target, with the same extension.
  const std::filesystem::path& path() const { return work_; }
  void commit();

 private:
  std::filesystem::path target_, work_;
  bool force_ = false, committed_ = false;
};

/// Sorts "cam2" before "cam10".
bool natural_less(std::string_view a, std::string_view b);

}  // namespace stuv
