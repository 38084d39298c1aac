#include "core/recording.h"

#include <fmt/format.h>

#include <algorithm>
#include <span>

#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

constexpr const char* kFormat = "stuv.recording";
constexpr int kVersion = 1;

const char* name_of(FrameStatus status) {
  switch (status) {
    case FrameStatus::ok:
      return "ok";
    case FrameStatus::missing:
      return "missing";
    case FrameStatus::error:
      return "error";
  }
  return "";
}

FrameStatus status_from(const std::string& name) {
  if (name == "ok") return FrameStatus::ok;
  return name == "error" ? FrameStatus::error : FrameStatus::missing;
}

Json set_to_json(const FrameSet& set, const std::vector<RecordedCamera>& cameras) {
  Json frames = Json::array();
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const Frame& frame = set.frames[i];
    Json json = {{"camera", cameras[i].name}, {"status", name_of(frame.status)}};
    if (!frame.file.empty()) json["file"] = frame.file.string();
    if (frame.sequence >= 0) json["sequence"] = frame.sequence;
    if (frame.timestamp_ns >= 0) json["timestamp_ns"] = frame.timestamp_ns;
    if (!frame.problem.empty()) json["problem"] = frame.problem;
    frames.push_back(std::move(json));
  }
  return {{"format", "stuv.set"},
          {"version", kVersion},
          {"name", set.name},
          {"complete", set.complete()},
          {"frames", frames}};
}

FrameSet read_set(const fs::path& folder, const Recording& recording) {
  const fs::path file = folder / "set.json";
  const Json json = read_manifest(file, "stuv.set", kVersion);
  FrameSet set;
  try {
    set.name = json.at("name");
    set.frames.resize(recording.cameras.size());
    for (const Json& entry : json.at("frames")) {
      const int camera = recording.camera_index(entry.at("camera"));
      if (camera < 0) continue;
      Frame& frame = set.frames[static_cast<std::size_t>(camera)];
      frame.status = status_from(entry.at("status"));
      // An absolute path stays as it is: path / absolute is the absolute one.
      if (entry.contains("file")) frame.file = fs::absolute(folder / entry["file"].get<std::string>());
      frame.sequence = entry.value("sequence", std::int64_t{-1});
      frame.timestamp_ns = entry.value("timestamp_ns", std::int64_t{-1});
      frame.problem = entry.value("problem", std::string());
    }
  } catch (const Json::exception&) {
    throw Error(file.string(), "lacks a field or has one of the wrong type",
                "remove this set's folder, the others stay readable");
  }
  return set;
}

}  // namespace

int Recording::camera_index(const std::string& name) const {
  const auto it =
      std::find_if(cameras.begin(), cameras.end(), [&](const RecordedCamera& c) { return c.name == name; });
  return it == cameras.end() ? -1 : static_cast<int>(it - cameras.begin());
}

int Recording::set_index(const std::string& name) const {
  const auto it = std::find_if(sets.begin(), sets.end(), [&](const FrameSet& s) { return s.name == name; });
  return it == sets.end() ? -1 : static_cast<int>(it - sets.begin());
}

Recording open_recording(const fs::path& folder) {
  const fs::path file = folder / "recording.json";
  const Json json = read_manifest(file, kFormat, kVersion);
  Recording recording;
  recording.folder = folder;
  try {
    recording.rows = json.at("rows");
    recording.cols = json.at("cols");
    recording.source = json.at("source");
    for (const Json& camera : json.at("cameras"))
      recording.cameras.push_back({camera.at("name"), camera.at("row"), camera.at("col")});
  } catch (const Json::exception&) {
    throw Error(file.string(), "lacks a field or has one of the wrong type", "record again");
  }
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(folder / "sets", ec)) {
    if (entry.path().filename().string().front() == '.') continue;  // was not finished
    recording.sets.push_back(read_set(entry.path(), recording));
  }
  std::sort(recording.sets.begin(), recording.sets.end(),
            [](const FrameSet& a, const FrameSet& b) { return natural_less(a.name, b.name); });
  return recording;
}

void require_complete(const Recording& recording, const FrameSet& set) {
  if (set.complete()) return;
  std::vector<std::string> missing;
  for (std::size_t i = 0; i < set.frames.size(); ++i)
    if (set.frames[i].status != FrameStatus::ok) missing.push_back(recording.cameras[i].name);
  throw Error(
      recording.folder.string(),
      fmt::format("set {} is incomplete: no good frame of camera {}", set.name, fmt::join(missing, ", ")),
      "leave --complete away to use incomplete sets too");
}

void require_complete(const Recording& recording) {
  for (const FrameSet& set : recording.sets) require_complete(recording, set);
}

RecordingWriter::RecordingWriter(const fs::path& folder, int rows, int cols,
                                 std::vector<RecordedCamera> cameras, const Json& source, bool force)
    : folder_(folder), cameras_(std::move(cameras)) {
  AtomicOutput output(folder, AtomicOutput::Kind::folder, force);
  Json list = Json::array();
  for (const RecordedCamera& camera : cameras_)
    list.push_back({{"name", camera.name}, {"row", camera.row}, {"col", camera.col}});
  write_json(output.path() / "recording.json", {{"format", kFormat},
                                                {"version", kVersion},
                                                {"program", std::string("stuv ") + STUV_VERSION},
                                                {"rows", rows},
                                                {"cols", cols},
                                                {"cameras", list},
                                                {"source", source}});
  fs::create_directory(output.path() / "sets");
  output.commit();
}

RecordingWriter::~RecordingWriter() {
  std::error_code ec;
  if (!open_set_.empty()) fs::remove_all(open_set_, ec);
}

fs::path RecordingWriter::begin_set(const std::string& name) {
  fs::path work = folder_ / "sets" / ("." + name + ".partial");
  std::error_code ec;
  fs::remove_all(work, ec);
  if (!fs::create_directory(work, ec))
    throw Error(work.string(), fmt::format("cannot be created: {}", ec.message()),
                "check the disk; finished sets stay readable");
  open_set_ = work;
  return work;
}

void RecordingWriter::commit_set(const FrameSet& set, Durable durable) {
  std::error_code ec;
  const Json json = set_to_json(set, cameras_);
  if (durable == Durable::yes) {
    for (const auto& entry : fs::directory_iterator(open_set_, ec)) sync_to_disk(entry.path());
    write_json(open_set_ / "set.json", json);
    sync_to_disk(open_set_);
  } else {
    const std::string text = json.dump() + "\n";
    write_new_file(open_set_ / "set.json", std::as_bytes(std::span(text)));
  }
  fs::rename(open_set_, folder_ / "sets" / set.name, ec);
  if (ec)
    throw Error((folder_ / "sets" / set.name).string(),
                fmt::format("cannot be put in place: {}", ec.message()), "check for a set of the same name");
  open_set_.clear();
  if (durable == Durable::yes) sync_to_disk(folder_ / "sets");
}

}  // namespace stuv
