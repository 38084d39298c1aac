#include <fmt/format.h>

#include "app/commands.h"
#include "app/console.h"
#include "capture/capture.h"
#include "capture/config.h"
#include "core/files.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path config, output;
  std::string pattern, grid;
  std::size_t sets = 0;
  bool copy = false, complete = false;
};

void check_usage(const Flags& flags) {
  const bool files = !flags.pattern.empty();
  if (files && !flags.config.empty())
    throw UsageError("CONFIG and --files exclude each other: give one of them");
  if (files && flags.grid.empty()) throw UsageError("--files needs --grid ROWSxCOLS");
  if (!files && !flags.grid.empty())
    throw UsageError("--grid belongs to --files; a config has its own rows and cols");
  if (files && flags.pattern.find("{camera}") == std::string::npos)
    throw UsageError("--files wants a pattern with {camera}, and {set} where there are several sets");
}

CaptureConfig config_of(const Flags& flags) {
  if (flags.pattern.empty()) {
    CaptureConfig config =
        flags.config.empty() ? default_capture_config() : read_capture_config(flags.config);
    if (auto* files = std::get_if<FilesOptions>(&config)) {
      files->copy |= flags.copy;
      files->complete |= flags.complete;
    } else if (flags.copy) {
      throw UsageError("--copy belongs to files, and this config is a synthetic rig");
    }
    return config;
  }
  FilesOptions files;
  files.pattern = flags.pattern;
  std::tie(files.rows, files.cols) = parse_size("--grid", flags.grid);
  files.copy = flags.copy;
  files.complete = flags.complete;
  return files;
}

int run(const Flags& flags) {
  check_usage(flags);
  check_output(flags.output, flags.force);
  const Reporter reporter = console_reporter();
  const std::unique_ptr<Source> source = open_source(config_of(flags), reporter);
  CaptureOptions options;
  if (flags.sets > 0) options.sets = flags.sets;
  options.complete = flags.complete;
  options.force = flags.force;
  const CaptureResult result = capture(*source, flags.output, options, reporter);
  write_result(flags, {{"recording", flags.output.string()},
                       {"rows", source->rows()},
                       {"cols", source->cols()},
                       {"cameras", source->cameras().size()},
                       {"sets", result.sets},
                       {"incomplete_sets", result.incomplete_sets},
                       {"frames", result.frames}});
  fmt::print("{}: {} sets of {} cameras, {} frames, {} incomplete\n", flags.output.string(), result.sets,
             source->cameras().size(), result.frames, result.incomplete_sets);
  return kDone;
}

}  // namespace

void add_capture_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand(
      "capture",
      "Records frame sets of all cameras.\n\n"
      "  stuv capture -o rec                      the built-in synthetic rig, 5x5 cameras\n"
      "  stuv capture --files 'Position{set}_Camera{camera}.png' --grid 1x20 -o rec\n");
  command->add_option("config", flags->config, "What to record, TOML (see configs/) [a synthetic 5x5 rig]");
  command->add_option("-o,--output", flags->output, "The recording's folder")->required()->type_name("REC");
  command->add_option("--files", flags->pattern, "Pictures on disk: a path with {set} and {camera}")
      ->type_name("PATTERN");
  command->add_option("--grid", flags->grid, "Places of the cameras, filled row by row in natural order")
      ->type_name("ROWSxCOLS");
  command->add_option("--sets", flags->sets, "Stop after so many sets [all there are]")
      ->check(CLI::PositiveNumber);
  command->add_flag("--copy", flags->copy, "Copy the pictures instead of referring to them");
  command->add_flag("--complete", flags->complete, "Fail if a set lacks a camera");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
