#include "calib/two_view/no_board.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <mutex>
#include <numeric>

#include "calib/two_view/estimate.h"
#include "calib/two_view/match_pictures.h"
#include "calib/two_view/refine_tracks.h"
#include "core/error.h"
#include "core/image_io.h"
#include "core/median.h"
#include "core/parallel.h"

namespace stuv {
namespace {

/// Sets of observations that are the same point, joined by matches.
class Joiner {
 public:
  explicit Joiner(std::size_t n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), 0); }
  int root(int i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(int i, int j) { parent_[root(i)] = root(j); }

 private:
  std::vector<int> parent_;
};

Camera lens_of(const NoBoardOptions& options, const std::string& name, const ImageInfo& info) {
  for (const Camera& lens : options.lenses) {
    if (lens.name != name) continue;
    if (lens.width != info.width || lens.height != info.height)
      throw Error(name,
                  fmt::format("has pictures of {}x{}, its lens is for {}x{}", info.width, info.height,
                              lens.width, lens.height),
                  "give the lenses of these pictures");
    return lens;
  }
  if (!options.lenses.empty())
    throw Error(name, "has no lens among those given", "name its .cameramodel after it");
  // A shared focal length starts at an ordinary lens's 60 degrees.
  const double f = 0.87 * info.width;
  return {name,       "LENSMODEL_PINHOLE", {f, f, 0.5 * (info.width - 1), 0.5 * (info.height - 1)},
          info.width, info.height,         {}};
}

/// root root^T = C, scaled so that parameters may be of any size; without columns if C is no covariance of
/// the lens.
Eigen::MatrixXd root_of(const Eigen::MatrixXd& C, const Camera& lens) {
  const auto m = static_cast<Eigen::Index>(lens.intrinsics.size());
  const Eigen::MatrixXd exact(m, 0);
  if (m > kMostLensStates || C.rows() != m || C.cols() != m || !C.allFinite()) return exact;
  const Eigen::VectorXd sigma = C.diagonal().cwiseMax(0).cwiseSqrt();
  if (!(sigma.minCoeff() > 0)) return exact;
  const Eigen::MatrixXd correlation =
      sigma.cwiseInverse().asDiagonal() * C * sigma.cwiseInverse().asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(0.5 * (correlation + correlation.transpose()));
  return sigma.asDiagonal() * eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
}

/// Of the recording's cameras, in the order of `lenses`; empty: all are exact.
std::vector<Eigen::MatrixXd> lens_roots(const NoBoardOptions& options, const std::vector<Camera>& lenses) {
  std::vector<Eigen::MatrixXd> roots;
  bool any = false;
  for (const Camera& lens : lenses) {
    Eigen::MatrixXd covariance;
    for (std::size_t i = 0; i < options.lens_covariance.size(); ++i)
      if (options.lenses[i].name == lens.name) covariance = options.lens_covariance[i];
    roots.push_back(root_of(covariance, lens));
    any = any || roots.back().cols() > 0;
  }
  if (!any) roots.clear();
  return roots;
}

double median_focal(const std::vector<Camera>& lenses) {
  std::vector<double> f;
  for (const Camera& c : lenses) f.push_back(c.intrinsics[0]);
  return median(std::move(f));
}

/// A picture's features, and where they are in ideal pixels.
struct Seen {
  Features features;
  std::vector<Eigen::Vector2d> ideal;
  int first = 0;  ///< number of its first observation
};

std::vector<Seen> features_of(const Recording& recording, const FrameSet& set,
                              const std::vector<Camera>& lenses, double focal, int most,
                              const Reporter& reporter) {
  std::vector<Seen> seen(recording.cameras.size());
  std::size_t done = 0;
  std::mutex counting;
  parallel_for(static_cast<int>(seen.size()), [&](int c) {
    if (set.frames[c].status == FrameStatus::ok)
      seen[c].features = detect_features(read_image(set.frames[c].file), most);
    for (const Eigen::Vector3d& d : unproject(lenses[c], seen[c].features.points_px))
      seen[c].ideal.push_back(focal * d.hnormalized());
    const std::lock_guard lock(counting);
    reporter.at("finding features", ++done, seen.size());
  });
  int first = 0;
  for (Seen& s : seen) {
    s.first = first;
    first += static_cast<int>(s.ideal.size());
  }
  return seen;
}

/// Indices of the features that match and agree with the pair's geometry. Where features coincide, any of
/// them.
std::vector<std::pair<int, int>> verified(const Seen& a, const Seen& b, std::uint64_t seed) {
  Features fa = a.features, fb = b.features;
  fa.points_px = a.ideal;
  fb.points_px = b.ideal;
  const std::vector<std::pair<int, int>> pairs = match_feature_indices(fa, fb);
  Matches matches;
  for (const auto& [i, j] : pairs) matches.push_back({a.ideal[i], b.ideal[j]});
  TwoViewOptions options;
  options.seed = seed;
  options.gold_standard = false;
  const TwoViewEstimate e = estimate_two_view(matches, options);
  std::vector<std::pair<int, int>> good;
  for (std::size_t k = 0; k < pairs.size(); ++k)
    if (e.inlier[k]) good.push_back(pairs[k]);
  if (e.inliers < 20) good.clear();
  return good;
}

/// At most `most` of them: round by round the longest of every part of every camera's picture.
std::vector<Track> spread(std::vector<Track> tracks, double extent_px, std::size_t most) {
  std::stable_sort(tracks.begin(), tracks.end(),
                   [](const Track& a, const Track& b) { return a.camera.size() > b.camera.size(); });
  std::map<std::array<int, 3>, std::vector<std::size_t>> parts;
  for (std::size_t t = 0; t < tracks.size(); ++t) {
    const std::size_t middle = tracks[t].camera.size() / 2;
    const Eigen::Vector2d at = tracks[t].at_px[middle] * (3 / extent_px);
    parts[{tracks[t].camera[middle], int(std::floor(at.x())), int(std::floor(at.y()))}].push_back(t);
  }
  std::vector<Track> chosen;
  for (std::size_t round = 0; chosen.size() < std::min(most, tracks.size()); ++round)
    for (const auto& [key, members] : parts)
      if (round < members.size() && chosen.size() < most) chosen.push_back(tracks[members[round]]);
  return chosen;
}

std::vector<Track> find_set_tracks(const Recording& recording, const std::vector<Seen>& seen,
                                   const NoBoardOptions& options, const Reporter& reporter) {
  const auto n = static_cast<int>(seen.size());
  std::vector<std::pair<int, int>> pairs;
  for (int a = 0; a < n; ++a)
    for (int b = a + 1; b < n; ++b)
      if (std::abs(recording.cameras[a].row - recording.cameras[b].row) +
              std::abs(recording.cameras[a].col - recording.cameras[b].col) <=
          options.reach)
        pairs.emplace_back(a, b);
  const std::size_t total = seen.back().first + seen.back().ideal.size();
  Joiner joiner(total);
  std::vector<std::vector<std::pair<int, int>>> matched(pairs.size());
  std::size_t done = 0;
  std::mutex counting;
  parallel_for(static_cast<int>(pairs.size()), [&](int p) {
    const auto [a, b] = pairs[p];
    if (!seen[a].ideal.empty() && !seen[b].ideal.empty())
      matched[p] = verified(seen[a], seen[b], options.seed);
    const std::lock_guard lock(counting);
    reporter.at("matching pairs", ++done, pairs.size());
  });
  for (std::size_t p = 0; p < pairs.size(); ++p)
    for (const auto& [i, j] : matched[p])
      joiner.join(seen[pairs[p].first].first + i, seen[pairs[p].second].first + j);
  std::vector<Track> tracks(total);
  for (int c = 0; c < n; ++c)
    for (std::size_t i = 0; i < seen[c].ideal.size(); ++i) {
      Track& t = tracks[joiner.root(seen[c].first + static_cast<int>(i))];
      t.camera.push_back(c);
      t.at_px.push_back(seen[c].ideal[i]);
    }
  std::erase_if(tracks, [](const Track& t) {
    // Two places in one picture: some of its matches are wrong.
    const bool twice = std::adjacent_find(t.camera.begin(), t.camera.end()) != t.camera.end();
    return t.camera.size() < 2 || twice;
  });
  return tracks;
}

std::vector<Camera> lenses_of(const Recording& recording, const NoBoardOptions& options) {
  std::vector<Camera> lenses;
  for (std::size_t c = 0; c < recording.cameras.size(); ++c) {
    const auto some = std::find_if(recording.sets.begin(), recording.sets.end(),
                                   [&](const FrameSet& f) { return f.frames[c].status == FrameStatus::ok; });
    if (some == recording.sets.end()) throw Error(recording.cameras[c].name, "has no picture", "record one");
    lenses.push_back(lens_of(options, recording.cameras[c].name, read_image_info(some->frames[c].file)));
  }
  return lenses;
}

std::vector<ImageF> grey_pictures(const FrameSet& set) {
  std::vector<ImageF> pictures(set.frames.size());
  parallel_for(static_cast<int>(pictures.size()), [&](int c) {
    if (set.frames[c].status == FrameStatus::ok) pictures[c] = grey(read_image(set.frames[c].file));
  });
  return pictures;
}

/// The problem's points sought in all pictures, and the solution of that as its start.
void lengthen(const Recording& recording, const std::vector<Camera>& lenses, const NoBoardOptions& options,
              const Reporter& reporter, SfmProblem& problem, SfmSolution& solution) {
  std::vector<Track> tracks;
  RefineTracksOptions refine;
  refine.most_points = options.most_points;
  for (std::size_t s = 0; s < recording.sets.size(); ++s) {
    reporter.at("following points", s, recording.sets.size());
    const std::vector<ImageF> pictures = grey_pictures(recording.sets[s]);
    const SetPictures set{static_cast<int>(s), pictures, lenses};
    for (Track& t : refine_tracks(set, problem, solution, refine)) tracks.push_back(std::move(t));
  }
  reporter.at("following points", recording.sets.size(), recording.sets.size());
  problem.tracks = std::move(tracks);
  problem.start = solution.cam_from_ref;
  problem.started = solution.placed;
  solution = solve_sfm(problem, options.seed, reporter);
}

Eigen::MatrixXd scale_free(const Eigen::MatrixXd& covariance, const std::vector<Eigen::Vector3d>& centres) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& c : centres) mean += c / static_cast<double>(centres.size());
  Eigen::VectorXd g(3 * centres.size());
  for (std::size_t i = 0; i < centres.size(); ++i)
    g.segment<3>(3 * static_cast<Eigen::Index>(i)) = centres[i] - mean;
  if (!(g.norm() > 0)) return covariance;
  g.normalize();
  const Eigen::MatrixXd P = Eigen::MatrixXd::Identity(g.size(), g.size()) - g * g.transpose();
  return P * covariance * P;
}

/// Metres per unit of the solution.
double scale_of(const SfmSolution& s, const Recording& recording, const NoBoardOptions& options,
                const Layout& layout) {
  if (options.distance) {
    const int a = recording.camera_index(options.distance->a),
              b = recording.camera_index(options.distance->b);
    if (a < 0 || b < 0)
      throw Error(a < 0 ? options.distance->a : options.distance->b, "is no camera of the recording",
                  "see its recording.json");
    return options.distance->m / (s.cam_from_ref[a].centre() - s.cam_from_ref[b].centre()).norm();
  }
  const double spacing = layout.s_step_m.norm() > 0 ? layout.s_step_m.norm() : layout.t_step_m.norm();
  return options.spacing_m / spacing;
}

std::vector<PlacedCamera> placed_cameras(const SfmSolution& s, const Recording& recording, double scale) {
  std::vector<PlacedCamera> placed;
  for (std::size_t c = 0; c < s.cam_from_ref.size(); ++c) {
    Pose pose = s.cam_from_ref[c];
    pose.t *= scale;
    placed.push_back({pose, recording.cameras[c].row, recording.cameras[c].col, s.placed[c]});
  }
  return placed;
}

/// How far lenses that are known with a covariance moved in it: |y|^2 has a mean of its numbers.
void note_lenses(const SfmSolution& s, Calibration& c) {
  constexpr double kFar = 5;  // of some hundred numbers one in a thousand times
  double most = 0;
  std::string far;
  for (std::size_t i = 0; i < s.placed.size(); ++i) {
    if (!s.placed[i]) continue;
    const double y = s.lens[i].cwiseAbs().maxCoeff();
    most = std::max(most, y);
    if (y > kFar) far += (far.empty() ? "" : ", ") + c.rig.cameras[i].camera.name;
  }
  c.notes.push_back(fmt::format(
      "lenses were refined within what their calibration left open: by up to {:.1f} sigma", most));
  if (!far.empty())
    c.notes.push_back(
        fmt::format("the scene contradicts the lenses of camera(s) {}: calibrate them anew", far));
}

void judge(const SfmSolution& s, const CalibrationOptions& limits, Calibration& c) {
  if (!s.converged) c.reasons.emplace_back("the bundle adjustment did not converge");
  if (!(s.rms_px <= 2 * limits.most_rms_px))
    c.reasons.push_back(fmt::format("residuals are large: rms {:.2f} px", s.rms_px));
  const double spacing = std::max(c.layout.s_step_m.norm(), c.layout.t_step_m.norm());
  for (RigCamera& rc : c.rig.cameras) {
    if (rc.determined && !(rc.position_sigma_m.maxCoeff() < limits.most_sigma * spacing))
      rc.determined = false;
    if (!rc.determined)
      c.reasons.push_back(fmt::format("camera {} is not determined by the scene", rc.camera.name));
  }
  c.good = c.reasons.empty();
}

}  // namespace

SfmProblem find_tracks(const Recording& recording, const NoBoardOptions& options, const Reporter& reporter) {
  constexpr std::size_t kMostFirst = 1500;  ///< tracks of a set for the first solution
  SfmProblem problem;
  problem.cameras = static_cast<int>(recording.cameras.size());
  problem.focal_known = !options.lenses.empty();
  const std::vector<Camera> lenses = lenses_of(recording, options);
  problem.focal_px = median_focal(lenses);
  problem.lens_root = lens_roots(options, lenses);
  for (std::size_t s = 0; s < recording.sets.size(); ++s) {
    const std::vector<Seen> seen =
        features_of(recording, recording.sets[s], lenses, problem.focal_px, options.most_features, reporter);
    for (Track& t :
         spread(find_set_tracks(recording, seen, options, reporter), lenses[0].width, kMostFirst)) {
      t.set = static_cast<int>(s);
      problem.tracks.push_back(std::move(t));
    }
  }
  SfmSolution solution = solve_sfm(problem, options.seed, reporter);
  for (int round = 0; round < 2; ++round) {
    if (std::count(solution.placed.begin(), solution.placed.end(), true) < 2) break;
    lengthen(recording, lenses, options, reporter, problem, solution);
  }
  return problem;
}

Calibration calibrate_without_board(const SfmProblem& problem, const Recording& recording,
                                    const NoBoardOptions& options, const Reporter& reporter) {
  if (!options.distance && !(options.spacing_m > 0))
    throw Error(recording.folder.string(), "has no scale without a board",
                "give --spacing-m, the lattice spacing, or --distance A,B,METRES");
  const SfmSolution s = solve_sfm(problem, options.seed, reporter);
  Calibration c;
  const auto n = s.cam_from_ref.size();
  if (std::count(s.placed.begin(), s.placed.end(), true) < 2)
    throw Error(recording.folder.string(), "shows too little that several cameras see",
                "record a scene with texture at several depths");
  const double scale = scale_of(s, recording, options,
                                fit_layout(placed_cameras(s, recording, 1), recording.rows, recording.cols));
  const std::vector<PlacedCamera> placed = placed_cameras(s, recording, scale);
  c.layout = fit_layout(placed, recording.rows, recording.cols);
  c.solution.converged = s.converged;
  c.solution.rms_px = c.solution.rms_unweighted_px = s.rms_px;
  c.solution.worst_px = s.worst_px;
  c.solution.noise_px = s.noise_px;
  c.solution.inliers = s.inliers;
  c.solution.outliers = s.outliers;
  Rig& rig = c.rig;
  set_lattice(c.layout, rig);
  const Pose ref_from_rig = c.layout.rig_from_ref.inverse();
  std::vector<int> which;
  for (std::size_t i = 0; i < n; ++i) {
    RigCamera rc;
    const auto lens = std::find_if(options.lenses.begin(), options.lenses.end(),
                                   [&](const Camera& l) { return l.name == recording.cameras[i].name; });
    if (lens != options.lenses.end()) {
      rc.camera = problem.lens_root.empty() ? *lens : with_states(*lens, problem.lens_root[i], s.lens[i]);
    } else {
      const auto some = std::find_if(recording.sets.begin(), recording.sets.end(), [&](const FrameSet& f) {
        return f.frames[i].status == FrameStatus::ok;
      });
      const ImageInfo info =
          some != recording.sets.end() ? read_image_info(some->frames[i].file) : ImageInfo{};
      rc.camera = lens_of(options, recording.cameras[i].name, info);
      rc.camera.intrinsics[0] = rc.camera.intrinsics[1] = s.focal_px;
    }
    rc.camera.cam_from_rig = placed[i].cam_from_ref * ref_from_rig;
    rc.row = c.layout.row[i];
    rc.col = c.layout.col[i];
    rc.off_lattice_m = c.layout.off_lattice_m[i];
    rc.determined = s.placed[i];
    if (s.placed[i]) which.push_back(static_cast<int>(i));
    c.observations.camera_names.push_back(rc.camera.name);
    c.observations.size_px.emplace_back(rc.camera.width, rc.camera.height);
    c.solution.cameras.push_back(rc.camera);
    CameraSummary summary;
    summary.inliers = s.camera_inliers[i];
    summary.rms_px = s.camera_rms_px[i];
    summary.focal_sigma_px = Eigen::Vector2d::Constant(s.focal_sigma_px);
    if (!s.lens_covariance.empty() && problem.lens_root[i].cols() > 0) {
      const Eigen::MatrixXd& root = problem.lens_root[i];
      summary.lens_covariance =
          root * s.lens_covariance[i].topLeftCorner(root.cols(), root.cols()) * root.transpose();
      summary.focal_sigma_px = summary.lens_covariance.diagonal().head<2>().cwiseSqrt();
    }
    c.cameras.push_back(summary);
    rig.cameras.push_back(std::move(rc));
  }
  std::vector<Eigen::Vector3d> centres;
  for (const int i : which) centres.push_back(placed[i].cam_from_ref.centre());
  const auto m = static_cast<Eigen::Index>(which.size());
  Eigen::MatrixXd covariance(3 * m, 3 * m), turn = Eigen::MatrixXd::Zero(3 * m, 3 * m);
  for (Eigen::Index i = 0; i < m; ++i) {
    turn.block<3, 3>(3 * i, 3 * i) = c.layout.rig_from_ref.R;
    for (Eigen::Index j = 0; j < m; ++j)
      covariance.block<3, 3>(3 * i, 3 * j) = s.centre_covariance.block<3, 3>(3 * which[i], 3 * which[j]);
  }
  covariance = scale * scale * scale_free(rigidly_aligned(covariance, centres), centres);
  rig.centre_covariance_m2 = turn * covariance * turn.transpose();
  for (Eigen::Index i = 0; i < m; ++i)
    rig.cameras[which[i]].position_sigma_m =
        rig.centre_covariance_m2.diagonal().segment<3>(3 * i).cwiseMax(0).cwiseSqrt();
  std::vector<double> depths;
  for (const Eigen::Vector3d& p : s.points)
    if (p.allFinite()) depths.push_back((c.layout.rig_from_ref * Eigen::Vector3d(scale * p)).z());
  std::sort(depths.begin(), depths.end());
  if (!depths.empty()) {
    rig.nearest_seen_m = std::max(0.0, depths[depths.size() / 100]);
    rig.farthest_seen_m = std::max(0.0, depths[depths.size() - 1 - depths.size() / 100]);
  }
  judge(s, {}, c);
  if (!problem.lens_root.empty())
    note_lenses(s, c);
  else if (problem.focal_known)
    c.notes.emplace_back(
        "the sigmas of the places take the lenses as exact: with lenses that are uncertain they are too "
        "small");
  else
    c.notes.push_back(
        fmt::format("one focal length for all: {:.1f} +- {:.1f} px", s.focal_px, s.focal_sigma_px));
  return c;
}

}  // namespace stuv
