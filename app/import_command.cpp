#include <fmt/format.h>

#include <cmath>

#include "app/camera_formats.h"
#include "app/commands.h"
#include "app/console.h"
#include "calib/interchange/import_views.h"
#include "core/files.h"
#include "core/rig.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path source, output;
  std::string layout, disparity, format;
  double unit_m = 1, fit_px = 0.01;
  double focal_px = 0, converge_m = std::numeric_limits<double>::infinity();
};

ViewLayout layout_of(const Flags& flags) {
  if (flags.layout == "stanford") return ViewLayout::stanford;
  if (flags.layout == "hci") return ViewLayout::hci;
  return ViewLayout::csv;
}

ImportOptions options_of(const Flags& flags) {
  ImportOptions options;
  options.layout = layout_of(flags);
  options.focal_px = flags.focal_px;
  options.converge_m = flags.converge_m;
  if (options.layout == ViewLayout::hci && flags.focal_px > 0)
    throw UsageError(
        "--focal-px: HCI positions are camera steps, so a focal length alone gives no metres; leave it away");
  if (!flags.disparity.empty()) {
    std::tie(options.d_min, options.d_max) = parse_pair("--disparity", flags.disparity);
    if (!(options.d_min <= options.d_max))
      throw UsageError("--disparity wants MIN,MAX with MIN <= MAX (larger is nearer)");
  }
  return options;
}

/// Cameras of another tool's file make a rig, views a scene.
std::optional<CameraFormat> camera_format_of(const Flags& flags) {
  if (!flags.format.empty()) return parse_camera_format("--format", flags.format);
  if (!flags.layout.empty() || flags.source.extension() == ".csv") return std::nullopt;
  if (std::filesystem::exists(flags.source / "views.csv")) return std::nullopt;
  return recognise_cameras(flags.source);
}

int run_cameras(const Flags& flags, CameraFormat format) {
  if (!(flags.unit_m > 0) || !std::isfinite(flags.unit_m)) throw UsageError("--unit-m wants metres above 0");
  const Reporter reporter = console_reporter();
  LensFits fits;
  fits.most_px = flags.fit_px;
  AtomicOutput output(flags.output, AtomicOutput::Kind::folder, flags.force);
  Rig rig = rig_of(read_cameras(flags.source, format, fits), flags.unit_m, flags.source.string());
  rig.produced_by = {{"program", std::string("stuv ") + STUV_VERSION},
                     {"imported_from", name_of(format)},
                     {"file", flags.source.filename().string()},
                     {"lens_fits", fits_json(fits)}};
  write_rig(output.path(), rig);
  output.commit();
  print_fits(fits, reporter);
  write_result(flags, {{"rig", flags.output.string()},
                       {"format", name_of(format)},
                       {"rows", rig.rows},
                       {"cols", rig.cols},
                       {"cameras", rig.cameras.size()},
                       {"lens_fits", fits_json(fits)}});
  fmt::print("{}: {} cameras on a {}x{} lattice, from {}\n", flags.output.string(), rig.cameras.size(),
             rig.rows, rig.cols, name_of(format));
  return kDone;
}

int run_views(const Flags& flags) {
  const ImportOptions options = options_of(flags);
  AtomicOutput output(flags.output, AtomicOutput::Kind::folder, flags.force);
  const LightField lf = import_views(flags.source, output.path(), options, console_reporter());
  output.commit();
  const std::size_t inputs = lf.views_with(ViewRole::input).size();
  write_result(flags, {{"scene", flags.output.string()},
                       {"rows", lf.rows},
                       {"cols", lf.cols},
                       {"inputs", inputs},
                       {"truths", lf.views.size() - inputs},
                       {"metric", lf.metric}});
  fmt::print("{}: {} views on a {}x{} lattice, {} held out, {}x{} px{}\n", flags.output.string(), inputs,
             lf.rows, lf.cols, lf.views.size() - inputs, lf.width, lf.height,
             lf.metric ? "" : ", no metres (no --focal-px)");
  return kDone;
}

int run(const Flags& flags) {
  if (!flags.format.empty() && !flags.layout.empty())
    throw UsageError("--format is for cameras, --layout for views: give one");
  const auto format = camera_format_of(flags);
  return format ? run_cameras(flags, *format) : run_views(flags);
}

}  // namespace

void add_import_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand(
      "import",
      "Makes a light field of somebody else's views, or a rig of somebody else's cameras.\n\n"
      "  stuv import knights/views.csv -o knights_scene --disparity -347,231\n"
      "  stuv import camchain.yaml -o rig\n"
      "  stuv import colmap_model -o rig --format colmap --unit-m 0.001\n\n"
      "`stuv export` writes cameras for other tools.");
  command
      ->add_option("source", flags->source,
                   "views.csv (file,s,t,role) or a folder of views; or a file or folder of cameras")
      ->required();
  command->add_option("-o,--output", flags->output, "The scene's or the rig's folder")
      ->required()
      ->type_name("OUT");
  command
      ->add_option("--format", flags->format,
                   "Whose cameras: " + format_names() + " [by the files' names and contents]")
      ->type_name("FORMAT");
  command->add_option("--unit-m", flags->unit_m, "Of cameras: metres in the file's unit of length [1]");
  command
      ->add_option("--fit-px", flags->fit_px,
                   "Of fisheye cameras: error up to which mrcal's splined lens may stand for them [0.01]")
      ->check(CLI::NonNegativeNumber);
  command->add_option("--layout", flags->layout, "How views are named: csv, stanford, hci [csv]")
      ->check(CLI::IsMember({"csv", "stanford", "hci"}));
  command->add_option("--focal-px", flags->focal_px, "Focal length [px]; gives the scene metres")
      ->check(CLI::Range(1e-6, 1e9));
  command->add_option("--converge-m", flags->converge_m, "Depth at which the views converge [m] [infinity]")
      ->check(CLI::Range(1e-6, 1e9));
  command
      ->add_option("--disparity", flags->disparity, "Range of the scene, px per unit of s, larger is nearer")
      ->type_name("MIN,MAX");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
