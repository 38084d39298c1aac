#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <limits>
#include <optional>

#include "app/commands.h"
#include "app/console.h"
#include "app/search_range.h"
#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"
#include "render/all_in_focus.h"
#include "render/plan/sampling.h"
#include "render/renderer.h"

namespace stuv {
namespace {

namespace fs = std::filesystem;

struct Flags : CommonFlags {
  fs::path scene, output, path, depth_out, index_out, confidence_out;
  std::string at, size, disparity, depth_m, weights, no_skip;
  std::string mode = "all-in-focus", filter = "normal", method = "exact", backend = "cpu";
  std::optional<double> focus_m, focus_px;
  int planes = 0, window = RenderOptions{}.window;
  std::vector<std::string> leave_out;
};

double parse_number(const std::string& flag, const std::string& text) {
  std::size_t end = 0;
  try {
    const double value = std::stod(text, &end);
    if (end == text.size() && std::isfinite(value)) return value;
  } catch (const std::logic_error&) {
  }
  throw UsageError(fmt::format("{}: '{}' is no number", flag, text));
}

/// "S,T" or "S,T,Z".
Viewpoint parse_viewpoint(const LightField& lf, const std::string& flag, const std::string& text) {
  const std::vector<std::string> parts = parse_list(flag, text);
  if (parts.size() != 2 && parts.size() != 3)
    throw UsageError(fmt::format("{} wants S,T or S,T,Z, not '{}'", flag, text));
  const double s = parse_number(flag, parts[0]), t = parse_number(flag, parts[1]);
  const double z = parts.size() == 3 ? parse_number(flag, parts[2]) : camera_surface_z(lf, s, t);
  if (z != 0 && !lf.metric)
    throw UsageError(
        fmt::format("{}: Z needs metres, which this scene does not have; import it with --focal-px", flag));
  return default_viewpoint(lf, s, t, z);
}

std::vector<Viewpoint> read_path(const LightField& lf, const fs::path& file) {
  std::vector<Viewpoint> views;
  std::istringstream lines(read_text(file));
  int number = 0;
  for (std::string line; std::getline(lines, line);) {
    ++number;
    std::erase_if(line, [](unsigned char c) { return std::isspace(c); });
    if (line.empty() || line[0] == '#') continue;
    if (views.empty() && line == "s,t,z") continue;
    try {
      views.push_back(parse_viewpoint(lf, "--path", line));
    } catch (const UsageError& e) {
      throw Error(fmt::format("{}:{}", file.string(), number), e.what(),
                  "write one viewpoint s,t,z per line");
    }
  }
  if (views.empty()) throw Error(file.string(), "holds no viewpoint", "write one viewpoint s,t,z per line");
  return views;
}

std::vector<Viewpoint> viewpoints_of(const Flags& flags, const LightField& lf) {
  std::vector<Viewpoint> views;
  if (!flags.path.empty()) {
    views = read_path(lf, flags.path);
  } else {
    views.push_back(flags.at.empty() ? middle_viewpoint(lf) : parse_viewpoint(lf, "--at", flags.at));
  }
  if (!flags.size.empty()) {
    const auto [width, height] = parse_size("--size", flags.size);
    for (Viewpoint& view : views) view = resized(view, width, height);
  }
  return views;
}

void set_range(const Flags& flags, const LightFieldReader& reader, RenderOptions& options) {
  const SearchRange range = search_range(reader, {flags.disparity, flags.depth_m, flags.leave_out});
  options.d_min = range.d_min;
  options.d_max = range.d_max;
}

void set_weights(const Flags& flags, RenderOptions& options) {
  if (flags.weights.empty()) return;
  const std::vector<std::string> a = parse_list("--weights", flags.weights);
  if (a.size() != 3) throw UsageError(fmt::format("--weights wants A01,A02,A12, not '{}'", flags.weights));
  options.a01 = parse_number("--weights", a[0]);
  options.a02 = parse_number("--weights", a[1]);
  options.a12 = parse_number("--weights", a[2]);
  if (std::min({options.a01, options.a02, options.a12}) < 0 || options.a01 + options.a02 + options.a12 <= 0)
    throw UsageError("--weights wants numbers >= 0, one of them > 0");
}

/// The focal plane of --mode focal-plane; the middle of the range if none is given.
double focus_of(const Flags& flags, const LightFieldReader& reader) {
  const LightField& lf = reader.light_field();
  if (flags.focus_px) {
    if (!std::isfinite(*flags.focus_px)) throw UsageError("--focus-px wants a finite disparity");
    return *flags.focus_px;
  }
  if (flags.focus_m) {
    if (!lf.metric) throw UsageError("--focus needs metres, which this scene does not have; use --focus-px");
    if (!(*flags.focus_m > 0)) throw UsageError("--focus wants a depth > 0");
    return lf.disparity(1 / *flags.focus_m);
  }
  RenderOptions range;
  set_range(flags, reader, range);
  return (range.d_min + range.d_max) / 2;
}

Filter filter_of(const std::string& name) {
  return name == "wide" ? Filter::wide : name == "skipped" ? Filter::skipped : Filter::normal;
}

/// Depth [m] of metric scenes (at and beyond infinity: Inf), disparity of others; NaN where there is none.
ImageF depth_of(const LightField& lf, const ImageF& disparity) {
  ImageF depth = disparity;
  if (!lf.metric) return depth;
  for (float& d : depth.data) {
    if (std::isnan(d)) continue;
    const double rho = lf.inverse_depth(d);
    d = rho > 0 ? static_cast<float>(1 / rho) : std::numeric_limits<float>::infinity();
  }
  return depth;
}

/// Whole numbers as a PFM or as a 16-bit picture in which 65535 is "none".
void write_index(const fs::path& file, const Raster<int>& plane) {
  ImageF values(plane.width, plane.height, 1);
  const bool pfm = file.extension() == ".pfm";
  for (std::size_t i = 0; i < plane.data.size(); ++i) {
    const int n = plane.data[i];
    values.data[i] = pfm ? static_cast<float>(n) : static_cast<float>(n < 0 ? 65535 : n) / 65535.0F;
  }
  if (pfm) return write_pfm(file, values);
  write_image(file, from_float(values, PixelType::u16));
}

void write_float(const fs::path& file, const ImageF& values, PixelType type) {
  if (file.extension() == ".pfm") return write_pfm(file, values);
  write_image(file, from_float(values, type));
}

/// The depth map as a picture: grey by disparity over the range that was searched, near is bright; black
/// where there is none.
ImageF depth_preview(const ImageF& disparity, double d_min, double d_max) {
  ImageF grey = disparity;
  const double range = std::max(d_max - d_min, 1e-12);
  for (float& d : grey.data)
    d = std::isnan(d) ? 0.0F : static_cast<float>(0.1 + 0.9 * std::clamp((d - d_min) / range, 0.0, 1.0));
  return grey;
}

/// FILE for a single view, FILE_0000 and so on for a path.
fs::path numbered(const fs::path& file, std::size_t i, bool path) {
  if (file.empty() || !path) return file;
  return file.parent_path() / fmt::format("{}_{:04}{}", file.stem().string(), i, file.extension().string());
}

/// What one view writes; names that were not asked for are empty.
struct Outputs {
  fs::path colour, depth, index, confidence;
};

Outputs outputs_of(const Flags& flags, std::size_t i) {
  const bool path = !flags.path.empty();
  return {numbered(flags.output, i, path), numbered(flags.depth_out, i, path),
          numbered(flags.index_out, i, path), numbered(flags.confidence_out, i, path)};
}

void check_outputs(const Outputs& files, bool force) {
  for (const fs::path& file : {files.colour, files.depth, files.index, files.confidence})
    if (!file.empty()) check_output(file, force);
}

void write_outputs(const Outputs& files, const LightField& lf, const RenderedView& view,
                   const RenderOptions& options) {
  write_float(files.colour, view.colour, lf.type);
  if (files.depth.extension() == ".pfm")
    write_pfm(files.depth, depth_of(lf, view.disparity));
  else if (!files.depth.empty())
    write_float(files.depth, depth_preview(view.disparity, options.d_min, options.d_max), PixelType::u8);
  if (!files.index.empty()) write_index(files.index, view.plane);
  if (!files.confidence.empty()) write_float(files.confidence, view.confidence, PixelType::u8);
}

void check_usage(const Flags& flags) {
  if (!flags.at.empty() && !flags.path.empty()) throw UsageError("--at and --path exclude each other");
  if (flags.focus_m && flags.focus_px) throw UsageError("--focus and --focus-px exclude each other");
  if ((flags.focus_m || flags.focus_px) && flags.mode != "focal-plane")
    throw UsageError("--focus and --focus-px need --mode focal-plane");
  if (!exists(method_from_name(flags.method), backend_from_name(flags.backend)))
    throw UsageError("--method fast runs on the CPU; use --method exact with --backend gl");
  check_name("-o", flags.output, {".png", ".tif", ".tiff", ".jpg", ".jpeg", ".exr", ".pfm"});
  check_name("--depth-out", flags.depth_out, {".pfm", ".png"});
  check_name("--index-out", flags.index_out, {".pfm", ".png", ".tif", ".tiff"});
  check_name("--confidence-out", flags.confidence_out, {".pfm", ".png", ".tif", ".tiff"});
}

Json statistics_of(const Viewpoint& at, const Outputs& files, const RenderedView& view) {
  Json skipped = Json::object();
  for (const Skipped& s : view.statistics.skipped) skipped[s.reason] = s.fraction;
  double confidence = 0;
  std::size_t seen = 0;
  for (const float c : view.confidence.data) confidence += c;
  for (const int n : view.plane.data) seen += n >= 0 ? 1 : 0;
  const double pixels = static_cast<double>(view.plane.data.size());
  Json stages = Json::object();
  for (const auto& [stage, ms] : view.statistics.stages_ms) stages[stage] = ms;
  return {{"file", files.colour.string()},
          {"at", {at.s, at.t, at.z}},
          {"width", at.width},
          {"height", at.height},
          {"milliseconds", view.statistics.milliseconds},
          {"stages_ms", stages},
          {"evaluated_fraction", view.statistics.evaluated_fraction},
          {"skipped", skipped},
          {"seen_fraction", static_cast<double>(seen) / pixels},
          {"mean_confidence", confidence / pixels}};
}

int run(const Flags& flags) {
  check_usage(flags);
  const LightFieldReader reader(open_light_field(flags.scene));
  const LightField& lf = reader.light_field();
  for (const std::string& name : flags.leave_out)
    if (const int i = lf.view_index(name);
        i < 0 || lf.views[static_cast<std::size_t>(i)].role != ViewRole::input)
      throw UsageError(fmt::format("--leave-out {}: the scene has no input view of that name", name));
  const std::vector<Viewpoint> viewpoints = viewpoints_of(flags, lf);
  const bool all_planes = flags.mode == "all-in-focus";
  RenderOptions options;
  options.window = flags.window;
  options.k = filter_of(flags.filter);
  options.skips = parse_skips(flags.no_skip);
  set_weights(flags, options);
  if (all_planes)
    set_range(flags, reader, options);
  else
    options.d_min = options.d_max = focus_of(flags, reader);
  options.planes = flags.planes > 0 ? flags.planes : planes_needed(lf, options.d_min, options.d_max);
  for (std::size_t i = 0; i < viewpoints.size(); ++i) check_outputs(outputs_of(flags, i), flags.force);

  const auto renderer = make_renderer(method_from_name(flags.method), backend_from_name(flags.backend),
                                      reader, flags.leave_out);
  const Reporter reporter = console_reporter();
  Json views = Json::array();
  for (std::size_t i = 0; i < viewpoints.size(); ++i) {
    const Outputs files = outputs_of(flags, i);
    const RenderedView view = all_planes ? renderer->all_in_focus(viewpoints[i], options, reporter)
                                         : renderer->focal_plane(viewpoints[i], options.d_min, options.k);
    write_outputs(files, lf, view, options);
    views.push_back(statistics_of(viewpoints[i], files, view));
  }
  Json result = {{"scene", flags.scene.string()},
                 {"mode", flags.mode},
                 {"filter", flags.filter},
                 {"backend", flags.backend}};
  if (all_planes) {
    result["method"] = flags.method;
    result["planes"] = options.planes;
    result["window"] = options.window;
    result["disparity_px"] = {options.d_min, options.d_max};
  } else {
    result["focus_px"] = options.d_min;
  }
  result["views"] = views;
  write_result(flags, result);
  return kDone;
}

}  // namespace

void add_render_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand("render",
                                         "Makes new views of a light field, with depth.\n\n"
                                         "  stuv render knights_scene -o knights.png --planes 41 --window 3 "
                                         "--depth-out knights.pfm\n");
  command->add_option("scene", flags->scene, "The scene's folder")->required();
  command->add_option("-o,--output", flags->output, "The picture")->required()->type_name("FILE");
  command
      ->add_option(
          "--at", flags->at,
          "Viewpoint, in the scene's unit; without Z on the cameras' own surface [middle of the lattice]")
      ->type_name("S,T[,Z]");
  command->add_option("--path", flags->path, "A viewpoint s,t,z per line; pictures out_0000.png and so on")
      ->type_name("CSV");
  command->add_option("--size", flags->size, "Size of the picture; keeps the field of view [the views']")
      ->type_name("WxH");
  command->add_option("--mode", flags->mode, "all-in-focus or focal-plane [all-in-focus]")
      ->check(CLI::IsMember({"all-in-focus", "focal-plane"}));
  command->add_option("--focus", flags->focus_m, "Depth of the focal plane [m]")->type_name("Z");
  command->add_option("--focus-px", flags->focus_px, "Disparity of the focal plane [px per unit of s]")
      ->type_name("D");
  command
      ->add_option("--filter", flags->filter,
                   "normal, wide or skipped; all in focus: the filter k of the picture [normal]")
      ->check(CLI::IsMember({"normal", "wide", "skipped"}));
  command
      ->add_option("--method", flags->method, "How to find what is in focus: literal, exact or fast [exact]")
      ->check(CLI::IsMember({"literal", "exact", "fast"}));
  command->add_option("--planes", flags->planes, "Number of focal planes N [as many as `stuv plan` says]")
      ->check(CLI::Range(1, kMostCount));
  command->add_option("--window", flags->window, "Half-width M of the window [7]")
      ->check(CLI::Range(0, kMostCount));
  command
      ->add_option("--weights", flags->weights,
                   "a_kl of equation 5: normal and wide, normal and skipped, wide and skipped [1,1,0]")
      ->type_name("A01,A02,A12");
  command
      ->add_option("--disparity", flags->disparity,
                   "Range to search [px per unit of s] [the scene's, or found in the pictures]")
      ->type_name("MIN,MAX");
  command->add_option("--depth-m", flags->depth_m, "Range to search [m]")->type_name("NEAR,FAR");
  command->add_option("--leave-out", flags->leave_out, "A camera not to use; may be repeated")
      ->type_name("NAME");
  command->add_option("--backend", flags->backend, "cpu or gl [cpu]")->check(CLI::IsMember({"cpu", "gl"}));
  command
      ->add_option("--depth-out", flags->depth_out,
                   "Depth [m]; disparity of a scene without metres. As .png: grey, near is bright")
      ->type_name("FILE");
  command
      ->add_option("--index-out", flags->index_out,
                   "Number of the plane, 0 is the farthest; .pfm, or 16-bit picture with 65535 for none")
      ->type_name("FILE");
  command->add_option("--confidence-out", flags->confidence_out, "Confidence 0..1; .pfm or picture")
      ->type_name("FILE");
  command
      ->add_option("--no-skip", flags->no_skip,
                   "What `fast` is not to leave out, separated by commas: " + skip_names())
      ->type_name("LIST");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
