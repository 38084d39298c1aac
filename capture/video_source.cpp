#include "capture/video_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <opencv2/videoio.hpp>

#include "core/error.h"
#include "core/parallel.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

/// OpenCV's BGR or grey.
Image image_of(const cv::Mat& frame) {
  Image image;
  image.width = frame.cols;
  image.height = frame.rows;
  image.channels = frame.channels() == 1 ? 1 : 3;
  const std::size_t row_bytes =
      static_cast<std::size_t>(frame.cols) * static_cast<std::size_t>(image.channels);
  image.bytes.resize(row_bytes * static_cast<std::size_t>(frame.rows));
  for (int y = 0; y < frame.rows; ++y) {
    auto* out =
        reinterpret_cast<unsigned char*>(image.bytes.data()) + static_cast<std::size_t>(y) * row_bytes;
    std::memcpy(out, frame.ptr(y), row_bytes);
    for (std::size_t x = 0; image.channels == 3 && x < row_bytes; x += 3) std::swap(out[x], out[x + 2]);
  }
  return image;
}

/// One file, read from front to back.
class Video {
 public:
  explicit Video(fs::path file) : file_(std::move(file)) {
    // Backends write to the log what the error below says.
    if (!capture_.open(file_.string(), cv::CAP_FFMPEG))
      throw Error(file_.string(), "cannot be opened as a video",
                  "check the file, or take its frames as pictures");
  }

  const fs::path& file() const { return file_; }
  long frame_count() const { return std::lround(capture_.get(cv::CAP_PROP_FRAME_COUNT)); }

  /// Passes over `skip` frames and reads the next; missing at the end.
  SourceFrame read(int skip, std::int64_t number) {
    SourceFrame frame;
    for (int i = 0; i < skip && !ended_; ++i) ended_ = !capture_.grab();
    cv::Mat pixels;
    if (ended_ || !capture_.read(pixels) || pixels.depth() != CV_8U) {
      ended_ = true;
      return frame;
    }
    frame.status = FrameStatus::ok;
    frame.content = image_of(pixels);
    frame.sequence = number;
    frame.timestamp_ns = std::llround(1e6 * capture_.get(cv::CAP_PROP_POS_MSEC));
    return frame;
  }

 private:
  fs::path file_;
  cv::VideoCapture capture_;
  bool ended_ = false;
};

class VideoSource final : public Source {
 public:
  VideoSource(VideoFilesOptions options, const Reporter& reporter) : options_(std::move(options)) {
    for (const fs::path& file : options_.files) videos_.emplace_back(file);
    for (const Video& video : videos_)
      if (video.frame_count() != videos_.front().frame_count())
        reporter.warn(
            fmt::format("{} has {} frames, {} has {}: frames are matched by their number, so check that the "
                        "videos begin together",
                        video.file().string(), video.frame_count(), videos_.front().file().string(),
                        videos_.front().frame_count()));
    upcoming_ = read_set();
    for (std::size_t i = 0; i < videos_.size(); ++i)
      if (upcoming_.frames[i].status != FrameStatus::ok)
        throw Error(videos_[i].file().string(), "holds no frame that can be decoded", "check the file");
  }

  int rows() const override { return options_.rows; }
  int cols() const override { return options_.cols; }
  const std::vector<RecordedCamera>& cameras() const override { return options_.cameras; }
  Json description() const override {
    Json files = Json::array();
    for (const fs::path& file : options_.files) files.push_back(file.string());
    return {{"kind", "videos"}, {"files", files}, {"every", options_.every}};
  }

  std::optional<SourceSet> next() override {
    const bool over =
        std::all_of(upcoming_.frames.begin(), upcoming_.frames.end(),
                    [](const SourceFrame& frame) { return frame.status == FrameStatus::missing; });
    if (over) return std::nullopt;
    SourceSet set = std::move(upcoming_);
    upcoming_ = read_set();
    return set;
  }

 private:
  SourceSet read_set() {
    SourceSet set{fmt::format("{:06}", number_), std::vector<SourceFrame>(videos_.size())};
    const int skip = number_ == 0 ? 0 : options_.every - 1;
    parallel_for(static_cast<int>(videos_.size()), [&](int index) {
      const auto i = static_cast<std::size_t>(index);
      set.frames[i] = videos_[i].read(skip, number_);
    });
    number_ += options_.every;
    return set;
  }

  VideoFilesOptions options_;
  std::vector<Video> videos_;
  std::int64_t number_ = 0;
  SourceSet upcoming_;
};

}  // namespace

bool is_video(const fs::path& file) {
  constexpr std::array kExtensions = {".mp4", ".avi", ".mov", ".mkv", ".m4v", ".webm", ".mpg"};
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return std::find(kExtensions.begin(), kExtensions.end(), extension) != kExtensions.end();
}

std::unique_ptr<Source> open_videos(const VideoFilesOptions& options, const Reporter& reporter) {
  return std::make_unique<VideoSource>(options, reporter);
}

}  // namespace stuv
