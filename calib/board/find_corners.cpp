#include "calib/board/find_corners.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <mutex>
#include <opencv2/core/utility.hpp>
#include <optional>

#include "calib/board/detect.h"
#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"
#include "core/json.h"
#include "core/median.h"
#include "core/parallel.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

constexpr const char* kFormat = "stuv.corners";
constexpr int kVersion = 2;

/// What is known of one frame.
struct Sighting {
  int width = 0, height = 0;
  BoardView view;
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
  for (char& c : folder)
    if (c == ':' || c == '/') c = '_';
  return recording.folder / "corners" / folder / recording.sets[set].name /
         (recording.cameras[camera].name + ".json");
}

/// Lines of point, x, y, sigma; throws if one cannot be.
BoardView view_from(const Json& corners, const Board& board) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  BoardView view;
  if (corners.empty()) return view;
  view.corners_px.assign(static_cast<std::size_t>(board.corners()), {kNaN, kNaN});
  view.sigma_px.assign(view.corners_px.size(), kNaN);
  for (const Json& c : corners) {
    const std::size_t point = c.at(0);
    view.corners_px.at(point) = Eigen::Vector2d(c.at(1).get<double>(), c.at(2).get<double>());
    view.sigma_px.at(point) = c.at(3);
  }
  return view;
}

Json to_json(const BoardView& view) {
  Json corners = Json::array();
  for (std::size_t i = 0; i < view.corners_px.size(); ++i)
    if (view.corners_px[i].allFinite())
      corners.push_back({i, view.corners_px[i].x(), view.corners_px[i].y(), view.sigma_px[i]});
  return corners;
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
    return Sighting{json["picture"]["size_px"].at(0), json["picture"]["size_px"].at(1),
                    view_from(json.at("corners"), board)};
  } catch (const std::exception&) {
    return std::nullopt;
  }
}

void keep(const fs::path& file, const Stamp& stamp, const Board& board, const Sighting& sighting) {
  fs::create_directories(file.parent_path());
  write_json(
      file,
      {{"format", kFormat},
       {"version", kVersion},
       {"board", board_spec(board)},
       {"detector", kDetectorVersion},
       {"picture",
        {{"bytes", stamp.bytes}, {"changed", stamp.changed}, {"size_px", {sighting.width, sighting.height}}}},
       {"found", !sighting.view.empty()},
       {"corners", to_json(sighting.view)}});
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
  found.views.assign(recording.sets.size(), {});
  for (auto& set : found.views) set.resize(recording.cameras.size());
  for (std::size_t i = 0; i < places.size(); ++i) {
    note_size(recording, places[i], sightings[i], found);
    if (!sightings[i].view.empty()) ++found.boards;
    found.views[places[i].set][places[i].camera] = std::move(sightings[i].view);
  }
  return found;
}

std::vector<double> corner_weights(const BoardView& view, double sigma_ref_px) {
  std::vector<double> weights;
  const double usual = std::hypot(sigma_ref_px, kSolveFloorPx);
  for (const double sigma : view.sigma_px)
    weights.push_back(std::isfinite(sigma) ? usual / std::hypot(sigma, kSolveFloorPx) : 0);
  return weights;
}

double median_sigma_px(const FoundCorners& found) {
  std::vector<double> all;
  for (const auto& set : found.views)
    for (const BoardView& view : set)
      for (const double sigma : view.sigma_px)
        if (std::isfinite(sigma)) all.push_back(sigma);
  return all.empty() ? kCornerFloorPx : median(std::move(all));
}

}  // namespace stuv
