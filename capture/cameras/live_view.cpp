#include "capture/cameras/live_view.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"

namespace stuv {
namespace {

constexpr int kCellWidth = 320, kCellHeight = 240;

/// Means over k x k pixels, as 8-bit RGB; k so that the result fits a cell.
Image shrink(const Image& image) {
  const ImageF pixels = to_float(image);
  const int k = std::max(
      {1, (image.width + kCellWidth - 1) / kCellWidth, (image.height + kCellHeight - 1) / kCellHeight});
  ImageF small(std::max(1, image.width / k), std::max(1, image.height / k), 3);
  for (int y = 0; y < small.height; ++y)
    for (int x = 0; x < small.width; ++x)
      for (int c = 0; c < 3; ++c) {
        double sum = 0;
        int count = 0;
        for (int j = y * k; j < std::min((y + 1) * k, image.height); ++j)
          for (int i = x * k; i < std::min((x + 1) * k, image.width); ++i, ++count)
            sum += pixels.at(i, j, image.channels == 3 ? c : 0);
        small.at(x, y, c) = static_cast<float>(sum / std::max(count, 1));
      }
  return from_float(small, PixelType::u8);
}

Image decode(const RawFrame& raw, const std::string& name) {
  return raw.format.fourcc == "MJPG" ? decode_jpeg(raw.bytes, name) : decode_raw(raw.format, raw.bytes, name);
}

}  // namespace

Glance glance_at(const Image& image) {
  const ImageF pixels = to_float(image);
  Glance glance;
  glance.known = true;
  double level = 0, difference = 0;
  std::size_t clipped = 0;
  for (int y = 0; y < pixels.height; ++y) {
    double before = 0;
    for (int x = 0; x < pixels.width; ++x) {
      double luma = 0, largest = 0;
      for (int c = 0; c < pixels.channels; ++c) {
        luma += static_cast<double>(pixels.at(x, y, c)) / pixels.channels;
        largest = std::max<double>(largest, pixels.at(x, y, c));
      }
      level += luma;
      clipped += largest >= 1 ? 1 : 0;
      if (x > 0) difference += std::abs(luma - before);
      before = luma;
    }
  }
  const double count = std::max(1.0, static_cast<double>(pixels.width) * pixels.height);
  glance.level = level / count;
  glance.clipped = static_cast<double>(clipped) / count;
  glance.sharpness = 100 * difference / count;
  return glance;
}

LiveView::LiveView(int rows, int cols, std::vector<RecordedCamera> cameras)
    : rows_(rows),
      cols_(cols),
      cameras_(std::move(cameras)),
      glances_(cameras_.size()),
      thumbnails_(cameras_.size()) {}

void LiveView::look(const SourceSet& set) {
  const std::size_t i = next_++ % cameras_.size();
  const auto* raw = std::get_if<RawFrame>(&set.frames[i].content);
  if (raw == nullptr) return;
  try {
    thumbnails_[i] = shrink(decode(*raw, cameras_[i].name));
    glances_[i] = glance_at(thumbnails_[i]);
  } catch (const Error&) {
    glances_[i] = {};  // a broken JPEG: recorded as it came
  }
}

void LiveView::write_preview(const std::filesystem::path& folder) const {
  constexpr int gap = 4;
  Image sheet{cols_ * (kCellWidth + gap), rows_ * (kCellHeight + gap), 3, PixelType::u8, {}, {}};
  sheet.bytes.assign(static_cast<std::size_t>(sheet.width) * sheet.height * 3, std::byte{32});
  for (std::size_t i = 0; i < cameras_.size(); ++i) {
    const Image& cell = thumbnails_[i];
    for (int y = 0; y < cell.height; ++y) {
      const std::size_t row = static_cast<std::size_t>(cameras_[i].row) * (kCellHeight + gap) + y;
      const std::size_t col = static_cast<std::size_t>(cameras_[i].col) * (kCellWidth + gap);
      std::memcpy(&sheet.bytes[(row * sheet.width + col) * 3],
                  &cell.bytes[static_cast<std::size_t>(y) * cell.width * 3],
                  static_cast<std::size_t>(cell.width) * 3);
    }
  }
  std::error_code ec;
  std::filesystem::create_directories(folder, ec);
  write_image(folder / "sheet.jpg", sheet);
  if (std::filesystem::exists(folder / "index.html", ec)) return;
  std::string labels;
  for (const RecordedCamera& camera : cameras_)
    labels += fmt::format("<b style=\"left:{}px;top:{}px\">{}</b>", camera.col * (kCellWidth + gap) + 4,
                          camera.row * (kCellHeight + gap) + 4, camera.name);
  write_text(folder / "index.html",
             "<!doctype html><meta charset=\"utf-8\"><title>stuv capture</title>"
             "<style>body{margin:0;background:#202020;position:relative}b{position:absolute;color:#fff;"
             "font:14px sans-serif;text-shadow:0 0 3px #000}</style><img id=\"sheet\" src=\"sheet.jpg\">" +
                 labels +
                 "<script>setInterval(()=>{document.getElementById('sheet').src='sheet.jpg?'+Date.now()},"
                 "1000)</script>\n");
}

}  // namespace stuv
