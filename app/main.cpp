#include <malloc.h>

#include <fmt/format.h>

#include <new>

#include "app/commands.h"
#include "app/console.h"
#include "core/error.h"

int main(int argc, char** argv) {
  // Pictures of one size come and go: their memory is kept, as the kernel clears what it hands out anew.
  mallopt(M_MMAP_THRESHOLD, 1 << 30);
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  using namespace stuv;
  CLI::App app(
      "From a camera array to pictures that are sharp everywhere.\n\n"
      "  stuv capture -o rec && stuv calibrate rec -o rig && stuv rectify rec --rig rig -o scene\n"
      "  stuv render scene -o all_in_focus.png --planes 64");
  app.set_version_flag("--version", std::string("stuv ") + STUV_VERSION);
  app.require_subcommand(1);
  Action action;
  add_cameras_command(app, action);
  add_capture_command(app, action);
  add_board_command(app, action);
  add_calibrate_command(app, action);
  add_check_command(app, action);
  add_import_command(app, action);
  add_export_command(app, action);
  add_rectify_command(app, action);
  add_plan_command(app, action);
  add_render_command(app, action);
  add_view_command(app, action);
  add_bench_command(app, action);
  add_track_command(app, action);
  add_two_view_command(app, action);
  app.failure_message(
      [](const CLI::App*, const CLI::Error& e) { return fmt::format("stuv: {}; see --help\n", e.what()); });
  try {
    app.parse(argc, argv);
    return action();
  } catch (const CLI::ParseError& e) {
    // CLI11's own codes lie above 100; help and version are its 0.
    return app.exit(e) == 0 ? kDone : kWrongUsage;
  } catch (const UsageError& e) {
    fmt::print(stderr, "stuv: {}\n", e.what());
    return kWrongUsage;
  } catch (const std::bad_alloc&) {
    fmt::print(stderr, "stuv: out of memory; use smaller pictures or fewer planes\n");
    return kFailed;
  } catch (const std::exception& e) {
    fmt::print(stderr, "stuv: {}\n", e.what());
    return kFailed;
  }
}
