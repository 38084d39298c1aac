#include "capture/capture.h"

#include <fmt/format.h>

#include <algorithm>
#include <set>

#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"
#include "core/parallel.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

constexpr std::size_t kNoLimit = static_cast<std::size_t>(-1);

void copy_picture(const fs::path& from, const fs::path& to) {
  std::error_code ec;
  fs::copy_file(from, to, ec);
  if (ec)
    throw Error(from.string(), fmt::format("cannot be copied to {}: {}", to.string(), ec.message()),
                "check the disk");
}

fs::path store_raw(const RawFrame& raw, const std::string& camera, const fs::path& folder) {
  const bool jpeg = raw.format.fourcc == "MJPG";
  if (raw.record != "raw") {
    const fs::path name = camera + "." + raw.record;
    write_image(folder / name, jpeg ? decode_jpeg(raw.bytes, (folder / name).string())
                                    : decode_raw(raw.format, raw.bytes, (folder / name).string()));
    return name;
  }
  const fs::path name = camera + (jpeg ? ".jpg" : ".raw");
  const auto header = raw_header(raw.format);
  write_new_file(folder / name, jpeg ? std::span<const std::byte>() : std::as_bytes(std::span(header)),
                 raw.bytes);
  return name;
}

/// Stores one frame's content in `folder` and returns what recording.json calls its file.
fs::path store(const SourceFrame& frame, const std::string& camera, const fs::path& folder) {
  if (const auto* image = std::get_if<Image>(&frame.content)) {
    fs::path name = camera + ".png";
    write_image(folder / name, *image);
    return name;
  }
  if (const auto* raw = std::get_if<RawFrame>(&frame.content)) return store_raw(*raw, camera, folder);
  if (const auto* file = std::get_if<FileFrame>(&frame.content)) {
    if (!file->copy) return fs::absolute(file->file).lexically_normal();
    fs::path name = camera + file->file.extension().string();
    copy_picture(file->file, folder / name);
    return name;
  }
  return {};
}

std::vector<std::string> cameras_without_frame(const SourceSet& set,
                                               const std::vector<RecordedCamera>& cameras) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < cameras.size(); ++i)
    if (set.frames[i].status != FrameStatus::ok) names.push_back(cameras[i].name);
  return names;
}

/// Warns of an incomplete set, or throws if sets must be complete. Returns whether it is complete.
bool check_complete(const SourceSet& set, const std::vector<RecordedCamera>& cameras, bool required,
                    bool live, const fs::path& folder, const Reporter& reporter) {
  const std::vector<std::string> names = cameras_without_frame(set, cameras);
  if (names.empty()) return true;
  const std::string problem =
      fmt::format("set {} is incomplete: no good frame of camera {}", set.name, fmt::join(names, ", "));
  if (required) throw Error(folder.string(), problem, "leave --complete away to keep incomplete sets too");
  if (!live) reporter.warn(problem);  // a live rig has a line for each camera, and its report
  return false;
}

FrameSet store_set(const SourceSet& set, const std::vector<RecordedCamera>& cameras, const fs::path& folder) {
  FrameSet stored{set.name, std::vector<Frame>(cameras.size())};
  const auto store_one = [&](int index) {
    const auto i = static_cast<std::size_t>(index);
    const SourceFrame& from = set.frames[i];
    Frame& to = stored.frames[i];
    to = {from.status, {}, from.sequence, from.timestamp_ns, from.problem};
    if (from.status != FrameStatus::missing) to.file = store(from, cameras[i].name, folder);
  };
  const bool as_they_are = std::all_of(set.frames.begin(), set.frames.end(), [](const SourceFrame& frame) {
    const auto* raw = std::get_if<RawFrame>(&frame.content);
    return raw != nullptr ? raw->record == "raw" : frame.status != FrameStatus::ok;
  });
  // Bytes go to one disk: threads would only cost.
  const int count = static_cast<int>(cameras.size());
  if (as_they_are)
    for (int i = 0; i < count; ++i) store_one(i);
  else
    parallel_for(count, store_one);
  return stored;
}

/// Stores sets until there are no more, or `limit` of them.
void record(Source& source, const fs::path& folder, const CaptureOptions& options, const Reporter& reporter,
            std::size_t limit, std::optional<RecordingWriter>& writer, CaptureResult& result) {
  const std::vector<RecordedCamera>& cameras = source.cameras();
  std::set<std::string> names;
  while (result.sets < limit) {
    reporter.at("capturing sets", result.sets, limit == kNoLimit ? 0 : limit);
    const std::optional<SourceSet> set = source.next();
    if (!set) break;
    if (!names.insert(set->name).second)
      throw Error(folder.string(), fmt::format("set {} comes twice", set->name),
                  "give every set its own name");
    if (!check_complete(*set, cameras, options.complete, source.live(), folder, reporter))
      ++result.incomplete_sets;
    if (!writer)
      writer.emplace(folder, source.rows(), source.cols(), cameras, source.description(), options.force);
    FrameSet stored = store_set(*set, cameras, writer->begin_set(set->name));
    source.write_extras(folder);
    writer->commit_set(stored, source.live() ? Durable::no : Durable::yes);
    ++result.sets;
    for (const Frame& frame : stored.frames) result.frames += frame.status == FrameStatus::ok ? 1 : 0;
  }
}

}  // namespace

CaptureResult capture(Source& source, const fs::path& folder, const CaptureOptions& options,
                      const Reporter& reporter) {
  check_output(folder, options.force);
  const std::size_t limit = std::min(options.sets.value_or(kNoLimit), source.set_count().value_or(kNoLimit));
  CaptureResult result;
  std::optional<RecordingWriter> writer;
  // However it ends: the report is worth having.
  const auto finish = [&] {
    result.report = source.report();
    if (writer && !result.report.is_null()) write_json(folder / "report.json", result.report);
  };
  try {
    record(source, folder, options, reporter, limit, writer, result);
  } catch (...) {
    try {
      finish();
    } catch (const Error&) {  // the disk may be full: the first error is the one to tell
    }
    throw;
  }
  finish();
  if (result.sets == 0) throw Error(folder.string(), "the source delivered no set", "check its settings");
  reporter.at("capturing sets", result.sets, result.sets);
  return result;
}

}  // namespace stuv
