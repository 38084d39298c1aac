#include <fmt/format.h>

#include "app/commands.h"
#include "app/console.h"
#include "calib/interchange/import_views.h"
#include "core/files.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path source, output;
  std::string layout, disparity;
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

int run(const Flags& flags) {
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

}  // namespace

void add_import_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      app.add_subcommand("import",
                         "Makes a light field of somebody else's views.\n\n"
                         "  stuv import knights/views.csv -o knights_scene --disparity -347,231\n");
  command->add_option("source", flags->source, "views.csv (file,s,t,role), or a folder of views")->required();
  command->add_option("-o,--output", flags->output, "The scene's folder")->required()->type_name("SCENE");
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
