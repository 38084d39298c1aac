#pragma once

#include <CLI/CLI.hpp>
#include <functional>

namespace stuv {

/// What to run once the command line is parsed; set by the callback of the chosen command.
using Action = std::function<int()>;

// One function a command, in app/NAME_command.cpp: adds the command with its flags and, when it is chosen,
// sets `action`.
void add_cameras_command(CLI::App& app, Action& action);
void add_capture_command(CLI::App& app, Action& action);
void add_board_command(CLI::App& app, Action& action);
void add_calibrate_command(CLI::App& app, Action& action);
void add_check_command(CLI::App& app, Action& action);
void add_export_command(CLI::App& app, Action& action);
void add_import_command(CLI::App& app, Action& action);
void add_track_command(CLI::App& app, Action& action);
void add_rectify_command(CLI::App& app, Action& action);
void add_plan_command(CLI::App& app, Action& action);
void add_render_command(CLI::App& app, Action& action);
void add_two_view_command(CLI::App& app, Action& action);
void add_view_command(CLI::App& app, Action& action);
void add_bench_command(CLI::App& app, Action& action);

}  // namespace stuv
