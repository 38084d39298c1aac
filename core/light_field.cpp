#include "core/light_field.h"

#include <OpenImageIO/imagebuf.h>
#include <OpenImageIO/imagebufalgo.h>
#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <list>
#include <mutex>
#include <set>

#include "core/error.h"

namespace stuv {
namespace fs = std::filesystem;
namespace {

constexpr const char* kFormat = "stuv.lightfield";
constexpr int kVersion = 1;

View view_from_json(const Json& json) {
  View view;
  view.name = json.at("name");
  view.file = json.at("file");
  view.role = json.at("role") == "truth" ? ViewRole::truth : ViewRole::input;
  if (view.role == ViewRole::input) {
    view.row = json.at("row");
    view.col = json.at("col");
  }
  view.s = json.at("s");
  view.t = json.at("t");
  view.w = json.at("w");
  view.cx_px = json.at("cx_px");
  view.cy_px = json.at("cy_px");
  return view;
}

Json view_to_json(const View& view) {
  Json json = {
      {"name", view.name}, {"file", view.file}, {"role", view.role == ViewRole::truth ? "truth" : "input"}};
  if (view.role == ViewRole::input) {
    json["row"] = view.row;
    json["col"] = view.col;
  }
  json["s"] = view.s;
  json["t"] = view.t;
  json["w"] = view.w;
  json["cx_px"] = view.cx_px;
  json["cy_px"] = view.cy_px;
  return json;
}

/// A manifest may be edited by hand: what renderers rely on is checked once, here.
void check(const LightField& lf, const std::string& file) {
  const auto fail = [&](const std::string& problem) {
    throw Error(file, problem, "make the scene again, or mend the manifest");
  };
  if (lf.width <= 0 || lf.height <= 0) fail(fmt::format("has a picture size of {}x{}", lf.width, lf.height));
  if (lf.channels != 1 && lf.channels != 3) fail(fmt::format("has {} channels, not 1 or 3", lf.channels));
  if (lf.rows <= 0 || lf.cols <= 0) fail(fmt::format("has a lattice of {}x{}", lf.rows, lf.cols));
  if (!std::isfinite(lf.focal_px) || lf.focal_px <= 0)
    fail(fmt::format("has a focal length of {} px", lf.focal_px));
  if (!std::isfinite(lf.convergence_px)) fail("has a convergence that is not finite");
  std::set<std::pair<int, int>> places;
  for (const View& view : lf.views) {
    for (const double value : {view.s, view.t, view.w, view.cx_px, view.cy_px})
      if (!std::isfinite(value)) fail(fmt::format("view {} has a position that is not finite", view.name));
    if (view.role == ViewRole::truth) continue;
    if (view.row < 0 || view.row >= lf.rows || view.col < 0 || view.col >= lf.cols)
      fail(fmt::format("view {} lies outside the {}x{} lattice", view.name, lf.rows, lf.cols));
    if (!places.insert({view.row, view.col}).second)
      fail(fmt::format("view {} shares row {}, column {} with another", view.name, view.row, view.col));
  }
  if (places.empty()) fail("has no input view");
}

}  // namespace

int LightField::view_index(const std::string& name) const {
  const auto it = std::find_if(views.begin(), views.end(), [&](const View& v) { return v.name == name; });
  return it == views.end() ? -1 : static_cast<int>(it - views.begin());
}

std::vector<int> LightField::views_with(ViewRole role) const {
  std::vector<int> indices;
  for (std::size_t i = 0; i < views.size(); ++i)
    if (views[i].role == role) indices.push_back(static_cast<int>(i));
  return indices;
}

LightField open_light_field(const fs::path& folder) {
  const fs::path file = folder / "lightfield.json";
  const Json json = read_manifest(file, kFormat, kVersion);
  LightField lf;
  lf.folder = folder;
  try {
    lf.width = json.at("width");
    lf.height = json.at("height");
    lf.channels = json.at("channels");
    lf.type = pixel_type_from_name(json.at("pixel_type"));
    lf.rows = json.at("rows");
    lf.cols = json.at("cols");
    lf.metric = json.at("metric");
    lf.focal_px = json.at("focal_px");
    lf.convergence_px = json.at("convergence_px");
    lf.cx0_px = json.at("principal_point_px").at(0);
    lf.cy0_px = json.at("principal_point_px").at(1);
    const Json& range = json.at("disparity_px");
    lf.d_min = range.is_null() ? std::nan("") : range.at(0).get<double>();
    lf.d_max = range.is_null() ? std::nan("") : range.at(1).get<double>();
    for (const Json& view : json.at("views")) lf.views.push_back(view_from_json(view));
    lf.produced_by = json.at("produced_by");
  } catch (const Json::exception&) {
    throw Error(file.string(), "lacks a field or has one of the wrong type", "make the scene again");
  }
  check(lf, file.string());
  return lf;
}

void write_manifest(const LightField& lf) {
  const fs::path file = lf.folder / "lightfield.json";
  check(lf, file.string());
  Json views = Json::array();
  for (const View& view : lf.views) views.push_back(view_to_json(view));
  write_json(file, {{"format", kFormat},
                    {"version", kVersion},
                    {"produced_by", lf.produced_by},
                    {"width", lf.width},
                    {"height", lf.height},
                    {"channels", lf.channels},
                    {"pixel_type", name_of(lf.type)},
                    {"metric", lf.metric},
                    {"focal_px", lf.focal_px},
                    {"convergence_px", lf.convergence_px},
                    {"principal_point_px", {lf.cx0_px, lf.cy0_px}},
                    {"disparity_px", lf.has_range() ? Json{lf.d_min, lf.d_max} : Json(nullptr)},
                    {"rows", lf.rows},
                    {"cols", lf.cols},
                    {"views", views}});
}

void write_view(const LightField& lf, const View& view, const Image& image) {
  const fs::path file = lf.folder / view.file;
  if (image.width != lf.width || image.height != lf.height || image.channels != lf.channels)
    throw Error(file.string(),
                fmt::format("is {}x{} with {} channels, the scene {}x{} with {}", image.width, image.height,
                            image.channels, lf.width, lf.height, lf.channels),
                "all views of a scene need one size");
  ImageF pixels = to_float(image);
  const bool masked = !image.mask.empty();
  OIIO::ImageBuf buffer(
      OIIO::ImageSpec(lf.width, lf.height, lf.channels + (masked ? 1 : 0), OIIO::TypeFloat));
  if (masked) {
    // Missing pixels are black with alpha 0, the premultiplied form: coarser levels then average only what is
    // there.
    ImageF joined(lf.width, lf.height, lf.channels + 1);
    for (std::size_t i = 0; i < image.mask.data.size(); ++i) {
      if (image.mask.data[i] == 0) continue;
      std::copy_n(&pixels.data[i * lf.channels], lf.channels, &joined.data[i * (lf.channels + 1)]);
      joined.data[i * (lf.channels + 1) + lf.channels] = 1;
    }
    pixels = std::move(joined);
    buffer.specmod().alpha_channel = lf.channels;
    buffer.specmod().channelnames.back() = "A";
  }
  buffer.set_pixels(buffer.roi(), OIIO::TypeFloat, pixels.data.data());
  OIIO::ImageSpec config;
  config.tile_width = config.tile_height = 64;
  const OIIO::TypeDesc types[] = {OIIO::TypeUInt8, OIIO::TypeUInt16, OIIO::TypeHalf, OIIO::TypeFloat};
  // TIFF of ordinary viewers knows no half.
  config.format = lf.type == PixelType::f16 ? OIIO::TypeFloat : types[static_cast<int>(lf.type)];
  config["compression"] = "zip";
  config["maketx:filtername"] = "box";
  fs::create_directories(file.parent_path());
  if (!OIIO::ImageBufAlgo::make_texture(OIIO::ImageBufAlgo::MakeTxTexture, buffer, file.string(), config))
    throw Error(file.string(), fmt::format("cannot be written ({})", OIIO::geterror()),
                "check the folder and the free space");
}

/// Open files, those used last first. (OpenImageIO's own cache is not used: version 2.4 miscounts its memory
/// when it is destroyed while other threads hold tiles, and who renders keeps pixels anyway.)
struct LightFieldReader::Files {
  static constexpr std::size_t kMostOpen = 128;
  using Input = std::shared_ptr<OIIO::ImageInput>;

  std::mutex mutex;
  std::list<std::pair<int, Input>> open;

  /// Null if the file cannot be opened.
  Input get(int view, const fs::path& path) {
    const std::lock_guard lock(mutex);
    const auto found =
        std::find_if(open.begin(), open.end(), [&](const auto& entry) { return entry.first == view; });
    if (found != open.end()) {
      open.splice(open.begin(), open, found);
    } else {
      Input input = OIIO::ImageInput::open(path.string());
      if (!input) return nullptr;
      open.emplace_front(view, std::move(input));
      if (open.size() > kMostOpen) open.pop_back();
    }
    return open.front().second;
  }
};

LightFieldReader::LightFieldReader(LightField lf) : lf_(std::move(lf)), files_(std::make_unique<Files>()) {}
LightFieldReader::~LightFieldReader() = default;
LightFieldReader::LightFieldReader(LightFieldReader&&) noexcept = default;

namespace {

/// A part of a picture with all its channels, read in whole tiles (or rows, where there are none).
bool read_part(OIIO::ImageInput& input, const OIIO::ImageSpec& spec, int level, int x, int y, ImageF& out) {
  const bool tiled = spec.tile_width > 0;
  const auto down = [](int at, int step) { return at / step * step; };
  const auto up = [](int at, int step, int end) { return std::min((at + step - 1) / step * step, end); };
  const int x0 = tiled ? down(x, spec.tile_width) : 0, y0 = tiled ? down(y, spec.tile_height) : y;
  const int x1 = tiled ? up(x + out.width, spec.tile_width, spec.width) : spec.width;
  const int y1 = tiled ? up(y + out.height, spec.tile_height, spec.height) : y + out.height;
  ImageF whole(x1 - x0, y1 - y0, out.channels);
  const bool good =
      tiled ? input.read_tiles(0, level, x0, x1, y0, y1, 0, 1, 0, out.channels, OIIO::TypeFloat,
                               whole.data.data())
            : input.read_scanlines(0, level, y0, y1, 0, 0, out.channels, OIIO::TypeFloat, whole.data.data());
  for (int row = 0; good && row < out.height; ++row)
    std::copy_n(&whole.at(x - x0, y - y0 + row), static_cast<std::size_t>(out.width) * out.channels,
                out.row(row));
  return good;
}

}  // namespace

ViewPixels LightFieldReader::read(int view, int level, int x, int y, int width, int height) const {
  const fs::path path = lf_.folder / lf_.views[static_cast<std::size_t>(view)].file;
  const Files::Input input = files_->get(view, path);
  const auto fail = [&](const std::string& why) {
    throw Error(path.string(), fmt::format("cannot be read ({})", why), "make the scene again");
  };
  if (!input) fail(OIIO::geterror());
  const OIIO::ImageSpec spec = input->spec(0, level);
  if (spec.width <= 0) fail(fmt::format("it has no level {}", level));
  if ((level == 0 && (spec.width != lf_.width || spec.height != lf_.height)) || spec.nchannels < lf_.channels)
    throw Error(path.string(), "does not have the size its manifest states", "make the scene again");
  const bool masked = spec.nchannels > lf_.channels;
  ImageF all(width, height, lf_.channels + (masked ? 1 : 0));
  if (!read_part(*input, spec, level, x, y, all)) fail(input->geterror());
  if (!masked) return {std::move(all), {}};
  ViewPixels out{ImageF(width, height, lf_.channels), Mask(width, height, 1)};
  for (std::size_t i = 0; i < out.mask.data.size(); ++i) {
    const float* pixel = &all.data[i * all.channels];
    std::copy_n(pixel, lf_.channels, &out.colour.data[i * lf_.channels]);
    out.mask.data[i] = pixel[lf_.channels] > 0.999F ? 255 : 0;
  }
  return out;
}

ViewPixels LightFieldReader::read(int view) const { return read(view, 0, 0, 0, lf_.width, lf_.height); }

}  // namespace stuv
