#include "calib/tracking/sequence.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <sstream>

#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"

namespace stuv::tracking {
namespace fs = std::filesystem;
namespace {

constexpr std::string_view kFrame = "{frame}";

bool parse(std::string_view text, double& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() && std::isfinite(value);
}

/// All words of the text as numbers; empty if one is none.
std::vector<double> numbers_of(const std::string& text) {
  std::istringstream words(text);
  std::vector<double> numbers;
  for (std::string word; words >> word;) {
    double value = 0;
    if (!parse(word, value)) return {};
    numbers.push_back(value);
  }
  return numbers;
}

Pose read_matrix(const fs::path& file) {
  const std::vector<double> m = numbers_of(read_text(file));
  Pose pose;
  if (m.size() == 16)
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) pose.R(i, j) = m[4 * i + j];
      pose.t[i] = m[4 * i + 3];
    }
  const bool is_rotation =
      (pose.R * pose.R.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 && pose.R.determinant() > 0;
  if (m.size() != 16 || !is_rotation)
    throw Error(file.string(), "is no 4x4 matrix of a rigid motion", "write four lines of four numbers");
  return pose;
}

std::string with_frame(std::string pattern, const std::string& name) {
  for (std::size_t at = 0; (at = pattern.find(kFrame, at)) != std::string::npos; at += name.size())
    pattern.replace(at, kFrame.size(), name);
  return pattern;
}

/// The file of a frame's pose: its name as it stands, or as a number with fewer or more leading zeros.
std::optional<fs::path> pose_file(const std::string& pattern, const SequenceFrame& frame) {
  std::vector<std::string> names = {frame.name};
  if (double number = 0; parse(frame.name, number))
    for (int width = 1; width <= 8; ++width)
      names.push_back(fmt::format("{:0{}}", static_cast<long>(number), width));
  for (const std::string& name : names)
    if (const fs::path file = with_frame(pattern, name); fs::is_regular_file(file)) return file;
  return {};
}

std::vector<SequenceFrame> video_frames(const fs::path& file) {
  const int count = VideoReader(file).count();
  std::vector<SequenceFrame> frames;
  for (int i = 0; i < count; ++i) frames.push_back({fmt::format("{:05}", i), file, double(i), i});
  return frames;
}

}  // namespace

FrameReader::FrameReader() = default;
FrameReader::~FrameReader() = default;

Image FrameReader::read(const SequenceFrame& frame, const Camera& camera) {
  if (frame.in_video >= 0 && open_ != frame.file) {
    video_ = std::make_unique<VideoReader>(frame.file);
    open_ = frame.file;
  }
  Image image = frame.in_video >= 0 ? video_->read(frame.in_video) : read_image(frame.file);
  if (image.width != camera.width || image.height != camera.height)
    throw Error(
        frame.file.string(),
        fmt::format("is {}x{}, the camera is {}x{}", image.width, image.height, camera.width, camera.height),
        "give the camera that took it, at this size");
  return image;
}

void number_frames(std::vector<SequenceFrame>& frames) {
  const bool numbers =
      std::all_of(frames.begin(), frames.end(), [](SequenceFrame& f) { return parse(f.name, f.time); });
  if (!numbers)
    for (std::size_t i = 0; i < frames.size(); ++i) frames[i].time = static_cast<double>(i);
}

std::vector<SequenceFrame> find_frames(const std::string& source) {
  const fs::path path(source);
  const std::string name = path.filename().string();
  const std::size_t at = name.find(kFrame);
  if (at == std::string::npos && is_video_name(path)) return video_frames(path);
  if (at == std::string::npos)
    throw Error(source, "has no {frame} in its file name and is no video",
                "write e.g. 'frames/frame_{frame}.png' or walk.mp4");
  const std::string head = name.substr(0, at), tail = name.substr(at + kFrame.size());
  const fs::path folder = path.has_parent_path() ? path.parent_path() : fs::path(".");
  std::error_code ec;
  if (!fs::is_directory(folder, ec))
    throw Error(folder.string(), "is no folder", "check the path of the pattern");
  std::vector<SequenceFrame> frames;
  for (const auto& entry : fs::directory_iterator(folder, ec)) {
    const std::string file = entry.path().filename().string();
    if (file.size() <= head.size() + tail.size() || !file.starts_with(head) || !file.ends_with(tail))
      continue;
    const std::string frame = file.substr(head.size(), file.size() - head.size() - tail.size());
    if (file.front() != '.') frames.push_back({frame, entry.path(), 0, -1});
  }
  if (frames.empty()) throw Error(source, "matches no file", "check the path and where {frame} stands");
  std::sort(frames.begin(), frames.end(),
            [](const auto& a, const auto& b) { return natural_less(a.name, b.name); });
  number_frames(frames);
  return frames;
}

Grey grey_of(const Image& image) {
  const ImageF pixels = to_float(image);
  Grey grey(image.width, image.height, 1);
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) {
      const float* p = &pixels.at(x, y);
      const float luma = pixels.channels == 3 ? 0.299F * p[0] + 0.587F * p[1] + 0.114F * p[2] : p[0];
      grey.at(x, y) = static_cast<std::uint8_t>(std::lround(255 * std::clamp(luma, 0.0F, 1.0F)));
    }
  return grey;
}

std::vector<TimedPose> read_trajectory(const fs::path& file) {
  std::istringstream text(read_text(file));
  std::vector<TimedPose> poses;
  int number = 0;
  for (std::string line; std::getline(text, line);) {
    ++number;
    line = line.substr(0, line.find('#'));
    if (line.find_first_not_of(" \t\r") == std::string::npos) continue;
    const std::vector<double> v = numbers_of(line);
    const auto fail = [&](const std::string& problem) {
      throw Error(fmt::format("{}:{}", file.string(), number), problem, "write lines t tx ty tz qx qy qz qw");
    };
    if (v.size() != 8) fail("is not eight finite numbers");
    const Eigen::Quaterniond q(v[7], v[4], v[5], v[6]);
    if (std::abs(q.norm() - 1) > 0.01) fail("has a quaternion that is not of unit length");
    for (const TimedPose& other : poses)
      if (other.time == v[0]) fail("has a time that was there before");
    poses.push_back({v[0], {q.normalized().toRotationMatrix(), {v[1], v[2], v[3]}}});
  }
  return poses;
}

std::string trajectory_text(const std::vector<TimedPose>& poses) {
  std::string text = "# t tx ty tz qx qy qz qw: object in camera, metres\n";
  for (const TimedPose& p : poses) {
    const Eigen::Quaterniond q(p.cam_from_object.R);
    const Eigen::Vector3d& t = p.cam_from_object.t;
    text += fmt::format("{} {:.9g} {:.9g} {:.9g} {:.9g} {:.9g} {:.9g} {:.9g}\n", p.time, t.x(), t.y(), t.z(),
                        q.x(), q.y(), q.z(), q.w());
  }
  return text;
}

std::vector<std::optional<Pose>> poses_of(const std::string& source,
                                          const std::vector<SequenceFrame>& frames) {
  std::vector<std::optional<Pose>> poses(frames.size());
  if (source.find(kFrame) != std::string::npos) {
    for (std::size_t i = 0; i < frames.size(); ++i)
      if (const auto file = pose_file(source, frames[i])) poses[i] = read_matrix(*file);
    return poses;
  }
  for (const TimedPose& p : read_trajectory(source))
    for (std::size_t i = 0; i < frames.size(); ++i)
      if (std::abs(frames[i].time - p.time) < 1e-6) poses[i] = p.cam_from_object;
  return poses;
}

}  // namespace stuv::tracking
