#pragma once

#include <filesystem>

#include "capture/source.h"
#include "core/progress.h"

namespace stuv {

struct CaptureOptions {
  std::optional<std::size_t> sets;  ///< stop after so many; none: as many as the source has
  bool complete = false;            ///< an incomplete set is an Error instead of a warning
  bool force = false;               ///< replace a recording that exists
};

struct CaptureResult {
  std::size_t sets = 0, incomplete_sets = 0;
  std::size_t frames = 0;  ///< with status ok
  Json report;             ///< Source::report, also in REC/report.json
};

/// Pulls sets from a source into the recording `folder`; the frames of a set are encoded in parallel.
///
/// The folder appears once the source has delivered its first set, so a source that cannot start leaves
/// nothing behind; after a later failure, or a crash, the sets finished so far stay readable. Throws Error on
/// what the source or the disk throws, if the source delivers no set at all, if set names repeat, and for
/// `complete` at the first incomplete set.
CaptureResult capture(Source& source, const std::filesystem::path& folder, const CaptureOptions& options,
                      const Reporter& reporter = {});

}  // namespace stuv
