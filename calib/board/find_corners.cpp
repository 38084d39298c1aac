#include "calib/board/find_corners.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <mutex>
#include <opencv2/core/utility.hpp>
#include <optional>

#include "calib/board/detect.h"
#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"
#include "core/json.h"
#include "core/parallel.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

constexpr const char* kFormat = "stuv.corners";
constexpr int kVersion = 1;

/// What is known of one frame.
struct Sighting {
  int width = 0, height = 0;
  std::vector<Eigen::Vector2d> corners;
};

/// Which picture corners belong to.
struct Stamp {
  std::uintmax_t bytes = 0;
  std::int64_t changed = 0;
};

Stamp stamp_of(const fs::path& file) {
  std::error_code ec;
  Stamp stamp;
  stamp.bytes = fs::file_size(file, ec);
  if (ec) throw Error(file.string(), ec.message(), "record again, or put the picture back");
  stamp.changed = fs::last_write_time(file, ec).time_since_epoch().count();
  return stamp;
}

fs::path kept_file(const Recording& recording, const Board& board, int set, int camera) {
  std::string folder = board_spec(board);
  std::replace(folder.begin(), folder.end(), ':', '_');
  return recording.folder / "corners" / folder / recording.sets[set].name /
         (recording.cameras[camera].name + ".json");
}

/// Nothing if the file is absent, damaged or about another picture: then the board is looked for again.
std::optional<Sighting> recall(const fs::path& file, const Stamp& stamp, const Board& board) {
  std::error_code ec;
  if (!fs::exists(file, ec)) return std::nullopt;
  try {
    const Json json = read_manifest(file, kFormat, kVersion);
    if (json.at("detector") != kDetectorVersion || json.at("picture").at("bytes") != stamp.bytes ||
        json["picture"].at("changed") != stamp.changed)
      return std::nullopt;
    Sighting sighting{json["picture"].at("size_px").at(0), json["picture"]["size_px"].at(1), {}};
    for (const Json& c : json.at("corners_px")) sighting.corners.emplace_back(c.at(0), c.at(1));
    const bool whole = sighting.corners.size() == static_cast<std::size_t>(board.corners());
    if (!whole && !sighting.corners.empty()) return std::nullopt;
    return sighting;
  } catch (const std::exception&) {
    return std::nullopt;
  }
}

void keep(const fs::path& file, const Stamp& stamp, const Board& board, const Sighting& sighting) {
  Json corners = Json::array();
  for (const Eigen::Vector2d& c : sighting.corners) corners.push_back({c.x(), c.y()});
  fs::create_directories(file.parent_path());
  write_json(
      file,
      {{"format", kFormat},
       {"version", kVersion},
       {"board", board_spec(board)},
       {"detector", kDetectorVersion},
       {"picture",
        {{"bytes", stamp.bytes}, {"changed", stamp.changed}, {"size_px", {sighting.width, sighting.height}}}},
       {"found", !sighting.corners.empty()},
       {"corners_px", corners}});
}

Sighting look(const fs::path& file, const Board& board) {
  const Image picture = read_image(file);
  return {picture.width, picture.height, detect_board(picture, board)};
}

/// OpenCV's own threads are off while frames run in parallel.
class OneOpenCvThread {
 public:
  OneOpenCvThread() : before_(cv::getNumThreads()) { cv::setNumThreads(1); }
  ~OneOpenCvThread() { cv::setNumThreads(before_); }
  OneOpenCvThread(const OneOpenCvThread&) = delete;
  OneOpenCvThread& operator=(const OneOpenCvThread&) = delete;

 private:
  int before_;
};

struct Place {
  int set = 0, camera = 0;
};

std::vector<Place> good_frames(const Recording& recording) {
  std::vector<Place> places;
  for (std::size_t s = 0; s < recording.sets.size(); ++s)
    for (std::size_t c = 0; c < recording.cameras.size(); ++c)
      if (recording.sets[s].frames[c].status == FrameStatus::ok)
        places.push_back({static_cast<int>(s), static_cast<int>(c)});
  return places;
}

void note_size(const Recording& recording, const Place& place, const Sighting& sighting,
               FoundCorners& found) {
  Eigen::Vector2i& size = found.size_px[place.camera];
  const Eigen::Vector2i now(sighting.width, sighting.height);
  if (size.isZero()) size = now;
  if (size != now)
    throw Error(recording.sets[place.set].frames[place.camera].file.string(),
                fmt::format("is {}x{}, other pictures of camera {} are {}x{}", now.x(), now.y(),
                            recording.cameras[place.camera].name, size.x(), size.y()),
                "record all sets at one size");
}

}  // namespace

FoundCorners find_corners(const Recording& recording, const Board& board, const Reporter& reporter) {
  const std::vector<Place> places = good_frames(recording);
  std::vector<Sighting> sightings(places.size());
  std::atomic<int> remembered = 0;
  std::mutex mutex;
  std::size_t done = 0;
  bool keeps = true;

  const OneOpenCvThread one_thread;
  parallel_for(static_cast<int>(places.size()), [&](int i) {
    const auto [set, camera] = places[i];
    const fs::path& file = recording.sets[set].frames[camera].file;
    const fs::path kept = kept_file(recording, board, set, camera);
    const Stamp stamp = stamp_of(file);
    bool is_new = false;
    if (auto known = recall(kept, stamp, board)) {
      sightings[i] = std::move(*known);
      ++remembered;
    } else {
      sightings[i] = look(file, board);
      is_new = true;
    }
    const std::lock_guard lock(mutex);
    if (is_new && keeps) {
      try {
        keep(kept, stamp, board, sightings[i]);
      } catch (const std::exception& e) {
        keeps = false;
        reporter.warn(fmt::format("corners are not kept with the recording: {}", e.what()));
      }
    }
    reporter.at("looking for boards", ++done, places.size());
  });

  FoundCorners found;
  found.pictures = static_cast<int>(places.size());
  found.remembered = remembered;
  found.size_px.assign(recording.cameras.size(), Eigen::Vector2i::Zero());
  found.corners.assign(recording.sets.size(), {});
  for (auto& set : found.corners) set.resize(recording.cameras.size());
  for (std::size_t i = 0; i < places.size(); ++i) {
    note_size(recording, places[i], sightings[i], found);
    if (!sightings[i].corners.empty()) ++found.boards;
    found.corners[places[i].set][places[i].camera] = std::move(sightings[i].corners);
  }
  return found;
}

}  // namespace stuv
