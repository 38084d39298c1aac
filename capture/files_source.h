#pragma once

#include <memory>
#include <string>
#include <vector>

#include "capture/source.h"
#include "core/progress.h"

namespace stuv {

struct FilesOptions {
  /// Path with {set} and {camera}, in folders or file names, each for one or more characters but '/';
  /// absolute, or relative to `base`. Without {set} there is one set, named "0". A name that comes again must
  /// match the same text.
  std::string pattern;
  std::filesystem::path base;  ///< empty: the working directory
  int rows = 0, cols = 0;
  /// Camera of each place, row by row, "" for an empty place; empty list: cameras fill the places in natural
  /// order of their names.
  std::vector<std::string> names;
  bool copy = false;      ///< copy pictures into the recording instead of referring to them
  bool complete = false;  ///< an incomplete set is an Error
  int every = 1;          ///< of all sets (or frames of videos) the first and every n-th after it
};

/// Pictures that lie on disk, as a source; or videos, one a camera, where the pattern ends like a video's
/// name (video_source.h) and has no {set}.
///
/// Opens by finding all files of the pattern and decoding every one, in parallel, so that a recording is
/// never begun with a picture that cannot be read. Throws Error naming the file, camera or set: nothing
/// matches; a picture is damaged or truncated; size or channels of a camera change between sets; a camera has
/// no picture at all; there are more or fewer cameras than places; `complete` and an incomplete set.
std::unique_ptr<Source> open_files(const FilesOptions& options, const Reporter& reporter = {});

}  // namespace stuv
