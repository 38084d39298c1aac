#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "capture/source.h"
#include "core/progress.h"

namespace stuv {

struct VideoFilesOptions {
  int rows = 0, cols = 0;
  std::vector<RecordedCamera> cameras;
  std::vector<std::filesystem::path> files;  ///< one a camera
  int every = 1;                             ///< frames 0, every, 2 every, ...
};

/// Whether the name ends like a video's: mp4, avi, mov, mkv, m4v, webm, mpg.
bool is_video(const std::filesystem::path& file);

/// Videos of cameras that ran in step, as a source: frame n of all files is one set, named by n. Timestamps
/// are those of the files. A file that ends before the others lacks in the sets that follow; a warning names
/// files whose numbers of frames differ.
///
/// Decoded by OpenCV's videoio, cameras in parallel. Throws Error naming the file if it cannot be opened or
/// holds no frame.
std::unique_ptr<Source> open_videos(const VideoFilesOptions& options, const Reporter& reporter = {});

}  // namespace stuv
