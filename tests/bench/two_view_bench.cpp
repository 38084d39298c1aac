// F from the matches of ../shared/data/two-view, and from the pictures of its pairs without matches, beside
// OpenCV's five robust estimators (there after its SIFT with Lowe's ratio), in one run.
//   two_view_bench DATA [SEEDS]
//   two_view_bench --degenerate [TRIALS]     98 % on a plane, and pure rotation: how often ok, how often
//   wrong
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <opencv2/calib3d.hpp>
#include <opencv2/features2d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <string>
#include <vector>

#include "calib/two_view/estimate.h"
#include "calib/two_view/match_pictures.h"
#include "calib/two_view/robust.h"
#include "core/image_io.h"
#include "tests/calib/two_view_scenes.h"

using namespace stuv;

namespace {

const char* const kPairs[] = {"booksh", "box",     "castle", "corr",     "graff", "kampa",
                              "plant",  "rotunda", "shout",  "valbonne", "wash",  "zoom"};
const char* const kPictures[] = {"Brussels", "Dresden", "Leuven1", "Leuven2", "dino1", "dino2", "temple1"};
constexpr std::pair<int, const char*> kMethods[] = {{cv::FM_RANSAC, "RANSAC"},
                                                    {cv::FM_LMEDS, "LMEDS"},
                                                    {cv::USAC_DEFAULT, "USAC_DEFAULT"},
                                                    {cv::USAC_MAGSAC, "USAC_MAGSAC"},
                                                    {cv::USAC_ACCURATE, "USAC_ACCURATE"}};
constexpr int kMostSamples = 1000;

double median(std::vector<double> v) {
  std::sort(v.begin(), v.end());
  return v.empty() ? std::numeric_limits<double>::quiet_NaN()
                   : 0.5 * (v[(v.size() - 1) / 2] + v[v.size() / 2]);
}

/// Median distance of the truth points to their epipolar lines, in both pictures.
double truth_error(const Eigen::Matrix3d& F, const Matches& truth) {
  std::vector<double> d;
  for (const Match& m : truth) {
    d.push_back(0.5 * (line_distance(F, m) + line_distance(F.transpose(), {m.b, m.a})));
  }
  return median(d);
}

double ms_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
}

Eigen::Matrix3d opencv(const Matches& matches, int method, double& ms) {
  std::vector<cv::Point2d> a, b;
  for (const Match& m : matches) a.emplace_back(m.a.x(), m.a.y()), b.emplace_back(m.b.x(), m.b.y());
  const auto begin = std::chrono::steady_clock::now();
  cv::Mat F;
  try {
    F = cv::findFundamentalMat(a, b, method, 1.0, 0.99, kMostSamples);
  } catch (const cv::Exception&) {
  }
  ms += ms_since(begin);
  Eigen::Matrix3d out = Eigen::Matrix3d::Zero();
  if (F.rows >= 3)
    for (int i = 0; i < 9; ++i) out(i / 3, i % 3) = F.at<double>(i / 3, i % 3);
  return out;
}

/// Best of the five, median of the seeds.
double best_of_opencv(const Matches& matches, const Matches& truth, int seeds) {
  double best = std::numeric_limits<double>::infinity();
  for (const auto& entry : kMethods) {
    std::vector<double> errors;
    for (int s = 0; s < seeds; ++s) {
      Matches shuffled = matches;
      std::shuffle(shuffled.begin(), shuffled.end(), std::mt19937(s));
      double ms = 0;
      const double e = truth_error(opencv(shuffled, entry.first, ms), truth);
      errors.push_back(std::isfinite(e) && e > 0 ? e : 1e9);
    }
    best = std::min(best, median(errors));
  }
  return best;
}

Matches opencv_sift(const std::string& a, const std::string& b) {
  std::vector<cv::KeyPoint> ka, kb;
  cv::Mat da, db;
  const auto sift = cv::SIFT::create();
  sift->detectAndCompute(cv::imread(a, cv::IMREAD_GRAYSCALE), cv::noArray(), ka, da);
  sift->detectAndCompute(cv::imread(b, cv::IMREAD_GRAYSCALE), cv::noArray(), kb, db);
  std::vector<std::vector<cv::DMatch>> two;
  cv::BFMatcher().knnMatch(da, db, two, 2);
  Matches matches;
  for (const auto& m : two) {
    if (m.size() < 2 || !(m[0].distance < 0.8F * m[1].distance)) continue;
    const cv::Point2f p = ka[m[0].queryIdx].pt, q = kb[m[0].trainIdx].pt;
    matches.push_back({{p.x, p.y}, {q.x, q.y}});
  }
  return matches;
}

void compare_pictures(const std::string& data, int seeds) {
  int better = 0;
  fmt::print("\n{:<10}{:>9}{:>9}\n", "pictures", "OpenCV", "stuv");
  for (const std::string pair : kPictures) {
    const std::string end = std::filesystem::exists(data + "/" + pair + "A.png") ? ".png" : ".jpg";
    const std::string a = data + "/" + pair + "A" + end, b = data + "/" + pair + "B" + end;
    const Matches truth = read_matches(data + "/" + pair + "_truth.txt");
    const double theirs = best_of_opencv(opencv_sift(a, b), truth, seeds);
    const TwoViewEstimate e =
        match_and_estimate(detect_features(read_image(a)), detect_features(read_image(b)), {}).estimate;
    const double ours = truth_error(e.ml.F, truth);
    better += ours <= theirs ? 1 : 0;
    fmt::print("{:<10}{:>9.2f}{:>9.2f} {} {} {}\n", pair, theirs, ours, ours <= theirs ? "+" : "-",
               name_of(e.status), e.inliers);
  }
  fmt::print("no worse: {} of 7\n", better);
}

/// 98 % of the matches on a plane, or a camera that only turns; noise 0.25 to 1 px, 0 to 40 % outliers.
void degenerate(int trials) {
  for (const bool rotation : {false, true}) {
    int wrong = 0, count[4] = {};
    for (int t = 0; t < trials; ++t) {
      test::SceneMaker maker(t);
      const double noise = 0.25 * (1 + t % 4), outliers = 0.1 * (t / 4 % 5);
      const test::TwoViewScene s =
          maker.make({.points = 100 + t % 3 * 100, .on_plane = rotation ? 0 : 0.98, .rotation = rotation});
      TwoViewOptions options;
      options.seed = t;
      const TwoViewEstimate e = estimate_two_view(maker.measured(s.exact, noise, outliers), options);
      ++count[static_cast<int>(e.status)];
      wrong += e.status == TwoViewStatus::ok && test::median_line_distance(e.ml.F, s.truth) > 3 ? 1 : 0;
    }
    fmt::print(
        "{}: {} trials: ok {}, planar {}, rotation {}, undetermined {}; ok and off by more than 3 px: {}\n",
        rotation ? "rotation" : "98 % on a plane", trials, count[0], count[1], count[2], count[3], wrong);
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc > 1 && std::string(argv[1]) == "--degenerate")
    return degenerate(argc > 2 ? std::atoi(argv[2]) : 1000), 0;
  if (argc < 2) return fmt::print(stderr, "two_view_bench DATA [SEEDS]\n"), 2;
  const std::string data = argv[1];
  const int seeds = argc > 2 ? std::atoi(argv[2]) : 20;
  double ms_magsac = 0, ms_robust = 0, ms_whole = 0;
  int runs = 0, better = 0, below = 0;
  fmt::print("{:<10}{:>5}", "pair", "n");
  for (const auto& m : kMethods) fmt::print("{:>15}", m.second);
  fmt::print("{:>9}{:>9}{:>9}  status\n", "robust", "stuv", "worst");
  for (const std::string pair : kPairs) {
    const Matches matches = read_matches(data + "/" + pair + "_matches.txt");
    const Matches truth = read_matches(data + "/" + pair + "_truth.txt");
    fmt::print("{:<10}{:>5}", pair, matches.size());
    double best = std::numeric_limits<double>::infinity();
    for (const auto& [method, name] : kMethods) {
      std::vector<double> errors;
      for (int s = 0; s < seeds; ++s) {
        Matches shuffled = matches;
        std::shuffle(shuffled.begin(), shuffled.end(), std::mt19937(s));
        double ms = 0;
        const double e = truth_error(opencv(shuffled, method, ms), truth);
        errors.push_back(std::isfinite(e) && e > 0 ? e : 1e9);
        if (method == cv::USAC_MAGSAC) ms_magsac += ms;
      }
      fmt::print("{:>15.2f}", median(errors));
      best = std::min(best, median(errors));
    }
    std::vector<double> robust, whole;
    std::string status;
    int ok = 0;
    for (int s = 0; s < seeds; ++s) {
      RansacOptions ransac;
      ransac.seed = s;
      ransac.most_samples = kMostSamples;
      auto begin = std::chrono::steady_clock::now();
      robust.push_back(truth_error(ransac_fundamental(matches, ransac).model, truth));
      ms_robust += ms_since(begin);
      TwoViewOptions options;
      options.seed = s;
      begin = std::chrono::steady_clock::now();
      const TwoViewEstimate e = estimate_two_view(matches, options);
      ms_whole += ms_since(begin);
      ++runs;
      ok += e.status == TwoViewStatus::ok ? 1 : 0;
      whole.push_back(truth_error(e.ml.F, truth));
      if (s == 0) status = fmt::format("{} inliers", e.inliers);
    }
    const double ours = median(whole);
    better += ours <= best ? 1 : 0;
    below += ours < 1.5 ? 1 : 0;
    fmt::print("{:>9.2f}{:>9.2f}{:>9.2f} {} {}\n", median(robust), ours,
               *std::max_element(whole.begin(), whole.end()), ours <= best ? "+" : "-",
               fmt::format("ok in {} of {}, {}", ok, seeds, status));
  }
  fmt::print("no worse than the best: {} of 12; below 1.5 px: {} of 12\n", better, below);
  fmt::print("mean ms: USAC_MAGSAC {:.2f}, robust stage {:.2f}, whole estimate {:.2f}\n", ms_magsac / runs,
             ms_robust / runs, ms_whole / runs);
  compare_pictures(data, std::min(seeds, 5));
}
