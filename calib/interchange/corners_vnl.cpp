#include "calib/interchange/corners_vnl.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <map>
#include <sstream>

#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kSigmaOfOne_px = 0.1;  // deviation of a corner of weight 1

std::vector<std::string> words_of(const std::string& line) {
  std::istringstream in(line);
  std::vector<std::string> words;
  for (std::string word; in >> word;) words.push_back(word);
  return words;
}

enum class Fourth { none, level, weight };

class Reader {
 public:
  explicit Reader(const fs::path& file) : file_(file.string()), in_(read_text(file)) {}

  std::vector<PictureCorners> read(int corners) {
    std::string line;
    for (number_ = 1; std::getline(in_, line); ++number_) {
      const std::size_t comment = line.find('#');
      // The first comment that is not "##" or "#!" names the columns.
      if (comment == 0 && !has_header_ && line.rfind("##", 0) != 0 && line.rfind("#!", 0) != 0)
        read_header(words_of(line.substr(1)));
      const std::vector<std::string> words = words_of(line.substr(0, comment));
      if (!words.empty()) read_line(words);
    }
    if (!has_header_) fail("has no line '# filename x y level'");
    for (PictureCorners& p : pictures_) finish(p, corners);
    return std::move(pictures_);
  }

 private:
  [[noreturn]] void fail(const std::string& problem) const {
    throw Error(fmt::format("{}:{}", file_, number_), problem, "this is no corners.vnl of mrcal's");
  }

  void read_header(const std::vector<std::string>& names) {
    if (names.size() < 3 || names[0] != "filename" || names[1] != "x" || names[2] != "y")
      fail("does not open with '# filename x y level'");
    if (names.size() > 3 && names[3] == "level") fourth_ = Fourth::level;
    if (names.size() > 3 && names[3] == "weight") fourth_ = Fourth::weight;
    columns_ = names.size();
    has_header_ = true;
  }

  double number(const std::string& text) const {
    if (text == "-") return kNaN;
    double value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc() || end != text.data() + text.size())
      fail(fmt::format("'{}' is no number", text));
    return value;
  }

  double weight_of(const std::vector<std::string>& words) const {
    if (fourth_ == Fourth::none) return 1;
    if (words.size() < 4) fail("has no " + std::string(fourth_ == Fourth::level ? "level" : "weight"));
    const double value = number(words[3]);
    if (std::isnan(value)) return 0;
    if (fourth_ == Fourth::weight) return std::max(0.0, value);
    return value < 0 ? 0 : std::exp2(-value);
  }

  void read_line(const std::vector<std::string>& words) {
    if (!has_header_) fail("comes before the names of the columns, '# filename x y level'");
    if (words.size() < 3 || words.size() > std::max<std::size_t>(columns_, 4))
      fail("has the wrong number of columns");
    const auto [entry, fresh] = index_.try_emplace(words[0], pictures_.size());
    if (fresh) pictures_.push_back({words[0], {}, {}});
    PictureCorners& picture = pictures_[entry->second];
    const Eigen::Vector2d at(number(words[1]), number(words[2]));
    if (at.hasNaN() && words.size() == 3) {
      picture.corners_px.push_back(Eigen::Vector2d::Constant(kNaN));
      picture.weights.push_back(0);
      return;
    }
    const double weight = at.allFinite() ? weight_of(words) : 0;
    picture.corners_px.push_back(weight > 0 ? at : Eigen::Vector2d::Constant(kNaN));
    picture.weights.push_back(weight);
  }

  void finish(PictureCorners& picture, int corners) const {
    const bool any =
        std::any_of(picture.weights.begin(), picture.weights.end(), [](double w) { return w > 0; });
    if (!any) {
      picture.corners_px.clear();
      picture.weights.clear();
      return;
    }
    if (static_cast<int>(picture.corners_px.size()) != corners)
      throw Error(file_,
                  fmt::format("has {} corners of {}, the board has {}", picture.corners_px.size(),
                              picture.picture, corners),
                  "name the board that it was made with: --board");
  }

  std::string file_;
  std::istringstream in_;
  int number_ = 0;
  bool has_header_ = false;
  std::size_t columns_ = 0;
  Fourth fourth_ = Fourth::none;
  std::vector<PictureCorners> pictures_;
  std::map<std::string, std::size_t> index_;
};

/// Whether the path's last parts are all those of `end`.
bool ends_with(const fs::path& path, const fs::path& end) {
  auto p = path.end(), e = end.end();
  while (e != end.begin()) {
    --e;
    if (*e == "." || *e == "/") continue;
    if (p == path.begin() || *--p != *e) return false;
  }
  return true;
}

std::string picture_path(const Recording& recording, const Frame& frame) {
  std::error_code ec;
  const fs::path below = fs::relative(frame.file, recording.folder, ec);
  if (ec || below.empty() || *below.begin() == "..") return frame.file.string();
  return below.string();
}

/// The file has weights only: one is the inverse of a deviation, of which the solve takes ratios.
BoardView view_of(const PictureCorners& picture) {
  BoardView view;
  view.corners_px = picture.corners_px;
  for (const double weight : picture.weights)
    view.sigma_px.push_back(weight > 0 ? kSigmaOfOne_px / weight : kNaN);
  return view;
}

}  // namespace

std::vector<PictureCorners> read_corners_vnl(const fs::path& file, int corners) {
  return Reader(file).read(corners);
}

void write_corners_vnl(const fs::path& file, const std::vector<PictureCorners>& pictures) {
  std::string text = "# filename x y weight\n";
  for (const PictureCorners& p : pictures) {
    if (p.picture.find_first_of(" \t#") != std::string::npos)
      throw Error(p.picture, "has a blank or # in its name, which corners.vnl cannot hold",
                  "rename the picture");
    if (p.corners_px.empty()) text += fmt::format("{} - - -\n", p.picture);
    for (std::size_t k = 0; k < p.corners_px.size(); ++k) {
      if (p.corners_px[k].allFinite() && p.weights[k] > 0)
        text +=
            fmt::format("{} {} {} {}\n", p.picture, p.corners_px[k].x(), p.corners_px[k].y(), p.weights[k]);
      else
        text += fmt::format("{} 0 0 -\n", p.picture);
    }
  }
  write_text(file, text);
}

std::vector<FramePlace> places_of(const std::vector<PictureCorners>& pictures, const Recording& recording,
                                  const std::string& file) {
  std::vector<FramePlace> places(pictures.size());
  bool any = false;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const fs::path picture = fs::path(pictures[i].picture).lexically_normal();
    for (std::size_t s = 0; s < recording.sets.size(); ++s)
      for (std::size_t c = 0; c < recording.cameras.size(); ++c) {
        if (!ends_with(recording.sets[s].frames[c].file, picture)) continue;
        if (places[i].set >= 0)
          throw Error(file, fmt::format("{} is the name of several pictures", pictures[i].picture),
                      "write paths that tell them apart, sets/SET/CAMERA.png");
        places[i] = {static_cast<int>(s), static_cast<int>(c)};
        any = true;
      }
  }
  if (!any)
    throw Error(file, fmt::format("names no picture of {}", recording.folder.string()),
                "its paths must end like those of the recording's pictures, sets/SET/CAMERA.png");
  return places;
}

std::vector<PictureCorners> picture_corners(const Recording& recording, const FoundCorners& found) {
  const double usual_sigma_px = median_sigma_px(found);
  std::vector<PictureCorners> pictures;
  for (std::size_t s = 0; s < recording.sets.size(); ++s)
    for (std::size_t c = 0; c < recording.cameras.size(); ++c) {
      const Frame& frame = recording.sets[s].frames[c];
      if (frame.status != FrameStatus::ok) continue;
      const BoardView& view = found.views[s][c];
      pictures.push_back(
          {picture_path(recording, frame), view.corners_px, corner_weights(view, usual_sigma_px)});
    }
  return pictures;
}

FoundCorners read_found_corners(const fs::path& file, const Board& board, const Recording& recording,
                                int& unused) {
  const std::vector<PictureCorners> pictures = read_corners_vnl(file, board.corners());
  const std::vector<FramePlace> places = places_of(pictures, recording, file.string());
  FoundCorners found;
  found.views.assign(recording.sets.size(), std::vector<BoardView>(recording.cameras.size()));
  found.size_px.assign(recording.cameras.size(), Eigen::Vector2i::Zero());
  unused = 0;
  for (std::size_t i = 0; i < pictures.size(); ++i) {
    const auto [set, camera] = places[i];
    if (set < 0) {
      ++unused;
      continue;
    }
    ++found.pictures;
    if (pictures[i].corners_px.empty()) continue;
    ++found.boards;
    found.views[set][camera] = view_of(pictures[i]);
    if (!found.size_px[camera].isZero()) continue;
    const ImageInfo info = read_image_info(recording.sets[set].frames[camera].file);
    found.size_px[camera] = {info.width, info.height};
  }
  return found;
}

}  // namespace stuv
