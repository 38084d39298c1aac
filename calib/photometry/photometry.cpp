#include "calib/photometry/photometry.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/error.h"

namespace stuv {
namespace {

constexpr const char* kFormat = "stuv.photometry";
constexpr int kVersion = 1;
constexpr const char* kName = "photometry.json";

Json camera_to_json(const CameraPhotometry& c) {
  return {{"name", c.camera},
          {"determined", c.determined},
          {"gain", c.gain},
          {"offset", c.offset},
          {"falloff", c.falloff},
          {"centre_px", {c.centre_px.x(), c.centre_px.y()}},
          {"corner_px", c.corner_px},
          {"gain_sigma", c.gain_sigma},
          {"offset_sigma", c.offset_sigma},
          {"corner_sigma", c.corner_sigma},
          {"samples", c.samples},
          {"reasons", c.reasons}};
}

double number_or_nan(const Json& json) {
  return json.is_null() ? std::numeric_limits<double>::quiet_NaN() : json.get<double>();
}

std::array<double, 3> three(const Json& json) {
  return {number_or_nan(json.at(0)), number_or_nan(json.at(1)), number_or_nan(json.at(2))};
}

CameraPhotometry camera_from_json(const Json& json) {
  CameraPhotometry c;
  c.camera = json.at("name");
  c.determined = json.at("determined");
  c.gain = three(json.at("gain"));
  c.offset = three(json.at("offset"));
  c.falloff = three(json.at("falloff"));
  const Json& centre = json.at("centre_px");
  c.centre_px = Eigen::Vector2d(centre.at(0).get<double>(), centre.at(1).get<double>());
  c.corner_px = json.at("corner_px");
  c.gain_sigma = three(json.at("gain_sigma"));
  c.offset_sigma = three(json.at("offset_sigma"));
  c.corner_sigma = number_or_nan(json.at("corner_sigma"));
  c.samples = json.at("samples");
  c.reasons = json.at("reasons").get<std::vector<std::string>>();
  return c;
}

/// The file may be edited by hand.
bool usable(const CameraPhotometry& c) {
  for (const double gain : c.gain)
    if (!(gain > 0) || !std::isfinite(gain)) return false;
  for (const double offset : c.offset)
    if (!std::isfinite(offset)) return false;
  if (!(c.corner_px > 0) || !c.centre_px.allFinite()) return false;
  for (int i = 0; i <= 32; ++i) {
    const double rho = i / 32.0;
    if (!(1 + rho * (c.falloff[0] + rho * (c.falloff[1] + rho * c.falloff[2])) > 0)) return false;
  }
  return true;
}

template <class T>
double largest(const Image& image) {
  const T* values = reinterpret_cast<const T*>(image.bytes.data());
  const std::size_t n = image.bytes.size() / sizeof(T);
  return n == 0 ? 0 : *std::max_element(values, values + n);
}

template <class T>
double fraction_at(const Image& image, double level) {
  const T* values = reinterpret_cast<const T*>(image.bytes.data());
  const std::size_t pixels = static_cast<std::size_t>(image.width) * image.height;
  std::size_t full = 0;
  for (std::size_t i = 0; i < pixels; ++i) {
    bool any = false;
    for (int c = 0; c < image.channels; ++c) any |= values[i * image.channels + c] >= level;
    full += any && (image.mask.empty() || image.mask.data[i] != 0) ? 1 : 0;
  }
  return static_cast<double>(full) / static_cast<double>(std::max<std::size_t>(1, pixels));
}

}  // namespace

const CameraPhotometry* Photometry::of(const std::string& camera) const {
  for (const CameraPhotometry& c : cameras)
    if (c.camera == camera) return c.determined ? &c : nullptr;
  return nullptr;
}

std::string summary_of(const Photometry& p) {
  const auto good = std::count_if(p.cameras.begin(), p.cameras.end(),
                                  [](const CameraPhotometry& c) { return c.determined; });
  if (good == 0)
    return fmt::format("photometry: not determined: {}",
                       p.cameras.empty() ? "no cameras" : p.cameras[0].reasons.at(0));
  return fmt::format(
      "photometry from {}: {} of {} cameras, which differ by {:.2f} % as stored, {:.2f} % made equal",
      p.source, good, p.cameras.size(), 100 * p.spread_before, 100 * p.spread_after);
}

double falloff_at(const CameraPhotometry& c, const Eigen::Vector2d& pixel) {
  const double rho = (pixel - c.centre_px).squaredNorm() / (c.corner_px * c.corner_px);
  return 1 + rho * (c.falloff[0] + rho * (c.falloff[1] + rho * c.falloff[2]));
}

double corrected(const CameraPhotometry& c, int channel, const Eigen::Vector2d& pixel, double stored) {
  return (stored - c.offset[channel]) / (c.gain[channel] * falloff_at(c, pixel));
}

double white_level(const Image& image) {
  if (image.type == PixelType::f16 || image.type == PixelType::f32)
    return std::numeric_limits<double>::infinity();
  if (image.type == PixelType::u8) return 1;
  const double top = largest<std::uint16_t>(image);
  for (const int bits : {10, 12, 14}) {
    const double full = (1 << bits) - 1;
    if (top == full || top == full * (1 << (16 - bits))) return top / 65535;
  }
  return 1;
}

double full_fraction(const Image& image) {
  if (image.type == PixelType::u8) return fraction_at<std::uint8_t>(image, 255);
  if (image.type == PixelType::u16)
    return fraction_at<std::uint16_t>(image, std::round(white_level(image) * 65535));
  return 0;
}

std::optional<Photometry> read_photometry(const std::filesystem::path& folder) {
  const std::filesystem::path file = folder / kName;
  std::error_code ec;
  if (!std::filesystem::exists(file, ec)) return std::nullopt;
  const Json json = read_manifest(file, kFormat, kVersion);
  Photometry p;
  try {
    p.source = json.at("source");
    p.channels = json.at("channels");
    p.points = json.at("points");
    p.spread_before = number_or_nan(json.at("spread_before"));
    p.spread_after = number_or_nan(json.at("spread_after"));
    p.notes = json.at("notes").get<std::vector<std::string>>();
    for (const Json& camera : json.at("cameras")) p.cameras.push_back(camera_from_json(camera));
  } catch (const Json::exception&) {
    throw Error(file.string(), "lacks a field or has one of the wrong type",
                "calibrate again, or remove the file");
  }
  for (const CameraPhotometry& c : p.cameras)
    if (c.determined && !usable(c))
      throw Error(file.string(), "has values of camera " + c.camera + " that no camera can have",
                  "calibrate again, or remove the file");
  return p;
}

void write_photometry(const std::filesystem::path& folder, const Photometry& p) {
  Json cameras = Json::array();
  for (const CameraPhotometry& c : p.cameras) cameras.push_back(camera_to_json(c));
  write_json(folder / kName, {{"format", kFormat},
                              {"version", kVersion},
                              {"source", p.source},
                              {"channels", p.channels},
                              {"points", p.points},
                              {"spread_before", p.spread_before},
                              {"spread_after", p.spread_after},
                              {"notes", p.notes},
                              {"cameras", cameras}});
}

}  // namespace stuv
