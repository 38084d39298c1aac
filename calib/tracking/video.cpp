#include "calib/tracking/video.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>
#include <string>

#include "core/error.h"

namespace stuv::tracking {
namespace {

bool try_open(cv::VideoCapture& video, const std::filesystem::path& file) {
  try {
    return video.open(file.string(), cv::CAP_FFMPEG);
  } catch (const cv::Exception&) {
    return false;
  }
}

}  // namespace

bool is_video_name(const std::filesystem::path& file) {
  std::string extension = file.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  const std::array<const char*, 8> known = {".mp4", ".avi", ".mkv", ".mov", ".webm", ".mpg", ".mpeg", ".m4v"};
  return std::find(known.begin(), known.end(), extension) != known.end();
}

struct VideoReader::State {
  std::filesystem::path file;
  cv::VideoCapture video;
  int count = 0, next = 0;
  double fps = 30;

  [[noreturn]] void fail(const std::string& problem) const {
    throw Error(file.string(), problem, "check that it plays, or turn it into pictures");
  }
  void open() {
    if (!try_open(video, file)) fail("cannot be read as a video");
    next = 0;
  }
};

VideoReader::VideoReader(const std::filesystem::path& file) : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.file = file;
  std::error_code ec;
  if (!std::filesystem::is_regular_file(file, ec)) throw Error(file.string(), "is no file", "check the path");
  s.open();
  if (const double fps = s.video.get(cv::CAP_PROP_FPS); fps > 0 && fps < 1e4) s.fps = fps;
  while (s.video.grab()) ++s.count;
  if (s.count == 0) s.fail("holds no frame");
  s.open();
}

VideoReader::~VideoReader() = default;
int VideoReader::count() const { return state_->count; }
double VideoReader::fps() const { return state_->fps; }

Image VideoReader::read(int frame) {
  State& s = *state_;
  if (frame < s.next) s.open();
  bool grabbed = true;
  for (; grabbed && s.next <= frame; ++s.next) grabbed = s.video.grab();
  cv::Mat bgr, rgb;
  if (!grabbed || !s.video.retrieve(bgr) || bgr.type() != CV_8UC3)
    s.fail(fmt::format("has a frame {} that cannot be decoded", frame));
  cv::cvtColor(bgr, rgb, cv::COLOR_BGR2RGB);
  Image image;
  image.width = rgb.cols, image.height = rgb.rows, image.channels = 3;
  image.bytes.resize(rgb.total() * 3);
  rgb.copyTo(cv::Mat(rgb.rows, rgb.cols, CV_8UC3, image.bytes.data()));
  return image;
}

struct VideoWriter::State {
  std::filesystem::path file;
  double fps;
  cv::VideoWriter video;
  cv::Size size;

  bool open(const char* code) {
    try {
      return video.open(file.string(), cv::CAP_FFMPEG,
                        cv::VideoWriter::fourcc(code[0], code[1], code[2], code[3]), fps, size);
    } catch (const cv::Exception&) {
      return false;
    }
  }
};

VideoWriter::VideoWriter(const std::filesystem::path& file, double fps)
    : state_(std::make_unique<State>(State{file, fps, {}, {}})) {}

VideoWriter::~VideoWriter() = default;

void VideoWriter::add(const Image& picture) {
  State& s = *state_;
  if (picture.channels != 3 || picture.type != PixelType::u8)
    throw Error(s.file.string(), "cannot hold a picture that is not 8-bit RGB", "convert it");
  const cv::Size size(picture.width, picture.height);
  if (!s.video.isOpened()) {
    s.size = size;
    if (!s.open("avc1") && !s.open("mp4v") && !s.open("MJPG"))
      throw Error(s.file.string(), "cannot be written as a video",
                  "take the extension mp4, or pictures instead");
  }
  if (size != s.size)
    throw Error(s.file.string(), "cannot hold pictures of several sizes", "take pictures instead");
  cv::Mat bgr;
  cv::cvtColor(cv::Mat(size, CV_8UC3, const_cast<std::byte*>(picture.bytes.data())), bgr, cv::COLOR_RGB2BGR);
  s.video.write(bgr);
}

void VideoWriter::close() { state_->video.release(); }

}  // namespace stuv::tracking
