#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

#include "core/image.h"
#include "core/json.h"
#include "core/raw_frame.h"
#include "core/recording.h"

namespace stuv {

/// A picture that exists as a file: recorded by its path, or copied into the recording.
struct FileFrame {
  std::filesystem::path file;
  bool copy = false;
};

/// Bytes as the device delivered them, in its memory.
struct RawFrame {
  std::span<const std::byte> bytes;
  std::shared_ptr<const void> hold;  ///< keeps them there
  RawFormat format;                  ///< or MJPG
  std::string record = "raw";        ///< unchanged (a .raw file or, of MJPG, a .jpg); or as "png", "tif"
};

/// What one camera delivered for one set. The content is valid with status ok only.
struct SourceFrame {
  FrameStatus status = FrameStatus::missing;
  std::variant<std::monostate, Image, FileFrame, RawFrame> content;
  std::int64_t sequence = -1;
  std::int64_t timestamp_ns = -1;
  std::string problem;  ///< with status error
};

struct SourceSet {
  std::string name;
  std::vector<SourceFrame> frames;  ///< one per camera, in the order of Source::cameras()
};

/// Something that delivers frame sets: drivers, files, the synthetic rig.
class Source {
 public:
  virtual ~Source() = default;

  virtual int rows() const = 0;
  virtual int cols() const = 0;
  virtual const std::vector<RecordedCamera>& cameras() const = 0;
  /// What it is and with which settings, for recording.json.
  virtual Json description() const = 0;
  /// Number of sets it will deliver; none: it goes on until it is stopped.
  virtual std::optional<std::size_t> set_count() const { return std::nullopt; }

  /// Whether it goes on whether or not its sets are taken: then they must be stored quickly.
  virtual bool live() const { return false; }

  /// The next set; none when there are no more. A failed frame is a status, a failed device is an Error.
  virtual std::optional<SourceSet> next() = 0;

  /// What became of every frame, once it is over; null: there is nothing to tell.
  virtual Json report() { return nullptr; }

  /// Writes what else is known of the set that next() delivered last (the synthetic rig's truth) into the
  /// recording's folder. Called before the set becomes visible.
  virtual void write_extras(const std::filesystem::path& /*recording*/) {}
};

}  // namespace stuv
