#include <fmt/format.h>

#include <chrono>

#include "app/commands.h"
#include "app/console.h"
#include "calib/check/check_rig.h"
#include "core/error.h"
#include "core/files.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path recording, rig, output;
  std::string set;
};

/// The named set, or the last one, whole or not: what is missing is part of the answer.
const FrameSet& set_to_check(const Recording& recording, const std::string& name) {
  const int index = name.empty() ? static_cast<int>(recording.sets.size()) - 1 : recording.set_index(name);
  if (index < 0)
    throw Error(recording.folder.string(),
                name.empty() ? std::string("has no set") : fmt::format("has no set {}", name),
                name.empty() ? "record one" : "see its folder sets/");
  return recording.sets[index];
}

std::string move_text(const CameraCheck& camera) {
  const Json json = to_json(camera);
  std::string text =
      fmt::format("  {} {}: {:.3f} +- {:.3f} degrees", camera.name, name_of(camera.status),
                  json["rotation_deg"].get<double>(), json["rotation_sigma_deg"].get<double>());
  if (camera.shift_known)
    text += fmt::format(", {:.2f} +- {:.2f} mm", json["translation_mm"].get<double>(),
                        json["translation_sigma_mm"].get<double>());
  return text + (camera.corrected ? ", can be corrected" : "");
}

void print_summary(const Flags& flags, const SceneCheck& check) {
  int ok = 0;
  for (const CameraCheck& camera : check.cameras) ok += camera.status == CheckStatus::ok ? 1 : 0;
  fmt::print("{}: {} of {} cameras stand where {} says\n", flags.recording.string(), ok, check.cameras.size(),
             flags.rig.string());
  for (const CameraCheck& camera : check.cameras)
    if (camera.status != CheckStatus::ok && camera.change) fmt::print("{}\n", move_text(camera));
  fmt::print("verdict: {}\n", check.good ? "good" : "not good");
  for (const std::string& reason : check.reasons) fmt::print("  {}\n", reason);
  for (const std::string& note : check.notes) fmt::print("note: {}\n", note);
}

void write_corrected(const Flags& flags, const Rig& rig, const SceneCheck& check) {
  Rig corrected = corrected_rig(rig, check);
  corrected.produced_by["corrected_by"] = {{"program", std::string("stuv ") + STUV_VERSION},
                                           {"recording", flags.recording.filename().string()}};
  AtomicOutput output(flags.output, AtomicOutput::Kind::folder, flags.force);
  write_rig(output.path(), corrected);
  output.commit();
}

int run(const Flags& flags) {
  const auto begin = std::chrono::steady_clock::now();
  if (!flags.output.empty()) check_output(flags.output, flags.force);
  const Recording recording = open_recording(flags.recording);
  const Rig rig = read_rig(flags.rig);
  const FrameSet& set = set_to_check(recording, flags.set);
  const Reporter reporter = console_reporter();
  for (const RecordedCamera& camera : recording.cameras)
    if (rig.camera_index(camera.name) < 0)
      reporter.warn(fmt::format("camera {} is not in the rig and is not checked", camera.name));
  const SceneCheck check = check_rig(find_evidence(recording, set, rig, {}, reporter), rig);
  if (!flags.output.empty()) write_corrected(flags, rig, check);
  Json result = to_json(check);
  result["set"] = set.name;
  result["seconds"] = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  write_result(flags, result);
  print_summary(flags, check);
  return check.good ? kDone : kVerdictNotGood;
}

}  // namespace

void add_check_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand(
      "check",
      "Is this rig still calibrated? Compares a recording of any scene with it, no board.\n\n"
      "  stuv check rec --rig rig\n"
      "  stuv check rec --rig rig -o corrected_rig --json check.json\n\n"
      "Exit code 3: some camera moved, was swapped, mirrored, turned over, or is missing.");
  command->add_option("recording", flags->recording, "The recording's folder")->required()->type_name("REC");
  command->add_option("--rig", flags->rig, "The rig's folder")->required()->type_name("RIG");
  command->add_option("-o,--output", flags->output, "Write the rig with what can be corrected put right")
      ->type_name("RIG2");
  command->add_option("--set", flags->set, "Frame set to look at [the last one]");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
