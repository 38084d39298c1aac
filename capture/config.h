#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <variant>

#include "capture/cameras/camera_source.h"
#include "capture/files_source.h"
#include "capture/synthetic/synthetic_source.h"

namespace stuv {

/// What a TOML file says about where frames come from; see configs/ for one example a kind.
using CaptureConfig = std::variant<synthetic::SyntheticOptions, FilesOptions, CameraSourceOptions>;

/// Reads a config. Throws Error naming file, line and key: no TOML, an unknown key, a wrong type, or a value
/// with the constraint it breaks. Patterns of files are relative to the working directory.
CaptureConfig parse_capture_config(std::string_view text, const std::string& name);
CaptureConfig read_capture_config(const std::filesystem::path& file);

/// configs/synthetic-5x5.toml as it was when the program was built.
CaptureConfig default_capture_config();

/// `stop` and `status` are for cameras only: see open_cameras.
std::unique_ptr<Source> open_source(const CaptureConfig& config, const Reporter& reporter = {},
                                    const std::atomic<bool>* stop = nullptr, StatusFunction status = {});

}  // namespace stuv
