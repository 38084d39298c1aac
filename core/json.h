#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "core/pose.h"

namespace stuv {

using Json = nlohmann::ordered_json;

/// Every manifest of ours opens with "format" (e.g. "stuv.rig") and "version" (a whole number).
/// Throws Error if the file is no JSON, of another format, or of a version newer than `version`.
Json read_manifest(const std::filesystem::path& file, const std::string& format, int version);

/// Plain JSON with the file named in errors.
Json read_json(const std::filesystem::path& file);
/// Indented, Inf and NaN as null, whole or not at all.
void write_json(const std::filesystem::path& file, const Json& json);

/// {"r": [rotation vector, rad], "t": [m]}
Json to_json(const Pose& pose);
Pose pose_from_json(const Json& json);

}  // namespace stuv
