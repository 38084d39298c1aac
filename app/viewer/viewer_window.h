#pragma once

#include <filesystem>

#include "app/viewer/view_controls.h"

namespace stuv {

struct ViewerRun {
  int frames = 0;                    ///< > 0: close after that many frames, the picture then being complete
  std::filesystem::path screenshot;  ///< the window's contents when it closes; empty: none
};

/// Opens the window and returns when it is closed. Throws Error if there is no display or no OpenGL, and
/// std::runtime_error if it closes by itself (`frames`) over a picture that could not be made.
void run_viewer(const LightFieldReader& reader, const ViewerState& start, const ViewerRun& run);

}  // namespace stuv
