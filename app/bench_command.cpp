#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <thread>

#include "app/commands.h"
#include "app/console.h"
#include "core/error.h"
#include "core/files.h"
#include "render/all_in_focus.h"
#include "render/machine_limits.h"
#include "render/metrics.h"
#include "render/renderer.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path scene, output;
  std::string methods = "literal", planes = "13", backends = "cpu", disparity, no_skip;
  int window = RenderOptions{}.window, views = 0, border = 0;
};

/// The views to compare with: held-out truths within the inputs' bounding box, or, without any, the inputs in
/// turn.
std::vector<int> compared_views(const LightField& lf, int wanted) {
  const std::vector<int> inputs = lf.views_with(ViewRole::input);
  double s0 = INFINITY, s1 = -INFINITY, t0 = INFINITY, t1 = -INFINITY;
  for (const int i : inputs) {
    s0 = std::min(s0, lf.views[i].s);
    s1 = std::max(s1, lf.views[i].s);
    t0 = std::min(t0, lf.views[i].t);
    t1 = std::max(t1, lf.views[i].t);
  }
  std::vector<int> all;
  const std::vector<int> truths = lf.views_with(ViewRole::truth);
  for (const int i : truths) {
    const View& view = lf.views[i];
    if (view.s >= s0 && view.s <= s1 && view.t >= t0 && view.t <= t1) all.push_back(i);
  }
  if (!truths.empty() && all.empty())
    throw Error(lf.folder.string(), "has no truth view between its inputs",
                "import it with truth rows inside the cameras' box, or with none");
  if (truths.empty() && inputs.size() > 1) all = inputs;
  if (all.empty())
    throw Error(lf.folder.string(), "has no held-out view and only one input", "import it with truth rows");
  const auto n = static_cast<int>(all.size());
  if (wanted <= 0 || wanted >= n) return all;
  std::vector<int> chosen;
  chosen.reserve(static_cast<std::size_t>(wanted));
  for (int i = 0; i < wanted; ++i) chosen.push_back(all[static_cast<int>((i + 0.5) * n / wanted)]);
  return chosen;
}

std::string machine() {
  std::string cpu = "unknown processor";
  std::ifstream in("/proc/cpuinfo");
  for (std::string line; std::getline(in, line);)
    if (line.rfind("model name", 0) == 0) {
      cpu = line.substr(line.find(':') + 2);
      break;
    }
  return fmt::format("{}, {} threads", cpu, std::thread::hardware_concurrency());
}

double quantile(std::vector<double> values, double q) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(std::lround(q * static_cast<double>(values.size() - 1)))];
}

/// Forgets the process's peak of resident memory, where the kernel lets us.
void reset_peak_memory() { std::ofstream("/proc/self/clear_refs") << 5; }

double peak_memory_mb() {
  std::ifstream in("/proc/self/status");
  for (std::string line; std::getline(in, line);)
    if (line.rfind("VmHWM:", 0) == 0) return std::stod(line.substr(6)) / 1024;
  return std::nan("");
}

/// The place of a view, with its own principal point: then nothing but rendering is compared.
Viewpoint viewpoint_of(const LightField& lf, const View& view) {
  Viewpoint out = default_viewpoint(lf, view.s, view.t, view.w);
  out.cx_px = view.cx_px;
  out.cy_px = view.cy_px;
  return out;
}

struct Case {
  std::string method, backend;
  RenderOptions options;
};

/// How near a picture came to what the machine can do: the largest part of any limit, and which.
struct Reached {
  double part = std::nan("");
  const char* limit = nullptr;
};

Reached reached(const RenderedView::Statistics& work, const MachineLimits& limits) {
  Reached out;
  const auto consider = [&](const char* name, double amount, double per_s) {
    if (!(amount > 0 && per_s > 0)) return;
    const double part = amount / per_s / (work.milliseconds * 1e-3);
    if (out.limit == nullptr || part > out.part) out = {part, name};
  };
  consider("multiply-adds", work.multiply_adds, limits.multiply_adds_per_s);
  consider("memory", work.bytes, limits.bytes_per_s);
  consider("texels", work.texels, limits.texels_per_s);
  return out;
}

/// A view is rendered so many times and so long, for its median, unless it takes long: a GPU that was idle is
/// slow at first.
constexpr std::size_t kRepeats = 3;
constexpr double kLeast_ms = 250;
constexpr double kSlow_ms = 2000;

Json measure(const LightFieldReader& reader, const Case& c, const Flags& flags, const MachineLimits& limits,
             const Reporter& reporter) {
  const LightField& lf = reader.light_field();
  const std::vector<int> compared = compared_views(lf, flags.views);
  std::unique_ptr<Renderer> renderer;
  std::vector<double> ms, parts;
  const char* limit = nullptr;
  double psnr = 0, similarity = 0, evaluated = 0;
  reset_peak_memory();
  for (const int i : compared) {
    const View& truth = lf.views[i];
    const bool leave_out = truth.role == ViewRole::input;
    // Views that are held out anyway share one renderer: its views are then loaded once.
    if (!renderer || leave_out)
      renderer = make_renderer(method_from_name(c.method), backend_from_name(c.backend), reader,
                               leave_out ? std::vector{truth.name} : std::vector<std::string>{});
    // Each view on its own: pixels in memory, nothing known from the view before.
    renderer->load(viewpoint_of(lf, truth), c.options);
    RenderedView view;
    std::vector<double> repeats;
    double total_ms = 0;
    do {
      renderer->forget();
      view = renderer->all_in_focus(viewpoint_of(lf, truth), c.options);
      repeats.push_back(view.statistics.milliseconds);
      total_ms += repeats.back();
    } while ((repeats.size() < kRepeats || total_ms < kLeast_ms) && repeats.front() < kSlow_ms);
    const ImageF expected = reader.read(i).colour;
    view.statistics.milliseconds = quantile(repeats, 0.5);
    ms.push_back(view.statistics.milliseconds);
    if (const Reached at = reached(view.statistics, limits); at.limit != nullptr) {
      parts.push_back(at.part);
      limit = at.limit;
    }
    psnr += psnr_db(view.colour, expected, flags.border);
    similarity += ssim(view.colour, expected, flags.border);
    evaluated += view.statistics.evaluated_fraction;
    reporter.at(fmt::format("{}, {}, N = {}", c.method, c.backend, c.options.planes), ms.size(),
                compared.size());
  }
  const auto n = static_cast<double>(compared.size());
  const auto number = [](double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); };
  return {{"method", c.method},
          {"backend", c.backend},
          {"planes", c.options.planes},
          {"window", c.options.window},
          {"views", compared.size()},
          {"ms_median", quantile(ms, 0.5)},
          {"ms_p95", quantile(ms, 0.95)},
          {"psnr_db", number(psnr / n)},
          {"ssim", number(similarity / n)},
          {"evaluated_fraction", evaluated / n},
          {"peak_mb", number(peak_memory_mb())},
          {"limit", limit == nullptr ? Json(nullptr) : Json(limit)},
          {"limit_fraction", parts.empty() ? Json(nullptr) : Json(quantile(parts, 0.5))}};
}

std::vector<int> parse_planes(const std::string& text) {
  std::vector<int> planes;
  for (const std::string& part : parse_list("--planes", text)) {
    const bool whole = part.size() < 6 && part.find_first_not_of("0123456789") == std::string::npos;
    if (!whole || std::stoi(part) < 1)
      throw UsageError(fmt::format("--planes wants whole numbers above 0, not '{}'", part));
    planes.push_back(std::stoi(part));
  }
  return planes;
}

void print_row(const Json& row) {
  const auto number = [&](const char* key) { return row[key].is_null() ? NAN : row[key].get<double>(); };
  fmt::print("{:<8} {:<4} {:>6} {:>6} {:>5} {:>10.1f} {:>8.2f} {:>7.4f} {:>9.3f} {:>8.0f} {}\n",
             row["method"].get<std::string>(), row["backend"].get<std::string>(), row["planes"].get<int>(),
             row["window"].get<int>(), row["views"].get<int>(), number("ms_median"), number("psnr_db"),
             number("ssim"), number("evaluated_fraction"), number("peak_mb"),
             row["limit"].is_null() ? "-"
                                    : fmt::format("{:4.0f} % of {}", 100 * number("limit_fraction"),
                                                  row["limit"].get<std::string>()));
}

RenderOptions options_of(const Flags& flags, const LightField& lf) {
  RenderOptions options;
  options.window = flags.window;
  options.skips = parse_skips(flags.no_skip);
  options.d_min = lf.d_min;
  options.d_max = lf.d_max;
  if (!flags.disparity.empty()) std::tie(options.d_min, options.d_max) = parse_disparity(flags.disparity);
  if (!(options.d_min <= options.d_max))
    throw Error(flags.scene.string(), "has no depth range", "give --disparity MIN,MAX");
  if (2 * flags.border >= std::min(lf.width, lf.height))
    throw UsageError(
        fmt::format("--border {} leaves nothing of {}x{} pixels", flags.border, lf.width, lf.height));
  return options;
}

int run(const Flags& flags) {
  const std::vector<std::string> methods = parse_list("--methods", flags.methods);
  for (const std::string& method : methods)
    if (method != "literal" && method != "exact" && method != "fast")
      throw UsageError(fmt::format("--methods: there is no '{}'; literal, exact, fast", method));
  const std::vector<std::string> backends = parse_list("--backend", flags.backends);
  for (const std::string& backend : backends)
    if (backend != "cpu" && backend != "gl")
      throw UsageError(fmt::format("--backend: there is no '{}'; cpu, gl", backend));
  if (methods == std::vector<std::string>{"fast"} && backends == std::vector<std::string>{"gl"})
    throw UsageError("--methods fast runs on the CPU; use --backend cpu");
  const std::vector<int> planes = parse_planes(flags.planes);
  const LightFieldReader reader(open_light_field(flags.scene));
  Case c{"", "", options_of(flags, reader.light_field())};
  check_output(flags.output, flags.force);
  const Reporter reporter = console_reporter();
  const MachineLimits limits =
      measure_machine_limits(std::find(backends.begin(), backends.end(), "gl") != backends.end());
  fmt::print("this machine: {}; {:.1f} G multiply-adds/s, {:.1f} GB/s", machine(),
             limits.multiply_adds_per_s * 1e-9, limits.bytes_per_s * 1e-9);
  if (limits.texels_per_s > 0) fmt::print(", {:.2f} G texels/s", limits.texels_per_s * 1e-9);
  fmt::print("\n");
  Json rows = Json::array();
  fmt::print("{:<8} {:<4} {:>6} {:>6} {:>5} {:>10} {:>8} {:>7} {:>9} {:>8} {}\n", "method", "on", "planes",
             "window", "views", "ms/view", "PSNR dB", "SSIM", "evaluated", "peak MB", "reached");
  for (const std::string& method : methods)
    for (const std::string& backend : backends)
      for (const int n : planes) {
        if (!exists(method_from_name(method), backend_from_name(backend))) continue;
        c.method = method;
        c.backend = backend;
        c.options.planes = n;
        rows.push_back(measure(reader, c, flags, limits, reporter));
        print_row(rows.back());
      }
  const Json result = {
      {"scene", flags.scene.string()},
      {"machine", machine()},
      {"limits",
       {{"multiply_adds_per_s", limits.multiply_adds_per_s},
        {"bytes_per_s", limits.bytes_per_s},
        {"texels_per_s", limits.texels_per_s > 0 ? Json(limits.texels_per_s) : Json(nullptr)}}},
      {"rows", rows}};
  write_json(flags.output, result);
  write_result(flags, result);
  return kDone;
}

}  // namespace

void add_bench_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command =
      app.add_subcommand("bench",
                         "Run time against error, on held-out views.\n\n"
                         "  stuv bench knights_scene -o bench.json --planes 41 --window 3 --border 24\n");
  command->add_option("scene", flags->scene, "The scene's folder")->required()->type_name("SCENE");
  command->add_option("-o,--output", flags->output, "The table as JSON")->required()->type_name("FILE");
  command->add_option("--methods", flags->methods, "Methods, separated by commas [literal]");
  command->add_option("--planes", flags->planes, "Numbers of focal planes [13]");
  command->add_option("--window", flags->window, "M: windows have (2M + 1)^2 pixels [7]")
      ->check(CLI::Range(0, kMostCount));
  command->add_option("--backend", flags->backends, "cpu, gl or cpu,gl [cpu]; fast runs on cpu only");
  command->add_option("--views", flags->views, "Compare K of the held-out views, spread evenly [all]")
      ->check(CLI::Range(0, kMostCount));
  command->add_option("--border", flags->border, "Pixels left out at every side [0]")
      ->check(CLI::Range(0, kMostCount));
  command->add_option("--disparity", flags->disparity, "Range of the planes, px per unit of s [the scene's]")
      ->type_name("MIN,MAX");
  command
      ->add_option("--no-skip", flags->no_skip,
                   "What `fast` is not to leave out, separated by commas: " + skip_names())
      ->type_name("LIST");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
