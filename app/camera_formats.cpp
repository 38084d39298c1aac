#include "app/camera_formats.h"

#include <fmt/format.h>

#include <algorithm>

#include "app/console.h"

namespace stuv {
namespace {

constexpr CameraFormat kFormats[] = {CameraFormat::mrcal,  CameraFormat::opencv,     CameraFormat::kalibr,
                                     CameraFormat::colmap, CameraFormat::nerfstudio, CameraFormat::llff};

}  // namespace

std::string format_names() {
  std::string names;
  for (const CameraFormat format : kFormats)
    names += (names.empty() ? "" : ", ") + std::string(name_of(format));
  return names;
}

CameraFormat parse_camera_format(const std::string& flag, const std::string& text) {
  const auto* found = std::find_if(std::begin(kFormats), std::end(kFormats),
                                   [&](CameraFormat format) { return text == name_of(format); });
  if (found == std::end(kFormats))
    throw UsageError(fmt::format("{}: there is no '{}'; {}", flag, text, format_names()));
  return *found;
}

void print_fits(const LensFits& fits, const Reporter& reporter) {
  for (const LensFit& f : fits.made)
    reporter.warn(
        fmt::format("camera {}: its lens, {}, was replaced by the nearest {}, off by up to {:.2g} px",
                    f.camera, f.from, f.to, f.worst_px));
}

Json fits_json(const LensFits& fits) {
  Json list = Json::array();
  for (const LensFit& f : fits.made)
    list.push_back({{"camera", f.camera}, {"from", f.from}, {"to", f.to}, {"worst_px", f.worst_px}});
  return list;
}

}  // namespace stuv
