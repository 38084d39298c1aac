#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "core/json.h"

namespace stuv {

// A recording is a folder:
//
//   REC/recording.json            cameras with their places in the grid, source, settings: written first
//   REC/sets/NAME/set.json        one frame set: per camera status, file, sequence number, timestamp
//   REC/sets/NAME/CAMERA.png      its frames, unless they are referenced where they lie
//   REC/corners/BOARD/SET/CAMERA.json   board corners found later, one file a frame
//   REC/truth/                    synthetic rigs only; no stage reads it
//
// A set is written under a hidden name and renamed, so it is there whole or not at all: after a crash at any
// moment the recording opens with the sets that were finished.

enum class FrameStatus {
  ok,       ///< file, and sequence and timestamp where the source has them
  missing,  ///< the source delivered none: `file` is empty
  error     ///< delivered, but flagged bad by the source: `problem` says how
};

struct Frame {
  FrameStatus status = FrameStatus::missing;
  std::filesystem::path file;  ///< absolute once opened
  std::int64_t sequence = -1;  ///< the source's own counter; gaps are dropped frames; -1: none
  std::int64_t timestamp_ns = -1;
  std::string problem;
};

struct FrameSet {
  std::string name;
  std::vector<Frame> frames;  ///< one per camera, in the order of Recording::cameras

  bool complete() const {
    for (const Frame& frame : frames)
      if (frame.status != FrameStatus::ok) return false;
    return true;
  }
};

struct RecordedCamera {
  std::string name;
  int row = 0, col = 0;  ///< as the user laid the grid out; calibration measures the real one
};

struct Recording {
  std::filesystem::path folder;
  int rows = 0, cols = 0;
  std::vector<RecordedCamera> cameras;
  std::vector<FrameSet> sets;  ///< in natural order of their names
  Json source;                 ///< what made it: kind, settings, program version

  int camera_index(const std::string& name) const;  ///< -1 if there is none
  int set_index(const std::string& name) const;     ///< -1 if there is none
};

/// Opens a recording; sets that are not whole are ignored. Throws Error if recording.json or a set.json is
/// damaged.
Recording open_recording(const std::filesystem::path& folder);

/// For --complete. Throw Error naming the (first) incomplete set and its missing cameras.
void require_complete(const Recording& recording, const FrameSet& set);
void require_complete(const Recording& recording);

/// Whether a set is brought to the disk before it is visible, so that it outlives a power failure as well as
/// the end of the process. Live cameras have no time for that: a set that lost its bytes so is recognised by
/// their number.
enum class Durable { yes, no };

/// Writes a recording set by set.
class RecordingWriter {
 public:
  /// Creates the folder with its manifest. Throws Error if it exists and `force` is false (see AtomicOutput).
  RecordingWriter(const std::filesystem::path& folder, int rows, int cols,
                  std::vector<RecordedCamera> cameras, const Json& source, bool force);
  ~RecordingWriter();

  /// A hidden folder for the frames of one set. Removed unless commit_set follows.
  std::filesystem::path begin_set(const std::string& name);
  /// Makes the set visible. Frame files are names inside begin_set's folder, or absolute paths (referenced).
  void commit_set(const FrameSet& set, Durable durable = Durable::yes);

  const std::filesystem::path& folder() const { return folder_; }

 private:
  std::filesystem::path folder_, open_set_;
  std::vector<RecordedCamera> cameras_;
};

}  // namespace stuv
