#include "capture/files_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <exception>
#include <map>
#include <mutex>
#include <regex>
#include <set>

#include "capture/video_source.h"
#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"
#include "core/parallel.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

struct NaturalLess {
  bool operator()(const std::string& a, const std::string& b) const { return natural_less(a, b); }
};

using CameraFiles = std::map<std::string, fs::path, NaturalLess>;
using SetFiles = std::map<std::string, CameraFiles, NaturalLess>;

/// A pattern as the folder that its matches lie under and a regular expression for the path below it.
struct PathPattern {
  fs::path root;
  std::regex expression;
  int set_group = 0, camera_group = 0;  ///< 0: not in the pattern
  int depth = 1;                        ///< folders and file name below the root
};

std::string escaped(char c) {
  static const std::string special = R"(.^$|()[]{}*+?\)";
  return special.find(c) == std::string::npos ? std::string(1, c) : std::string("\\") + c;
}

/// Appends the group for {set} or {camera}: a capture the first time, a back reference after that.
void append_group(std::string& text, int& group, int& groups) {
  if (group > 0) {
    text += fmt::format("(?:\\{})", group);
    return;
  }
  group = ++groups;
  text += "([^/]+)";
}

PathPattern compile(const FilesOptions& options) {
  const std::string full = ((options.base.empty() ? fs::current_path() : options.base) / options.pattern)
                               .lexically_normal()
                               .string();
  const std::size_t brace = std::min(full.find("{set}"), full.find("{camera}"));
  if (full.find("{camera}") == std::string::npos)
    throw Error(options.pattern, "has no {camera}", "write e.g. 'set{set}_cam{camera}.png'");
  const std::size_t slash = full.rfind('/', brace);
  PathPattern pattern;
  pattern.root = slash == 0 ? "/" : full.substr(0, slash);
  std::string text;
  int groups = 0;
  for (std::size_t i = slash + 1; i < full.size();) {
    if (full.compare(i, 5, "{set}") == 0) {
      append_group(text, pattern.set_group, groups);
      i += 5;
    } else if (full.compare(i, 8, "{camera}") == 0) {
      append_group(text, pattern.camera_group, groups);
      i += 8;
    } else {
      pattern.depth += full[i] == '/' ? 1 : 0;
      text += escaped(full[i++]);
    }
  }
  pattern.expression = std::regex(text);
  return pattern;
}

/// All files exactly `depth` levels below `folder`, hidden ones left out.
void list_files(const fs::path& folder, int depth, std::vector<fs::path>& files) {
  std::error_code ec;
  for (const auto& entry : fs::directory_iterator(folder, ec)) {
    if (entry.path().filename().string().front() == '.') continue;
    if (depth > 1 && entry.is_directory(ec)) list_files(entry.path(), depth - 1, files);
    if (depth == 1 && !entry.is_directory(ec)) files.push_back(entry.path());
  }
}

SetFiles find_matches(const FilesOptions& options) {
  const PathPattern pattern = compile(options);
  std::error_code ec;
  if (!fs::is_directory(pattern.root, ec))
    throw Error(pattern.root.string(), "is no folder", "check the path of the pattern");
  std::vector<fs::path> files;
  list_files(pattern.root, pattern.depth, files);
  SetFiles found;
  for (const fs::path& file : files) {
    const std::string below = file.lexically_relative(pattern.root).string();
    std::smatch match;
    if (!std::regex_match(below, match, pattern.expression)) continue;
    const std::string set =
        pattern.set_group > 0 ? match[static_cast<std::size_t>(pattern.set_group)].str() : "0";
    // As names of folders and files in the recording: a set's must not be hidden.
    if (set.front() == '.') continue;
    found[set][match[static_cast<std::size_t>(pattern.camera_group)].str()] = file;
  }
  if (found.empty())
    throw Error(options.pattern, "matches no file", "check the path and where {set} and {camera} stand");
  return found;
}

std::set<std::string, NaturalLess> camera_names(const SetFiles& sets) {
  std::set<std::string, NaturalLess> names;
  for (const auto& [set, files] : sets)
    for (const auto& [camera, file] : files) names.insert(camera);
  return names;
}

/// The names as numbers; empty if one is none.
std::set<int> as_numbers(const std::set<std::string, NaturalLess>& names) {
  std::set<int> numbers;
  for (const std::string& name : names) {
    int number = 0;
    const auto [end, error] = std::from_chars(name.data(), name.data() + name.size(), number);
    if (error != std::errc() || end != name.data() + name.size()) return {};
    numbers.insert(number);
  }
  return numbers;
}

/// Names that a numbering such as 01, 02, 04 leaves out: of 1 .. places or 0 .. places - 1 if all lie there,
/// else between the first and the last. Empty if the names are no numbers.
std::vector<std::string> gaps(const std::set<std::string, NaturalLess>& names, int places) {
  const std::set<int> numbers = as_numbers(names);
  if (numbers.empty()) return {};
  int first = *numbers.begin(), last = *numbers.rbegin();
  if (first >= 1 && last <= places)
    first = 1, last = places;
  else if (first >= 0 && last < places)
    first = 0, last = places - 1;
  const bool padded = names.begin()->size() > 1 && names.begin()->front() == '0';
  const std::size_t width = padded ? names.begin()->size() : 1;
  constexpr std::size_t kMost = 100;
  std::vector<std::string> missing;
  for (int n = first; n <= last && missing.size() < kMost; ++n)
    if (!numbers.contains(n)) missing.push_back(fmt::format("{:0{}}", n, width));
  return missing;
}

[[noreturn]] void throw_wrong_count(const FilesOptions& options,
                                    const std::set<std::string, NaturalLess>& names) {
  const int places = options.rows * options.cols;
  std::string problem = fmt::format("{} camera{} found for the {} places of a {}x{} grid", names.size(),
                                    names.size() == 1 ? "" : "s", places, options.rows, options.cols);
  if (names.size() > static_cast<std::size_t>(places))
    throw Error(options.pattern, problem, "use a larger grid, or list the wanted names in a config");
  const std::vector<std::string> missing = gaps(names, places);
  problem += missing.empty() ? fmt::format(", namely {}", fmt::join(names, ", "))
                             : fmt::format(", without any picture: {}", fmt::join(missing, ", "));
  throw Error(options.pattern, problem,
              "add the pictures, or list the names in a config with \"\" for empty places");
}

std::vector<RecordedCamera> place_cameras(const FilesOptions& options, const SetFiles& sets) {
  const std::set<std::string, NaturalLess> found = camera_names(sets);
  std::vector<std::string> names = options.names;
  const auto places = static_cast<std::size_t>(options.rows) * static_cast<std::size_t>(options.cols);
  if (names.empty()) {
    if (found.size() != places) throw_wrong_count(options, found);
    names.assign(found.begin(), found.end());
  }
  if (names.size() != places)
    throw Error(options.pattern,
                fmt::format("{} names are listed for the {} places of a {}x{} grid", names.size(), places,
                            options.rows, options.cols),
                "list one name a place, \"\" for an empty one");
  std::vector<RecordedCamera> cameras;
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (names[i].empty()) continue;
    if (!found.contains(names[i]))
      throw Error(options.pattern, fmt::format("camera {} has no picture at all", names[i]),
                  "check its name, or give it \"\" for an empty place");
    const int place = static_cast<int>(i);
    cameras.push_back({names[i], place / options.cols, place % options.cols});
  }
  return cameras;
}

/// Decodes every picture and compares it with the first of its camera.
void check_pictures(const SetFiles& sets, const std::vector<RecordedCamera>& cameras,
                    const Reporter& reporter) {
  std::vector<const fs::path*> files;
  std::vector<std::size_t> first;  // the file to compare each with
  for (const RecordedCamera& camera : cameras) {
    const std::size_t begin = files.size();
    for (const auto& [name, of_set] : sets)
      if (const auto it = of_set.find(camera.name); it != of_set.end()) {
        files.push_back(&it->second);
        first.push_back(begin);
      }
  }
  std::vector<ImageInfo> infos(files.size());
  std::vector<std::exception_ptr> problems(files.size());
  std::mutex mutex;
  std::size_t done = 0;
  parallel_for(static_cast<int>(files.size()), [&](int index) {
    const auto i = static_cast<std::size_t>(index);
    try {
      const Image image = read_image(*files[i]);
      infos[i] = {image.width, image.height, image.channels, image.type};
    } catch (const Error&) {
      problems[i] = std::current_exception();
    }
    const std::lock_guard lock(mutex);
    reporter.at("checking pictures", ++done, files.size());
  });
  for (std::size_t i = 0; i < files.size(); ++i) {
    // The first of them, whichever thread came across it when.
    if (problems[i]) std::rethrow_exception(problems[i]);
    const ImageInfo &a = infos[i], &b = infos[first[i]];
    if (a.width == b.width && a.height == b.height && a.channels == b.channels) continue;
    throw Error(files[i]->string(),
                fmt::format("is {}x{} with {} channels, but {} of the same camera is {}x{} with {}", a.width,
                            a.height, a.channels, files[first[i]]->filename().string(), b.width, b.height,
                            b.channels),
                "make the pictures of one camera alike");
  }
}

void check_sets_complete(const FilesOptions& options, const SetFiles& sets,
                         const std::vector<RecordedCamera>& cameras) {
  for (const auto& [name, files] : sets) {
    std::vector<std::string> missing;
    for (const RecordedCamera& camera : cameras)
      if (!files.contains(camera.name)) missing.push_back(camera.name);
    if (missing.empty()) continue;
    throw Error(options.pattern,
                fmt::format("set {} is incomplete: no picture of camera {}", name, fmt::join(missing, ", ")),
                "leave --complete away to keep incomplete sets too");
  }
}

/// Leaves the first set and every n-th after it.
void thin_out(int every, SetFiles& sets) {
  int index = 0;
  std::erase_if(sets, [&](const auto&) { return index++ % every != 0; });
}

std::unique_ptr<Source> open_as_videos(const FilesOptions& options, const SetFiles& sets,
                                       const Reporter& reporter) {
  if (options.pattern.find("{set}") != std::string::npos)
    throw Error(options.pattern, "has a {set}, but a video holds all sets of its camera",
                "write the pattern with {camera} only");
  VideoFilesOptions videos{options.rows, options.cols, place_cameras(options, sets), {}, options.every};
  for (const RecordedCamera& camera : videos.cameras)
    videos.files.push_back(sets.begin()->second.at(camera.name));
  return open_videos(videos, reporter);
}

class FilesSource final : public Source {
 public:
  FilesSource(FilesOptions options, SetFiles sets, std::vector<RecordedCamera> cameras)
      : options_(std::move(options)),
        sets_(std::move(sets)),
        cameras_(std::move(cameras)),
        next_(sets_.begin()) {}

  int rows() const override { return options_.rows; }
  int cols() const override { return options_.cols; }
  const std::vector<RecordedCamera>& cameras() const override { return cameras_; }
  std::optional<std::size_t> set_count() const override { return sets_.size(); }
  Json description() const override {
    return {{"kind", "files"}, {"pattern", options_.pattern}, {"copied", options_.copy}};
  }

  std::optional<SourceSet> next() override {
    if (next_ == sets_.end()) return std::nullopt;
    const auto& [name, files] = *next_++;
    SourceSet set{name, std::vector<SourceFrame>(cameras_.size())};
    for (std::size_t i = 0; i < cameras_.size(); ++i) {
      const auto it = files.find(cameras_[i].name);
      if (it == files.end()) continue;
      set.frames[i].status = FrameStatus::ok;
      set.frames[i].content = FileFrame{it->second, options_.copy};
    }
    return set;
  }

 private:
  FilesOptions options_;
  SetFiles sets_;
  std::vector<RecordedCamera> cameras_;
  SetFiles::const_iterator next_;
};

}  // namespace

std::unique_ptr<Source> open_files(const FilesOptions& options, const Reporter& reporter) {
  if (options.rows <= 0 || options.cols <= 0)
    throw Error(options.pattern, fmt::format("has a grid of {}x{}", options.rows, options.cols),
                "give rows and columns above 0");
  if (options.every < 1)
    throw Error(options.pattern, fmt::format("is to be taken every {} sets", options.every),
                "give 1 or more");
  SetFiles sets = find_matches(options);
  if (is_video(options.pattern)) return open_as_videos(options, sets, reporter);
  thin_out(options.every, sets);
  std::vector<RecordedCamera> cameras = place_cameras(options, sets);
  if (options.complete) check_sets_complete(options, sets, cameras);
  check_pictures(sets, cameras, reporter);
  return std::make_unique<FilesSource>(options, std::move(sets), std::move(cameras));
}

}  // namespace stuv
