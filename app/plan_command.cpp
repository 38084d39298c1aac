#include <fmt/format.h>

#include <cmath>
#include <optional>

#include "app/commands.h"
#include "app/console.h"
#include "app/search_range.h"
#include "render/plan/sampling.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path scene;
  std::string grid, spacing_m, depth_m, disparity;
  std::optional<double> bandwidth;
};

/// "A" or "A,B".
std::pair<double, double> parse_spacing(const std::string& text) {
  return text.find(',') == std::string::npos ? parse_pair("--spacing-m", text + "," + text)
                                             : parse_pair("--spacing-m", text);
}

SamplingProblem problem_of_numbers(const Flags& flags) {
  if (flags.grid.empty() || flags.spacing_m.empty() || flags.depth_m.empty() || !flags.bandwidth)
    throw UsageError("plan wants SCENE, or --grid, --spacing-m, --depth-m and --bandwidth");
  SamplingProblem p;
  std::tie(p.rows, p.cols) = parse_size("--grid", flags.grid);
  std::tie(p.spacing_s, p.spacing_t) = parse_spacing(flags.spacing_m);
  const auto [near_m, far_m] = parse_pair("--depth-m", flags.depth_m);
  if (!(near_m > 0 && near_m <= far_m)) throw UsageError("--depth-m wants 0 < NEAR <= FAR");
  p.inverse_near = 1 / near_m;
  p.inverse_far = 1 / far_m;
  p.bandwidth = *flags.bandwidth;
  return p;
}

Json number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

/// Lengths in the scene's unit: metres as mm, else as they are.
std::string length(double value, bool metric) {
  if (!std::isfinite(value)) return "any";
  return metric ? fmt::format("{:.2f} mm", value * 1e3) : fmt::format("{:.4g}", value);
}

std::string depth(double inverse) {
  return inverse > 1e-9 ? fmt::format("{:.3f} m", 1 / inverse) : "infinity";
}

/// Depth of metric problems, disparity of others.
std::string place(const LightField* lf, double inverse) {
  if (lf == nullptr || lf->metric) return depth(inverse);
  return fmt::format("{:.2f} px", lf->disparity(inverse));
}

void print_plan(const SamplingProblem& p, const SamplingPlan& plan, const LightField* lf) {
  const bool metric = lf == nullptr || lf->metric;
  fmt::print(
      "A plain light field needs cameras at most {} apart: {:.0f} cameras, {:.4g} times the {} there are.\n",
      length(plan.max_spacing, metric), plan.cameras_needed, plan.factor, p.rows * p.cols);
  fmt::print("Its one focal plane is best at {}.\n", place(lf, plan.inverse_optimum));
  if (plan.one_plane_is_enough)
    fmt::print("The three filters agree over the whole depth: one focal plane is enough.\n");
  else
    fmt::print("The three filters want spacings of at most {} to do with one plane; with these, {} planes.\n",
               length(plan.max_spacing_three_filters, metric), plan.planes.size());
  fmt::print("{:>6} {:>12}   in focus\n", "plane", "at");
  for (std::size_t n = 0; n < plan.planes.size(); ++n) {
    const FocalPlane& f = plan.planes[n];
    fmt::print("{:>6} {:>12}   {} to {}\n", n, place(lf, f.inverse_depth), place(lf, f.inverse_far),
               place(lf, f.inverse_near));
  }
}

Json json_of(const SamplingProblem& p, const SamplingPlan& plan, const LightField* lf) {
  const bool metric = lf == nullptr || lf->metric;
  Json planes = Json::array();
  for (const FocalPlane& f : plan.planes) {
    Json plane = {{"inverse_depth", f.inverse_depth}, {"in_focus", {f.inverse_far, f.inverse_near}}};
    if (metric) plane["depth_m"] = f.inverse_depth > 0 ? Json(1 / f.inverse_depth) : Json(nullptr);
    if (lf != nullptr) plane["disparity_px"] = lf->disparity(f.inverse_depth);
    planes.push_back(plane);
  }
  Json out = {{"grid", {p.rows, p.cols}},
              {"cameras", p.rows * p.cols},
              {"bandwidth", p.bandwidth},
              {metric ? "spacing_m" : "spacing", {p.spacing_s, p.spacing_t}},
              {metric ? "max_spacing_m" : "max_spacing", number(plan.max_spacing)},
              {metric ? "max_spacing_three_filters_m" : "max_spacing_three_filters",
               number(plan.max_spacing_three_filters)},
              {"cameras_needed", plan.cameras_needed},
              {"factor", plan.factor},
              {"one_plane_is_enough", plan.one_plane_is_enough},
              {"planes", plan.planes.size()},
              {"focal_planes", planes}};
  if (metric) out["z_opt_m"] = plan.inverse_optimum > 0 ? Json(1 / plan.inverse_optimum) : Json(nullptr);
  return out;
}

int run(const Flags& flags) {
  if (flags.scene.empty()) {
    const SamplingProblem p = problem_of_numbers(flags);
    if (!(p.bandwidth > 0)) throw UsageError("--bandwidth wants a number above 0");
    if (!(p.spacing_s > 0 && p.spacing_t > 0)) throw UsageError("--spacing-m wants numbers above 0");
    const SamplingPlan plan = plan_sampling(p);
    print_plan(p, plan, nullptr);
    write_result(flags, json_of(p, plan, nullptr));
    return kDone;
  }
  if (!flags.grid.empty() || !flags.spacing_m.empty())
    throw UsageError("plan takes SCENE or --grid and --spacing-m, not both");
  const LightFieldReader reader(open_light_field(flags.scene));
  const LightField& lf = reader.light_field();
  const SearchRange range = search_range(reader, {flags.disparity, flags.depth_m, {}});
  SamplingProblem p = sampling_problem(lf, range.d_min, range.d_max);
  if (flags.bandwidth) p.bandwidth = *flags.bandwidth;
  if (!(p.bandwidth > 0)) throw UsageError("--bandwidth wants a number above 0");
  const SamplingPlan plan = plan_sampling(p);
  fmt::print("Disparity {:.4g} to {:.4g} px per unit of s ({}).\n", range.d_min, range.d_max, range.from);
  print_plan(p, plan, &lf);
  Json result = json_of(p, plan, &lf);
  result["disparity_px"] = {range.d_min, range.d_max};
  result["range_from"] = range.from;
  write_result(flags, result);
  return kDone;
}

}  // namespace

void add_plan_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand(
      "plan",
      "What plenoptic sampling asks for: camera spacing, number of cameras, focal planes.\n\n"
      "  stuv plan --grid 9x9 --spacing-m 0.008 --depth-m 0.33,1.84 --bandwidth 300\n");
  command->add_option("scene", flags->scene, "The scene's folder; or describe one by the flags");
  command->add_option("--grid", flags->grid, "Rows and columns of cameras")->type_name("ROWSxCOLS");
  command
      ->add_option("--spacing-m", flags->spacing_m,
                   "Between neighbours along s, and along t if it differs [m]")
      ->type_name("S[,T]");
  command->add_option("--depth-m", flags->depth_m, "Nearest and farthest depth [m]")->type_name("NEAR,FAR");
  command->add_option("--disparity", flags->disparity, "Range of a scene [px per unit of s]")
      ->type_name("MIN,MAX");
  command->add_option("--bandwidth", flags->bandwidth,
                      "Highest frequency K_fu f [cycles per unit tangent] [half a cycle a pixel]");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
