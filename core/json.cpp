#include "core/json.h"

#include <fmt/format.h>

#include "core/error.h"
#include "core/files.h"

namespace stuv {

Json read_json(const std::filesystem::path& file) {
  const std::string text = read_text(file);
  try {
    return Json::parse(text);
  } catch (const Json::parse_error& e) {
    throw Error(file.string(), fmt::format("is damaged JSON at byte {}", e.byte),
                "make it again, or restore a copy");
  }
}

Json read_manifest(const std::filesystem::path& file, const std::string& format, int version) {
  Json json = read_json(file);
  if (!json.is_object() || !json.contains("format") || json["format"] != format)
    throw Error(file.string(), fmt::format("is not a {} file", format), "check that it is the right folder");
  if (!json.contains("version") || !json["version"].is_number_integer() ||
      json["version"].get<long long>() < 1)
    throw Error(file.string(), "has no valid version number", "make it again");
  const long long found = json["version"].get<long long>();
  if (found > version)
    throw Error(file.string(),
                fmt::format("has version {}, this stuv {} reads up to {}", found, STUV_VERSION, version),
                "use a newer stuv");
  return json;
}

void write_json(const std::filesystem::path& file, const Json& json) {
  std::string text;
  try {
    text = json.dump(1) + "\n";
  } catch (const Json::type_error&) {
    throw Error(file.string(), "cannot hold a name that is not UTF-8",
                "rename the files or folders concerned");
  }
  write_text(file, text);
}

Json to_json(const Pose& pose) {
  const Eigen::Vector3d r = vector_from_rotation(pose.R);
  return {{"r", {r.x(), r.y(), r.z()}}, {"t", {pose.t.x(), pose.t.y(), pose.t.z()}}};
}

Pose pose_from_json(const Json& json) {
  const auto vector = [](const Json& v) { return Eigen::Vector3d(v.at(0), v.at(1), v.at(2)); };
  return {rotation_from_vector(vector(json.at("r"))), vector(json.at("t"))};
}

}  // namespace stuv
