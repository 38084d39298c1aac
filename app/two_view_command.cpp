#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>

#include "app/commands.h"
#include "app/console.h"
#include "calib/two_view/disparity.h"
#include "calib/two_view/draw.h"
#include "calib/two_view/estimate.h"
#include "calib/two_view/match_pictures.h"
#include "calib/two_view/rectify_pair.h"
#include "core/error.h"
#include "core/files.h"
#include "core/image_io.h"

namespace stuv {
namespace {

struct Flags : CommonFlags {
  std::filesystem::path a, b, output, matches;
  double threshold_px = 0, motion_px = 0;
  std::uint64_t seed = 1;
  bool disparity = true;
};

Json number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json rows_of(const Eigen::MatrixXd& m) {
  Json rows = Json::array();
  for (Eigen::Index i = 0; i < m.rows(); ++i) {
    Json row = Json::array();
    for (Eigen::Index j = 0; j < m.cols(); ++j) row.push_back(number(m(i, j)));
    rows.push_back(row);
  }
  return rows;
}

MatchedPair find(const Flags& flags, const Image& a, const Image& b, const TwoViewOptions& options,
                 const Reporter& reporter) {
  MatchedPair found;
  if (!flags.matches.empty()) {
    found.matches = read_matches(flags.matches);
    found.estimate = estimate_two_view(found.matches, options);
    return found;
  }
  if (flags.motion_px > 0) {
    found.matches = match_corners(a, b, flags.motion_px);
    found.estimate = estimate_two_view(found.matches, options);
    return found;
  }
  reporter.at("matching", 0, 3);
  const Features fa = detect_features(a), fb = detect_features(b);
  reporter.at("matching", 1, 3);
  found = match_and_estimate(fa, fb, options);
  reporter.at("matching", 3, 3);
  return found;
}

Json result_json(const MatchedPair& found, double seconds) {
  const TwoViewEstimate& e = found.estimate;
  const bool ok = e.status == TwoViewStatus::ok;
  return {{"status", name_of(e.status)},
          {"F", ok ? rows_of(e.ml.F) : Json(nullptr)},
          {"inliers", e.inliers},
          {"matches", found.matches.size()},
          {"sampson_rms_px", ok ? number(e.sampson_rms_px) : Json(nullptr)},
          {"seconds", seconds}};
}

Json report_json(const MatchedPair& found) {
  const TwoViewEstimate& e = found.estimate;
  const bool ok = e.status == TwoViewStatus::ok;
  const auto epipole = [&](const Eigen::Vector3d& v) {
    return ok ? rows_of(v.transpose())[0] : Json(nullptr);
  };
  return {{"reason", e.reason},
          {"distinct_matches", e.distinct},
          {"noise_px", ok ? number(e.ml.noise_px) : Json(nullptr)},
          {"F_covariance", ok ? rows_of(std::pow(e.ml.noise_px, 2) * e.ml.covariance) : Json(nullptr)},
          {"line_sigma_px", ok ? number(e.line_sigma_px) : Json(nullptr)},
          {"epipole_a", epipole(epipole_a(e.ml.F))},
          {"epipole_b", epipole(epipole_b(e.ml.F))},
          {"H", e.H.norm() > 0 ? rows_of(e.H) : Json(nullptr)},
          {"on_plane", e.on_plane}};
}

/// Range of D that the inliers show, a quarter of it wider on both sides.
DisparityOptions range_of(const RectifiedPair& pair, const Matches& inliers) {
  std::vector<double> d;
  const std::size_t step = 1 + inliers.size() / 200;
  for (std::size_t i = 0; i < inliers.size(); i += step)
    if (const auto m = rectified(pair, inliers[i])) d.push_back(m->b.x() - m->a.x());
  DisparityOptions options;
  if (d.empty()) return options;
  const auto [low, high] = std::minmax_element(d.begin(), d.end());
  const double margin = 8 + 0.25 * (*high - *low);
  options.min_px = static_cast<int>(std::floor(*low - margin));
  options.max_px = static_cast<int>(std::ceil(*high + margin));
  return options;
}

Image cut_to_height(Image image, int height) {
  image.bytes.resize(image.bytes.size() / image.height * height);
  if (!image.mask.empty()) image.mask.data.resize(static_cast<std::size_t>(image.width) * height);
  image.height = image.mask.height = height;
  return image;
}

/// rectified.png, disparity.pfm (of rectified A), disparity.png, rebuilt.png; rectification as JSON.
Json write_rectified(const std::filesystem::path& folder, const Image& a, const Image& b,
                     const Eigen::Matrix3d& F, const Matches& inliers, const Reporter& reporter) {
  reporter.at("disparity", 0, 2);
  auto pair = rectify_pair(a, b, F, inliers);
  if (!pair) return nullptr;
  const int height = std::min(pair->a.height, pair->b.height);
  pair->a = cut_to_height(pair->a, height);
  pair->b = cut_to_height(pair->b, height);
  write_image(folder / "rectified_a.png", pair->a);
  write_image(folder / "rectified_b.png", pair->b);
  write_image(folder / "rectified.png", side_by_side(pair->a, pair->b, true));
  reporter.at("disparity", 1, 2);
  const DisparityOptions options = range_of(*pair, inliers);
  const Disparity disparity = find_disparity(pair->a, pair->b, options);
  ImageF known = disparity.d_px;
  for (std::size_t i = 0; i < known.data.size(); ++i)
    if (!(disparity.confidence.data[i] > 0)) known.data[i] = std::numeric_limits<float>::quiet_NaN();
  write_pfm(folder / "disparity.pfm", known);
  write_image(folder / "disparity.png", draw_disparity(known));
  write_image(folder / "rebuilt.png", rebuild(pair->b, disparity));
  reporter.at("disparity", 2, 2);
  return {{"kind", pair->polar ? "polar" : "planar"},
          {"H_a", pair->polar ? Json(nullptr) : rows_of(pair->H_a)},
          {"H_b", pair->polar ? Json(nullptr) : rows_of(pair->H_b)},
          {"disparity_px", {options.min_px, options.max_px}}};
}

int run(const Flags& flags) {
  check_output(flags.output, flags.force);
  if (!(flags.threshold_px >= 0) || !(flags.motion_px >= 0))
    throw UsageError("--threshold and --small-motion want pixels above 0");
  const Image a = read_image(flags.a), b = read_image(flags.b);
  const Reporter reporter = console_reporter();
  TwoViewOptions options;
  options.threshold_px = flags.threshold_px;
  options.seed = flags.seed;
  const auto begin = std::chrono::steady_clock::now();
  const MatchedPair found = find(flags, a, b, options, reporter);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  const TwoViewEstimate& e = found.estimate;

  AtomicOutput output(flags.output, AtomicOutput::Kind::folder, flags.force);
  Matches inliers;
  for (std::size_t i = 0; i < found.matches.size(); ++i)
    if (e.inlier[i]) inliers.push_back(found.matches[i]);
  write_matches(output.path() / "inliers.txt", inliers);
  write_image(output.path() / "matches.png", draw_matches(a, b, found.matches, e.inlier));
  if (e.status == TwoViewStatus::ok)
    write_image(output.path() / "epipolar_lines.png", draw_epipolar_lines(a, b, found.matches, e));
  Json report = report_json(found);
  report["rectification"] = nullptr;
  if (e.status == TwoViewStatus::ok && flags.disparity)
    report["rectification"] = write_rectified(output.path(), a, b, e.ml.F, inliers, reporter);
  write_json(output.path() / "report.json", report);
  const Json result = result_json(found, seconds);
  write_json(output.path() / "two_view.json", result);
  output.commit();
  write_result(flags, result);
  fmt::print("{}: {}, {} of {} matches agree", flags.output.string(), name_of(e.status), e.inliers,
             found.matches.size());
  if (e.status == TwoViewStatus::ok) {
    fmt::print(", {:.2f} px rms\n", e.sampson_rms_px);
    return kDone;
  }
  fmt::print("; {}\n", e.reason);
  return kVerdictNotGood;
}

}  // namespace

void add_two_view_command(CLI::App& app, Action& action) {
  auto flags = std::make_shared<Flags>();
  CLI::App* command = app.add_subcommand(
      "two-view",
      "Epipolar geometry of two pictures: F, or an honest planar, rotation or undetermined.\n\n"
      "  stuv two-view left.png right.png -o pair\n"
      "  stuv two-view left.png right.png -o pair --matches matches.txt\n");
  command->add_option("a", flags->a, "Picture A")->required()->type_name("A");
  command->add_option("b", flags->b, "Picture B: x_B^T F x_A = 0")->required()->type_name("B");
  command->add_option("-o,--output", flags->output, "Folder for two_view.json and pictures")
      ->required()
      ->type_name("DIR");
  command
      ->add_option("--matches", flags->matches, "Lines x1 y1 x2 y2 [score] instead of matching the pictures")
      ->type_name("FILE");
  command
      ->add_option("--small-motion", flags->motion_px,
                   "Match corners by correlation within so many pixels, not SIFT features")
      ->type_name("PX");
  command
      ->add_option("--threshold", flags->threshold_px,
                   "Distance from which on a match is an outlier [1 % of the points' rms radius]")
      ->type_name("PX");
  command->add_flag("!--no-disparity", flags->disparity, "Leave rectification and disparity out");
  command->add_option("--seed", flags->seed, "Of the random samples [1]");
  add_common_flags(*command, *flags);
  command->callback([flags, &action] { action = [flags] { return run(*flags); }; });
}

}  // namespace stuv
