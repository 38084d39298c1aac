#include "calib/solve/verdict.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "calib/solve/advice.h"
#include "calib/solve/uncertainty.h"
#include "core/median.h"

namespace stuv {
namespace {

/// Corner noise to judge determinacy by, however exact the corners happen to be [px].
constexpr double kLeastNoisePx = 0.02;

std::string names_of(const Observations& in, const std::vector<int>& cameras) {
  constexpr std::size_t kMost = 6;
  std::vector<std::string> names;
  for (const int c : cameras) names.push_back(in.camera_names[c]);
  if (names.size() <= kMost) return fmt::format("{}", fmt::join(names, ", "));
  return fmt::format("{} and {} others", fmt::join(names.begin(), names.begin() + kMost - 1, ", "),
                     names.size() - kMost + 1);
}

double degrees(double rad) { return rad * 180 / M_PI; }

double median_spacing(const std::vector<Eigen::Vector3d>& centres) {
  std::vector<double> nearest;
  for (const auto& a : centres) {
    double best = std::numeric_limits<double>::infinity();
    for (const auto& b : centres)
      if (&a != &b) best = std::min(best, (a - b).norm());
    nearest.push_back(best);
  }
  return median(std::move(nearest));
}

/// What its boards lack.
std::string boards_text(const CameraSummary& s) {
  const double tilt = degrees(s.seen.tilt_rad);
  if (s.boards == 1) return "it saw a single board";
  if (tilt < 15)
    return fmt::format("its {} boards are nearly parallel (at most {:.0f} degrees apart)", s.boards, tilt);
  return fmt::format(
      "its {} boards do not tell, up to {:.0f} degrees tilted against each other and in {:.0f} % of "
      "its picture",
      s.boards, tilt, 100 * s.seen.cells);
}

void note_unsolved(Calibration& c, const CameraGroups& groups) {
  for (const int i : groups.blind) c.cameras[i].undetermined = "it never sees the board";
  for (std::size_t g = 1; g < groups.groups.size(); ++g)
    for (const int i : groups.groups[g])
      c.cameras[i].undetermined =
          fmt::format("it shares no board with {}: record a set in which both see the board",
                      names_of(c.observations, groups.groups.front()));
}

/// Views of a camera in which corners of the board are missing.
int cut_views(const Observations& in, int camera) {
  return static_cast<int>(std::count_if(in.boards.begin(), in.boards.end(), [&](const BoardObservation& b) {
    if (b.camera != camera) return false;
    for (std::size_t k = 0; k < b.corners_px.size(); ++k)
      if (!b.corners_px[k].allFinite() || (!b.weights.empty() && !(b.weights[k] > 0))) return true;
    return false;
  }));
}

/// Why a lens cannot be trusted where frames of a set were not taken together; empty if it can. On four
/// webcams that look at a board held by hand the joint solve made 980 px of a focal length of 760, and
/// stated 10.
std::string contradicted_lens(const Calibration& c, int camera, const CalibrationOptions& options) {
  constexpr double kFar = 4;
  if (c.own_lenses.empty()) return {};
  constexpr const char* kApart = "frames of a set were not taken together, and by its own boards alone its ";
  const OwnLens& own = c.own_lenses[camera];
  const double relative = (own.focal_sigma_px.array() / own.focal_px.array()).abs().maxCoeff();
  if (!own.solved || !(relative < options.most_focal_sigma))
    return kApart + (own.solved && relative < 1
                         ? fmt::format("focal length is known to {:.1f} % only", 100 * relative)
                         : std::string("focal length is not known"));
  const std::vector<double>& joint = c.solution.cameras[camera].intrinsics;
  for (int k = 0; k < 2; ++k)
    if (!(std::abs(joint[k] - own.focal_px[k]) < kFar * own.focal_sigma_px[k]))
      return kApart + fmt::format("focal length is {:.0f} px (sigma {:.1f}), with the others' {:.0f}",
                                  own.focal_px[k], own.focal_sigma_px[k], joint[k]);
  return {};
}

/// Why a free lens is taken from too few boards for anything to tell whether it is right; empty if not.
/// Residuals do not: pairs of array20's sets leave 0.045 px and focal lengths 2 to 8 % wrong, stated to 0.4
/// to 1.2 %.
std::string unconfirmed_lens(const Calibration& c, int camera, const CalibrationOptions& options) {
  const CameraSummary& summary = c.cameras[camera];
  if (!options.solve.known.empty() || options.solve.shared_lens) return {};
  if (summary.boards < 2 && c.cameras.size() > 1)
    return boards_text(summary) + ", and nothing tells its lens from the board's pose";
  // With a third view, or a second whole one, a cut board's part that was taken for another would show.
  if (summary.boards == 2 && c.cameras.size() > 1)
    if (const int cut = cut_views(c.observations, camera); cut > 0)
      return fmt::format("it saw {}: too little to tell its lens and to check it",
                         cut == 1 ? "one whole board and one in part" : "two boards in part");
  if (const std::string own = contradicted_lens(c, camera, options); !own.empty()) return own;
  if (!c.validation || c.validation->focal_sigma_without.empty()) return {};
  const double without = c.validation->focal_sigma_without[camera];
  if (without < options.most_focal_sigma) return {};
  return fmt::format(
      "nothing confirms its lens: without one of the sets, whichever, its focal length is {}: record more "
      "boards, tilted",
      without < 1 ? fmt::format("known to {:.1f} % only", 100 * without) : std::string("not known"));
}

/// Lens and pictures by themselves.
void note_loose_lenses(Calibration& c, double noise, const CalibrationOptions& options) {
  const JointSolution& s = c.solution;
  double distance = 0, count = 0;
  for (const BoardObservation& b : c.observations.boards) {
    if (!s.solved[b.camera]) continue;
    distance += (s.cameras[b.camera].cam_from_rig * s.ref_from_board[b.set]).t.norm();
    ++count;
  }
  for (std::size_t i = 0; i < c.cameras.size(); ++i) {
    CameraSummary& summary = c.cameras[i];
    if (!summary.undetermined.empty()) continue;
    summary.undetermined = unconfirmed_lens(c, static_cast<int>(i), options);
    if (!summary.undetermined.empty()) continue;
    const double focal = noise * s.focal_sigma[i].maxCoeff() / std::abs(s.cameras[i].intrinsics[0]);
    if (!(focal < options.most_focal_sigma)) {
      summary.undetermined =
          fmt::format("its focal length is known to {:.1f} % only, more than {:.1f}: {}",
                      100 * std::min(focal, 9.99), 100 * options.most_focal_sigma, boards_text(summary));
      continue;
    }
    if (s.camera_covariance.size() == 0) continue;
    // The median: corners of the picture that no lens reaches or no board was in say nothing about the rest.
    std::vector<double> sigma = projection_map(s, static_cast<int>(i), distance / count).sigma_px;
    for (double& v : sigma)
      if (!std::isfinite(v)) v = std::numeric_limits<double>::infinity();
    const double px = median(std::move(sigma)) * noise / s.sigma_px;
    if (!(px < options.most_projection_px))
      summary.undetermined =
          fmt::format("points at {:.2f} m are placed in half of its picture to {:.1f} px only: {}",
                      distance / count, px, boards_text(summary));
  }
}

/// Places among each other.
void note_loose_places(Calibration& c, double noise, const CalibrationOptions& options) {
  const JointSolution& s = c.solution;
  std::vector<int> which;
  for (std::size_t i = 0; i < c.cameras.size(); ++i)
    if (c.cameras[i].undetermined.empty()) which.push_back(static_cast<int>(i));
  while (which.size() > 1) {
    std::vector<Eigen::Vector3d> centres;
    for (const int i : which) centres.push_back(s.cameras[i].cam_from_rig.centre());
    const Eigen::VectorXd variance =
        rigidly_aligned_poses(block_of(s.pose_covariance, which, 6), centres).diagonal();
    int worst = 0;
    double most = -1;
    for (int i = 0; i < static_cast<int>(which.size()); ++i) {
      const double v = variance.segment<3>(6 * i + 3).maxCoeff();
      if (!(v <= most)) most = v, worst = i;
    }
    const double sigma = noise * std::sqrt(most), spacing = median_spacing(centres);
    if (sigma < options.most_sigma * spacing) break;
    CameraSummary& summary = c.cameras[which[worst]];
    summary.undetermined =
        fmt::format("its place among the others is known to {:.1f} mm only, {:.0f} % of their spacing: {}",
                    1e3 * sigma, 100 * sigma / spacing, boards_text(summary));
    which.erase(which.begin() + worst);
  }
}

using Texts = std::vector<std::string>;

void judge_fit(const Calibration& c, const CalibrationOptions& options, Texts& reasons) {
  const JointSolution& s = c.solution;
  if (!s.converged) reasons.emplace_back("the solve did not converge");
  // Without weights: what weighs little because it fits badly must not look good for it.
  if (!(s.rms_unweighted_px <= options.most_rms_px))
    reasons.push_back(fmt::format("residuals are large: rms {:.2f} px, more than {:.2f}", s.rms_unweighted_px,
                                  options.most_rms_px));
  const double share = s.outliers / std::max(1.0, double(s.inliers + s.outliers));
  if (share > 0.1) reasons.push_back(fmt::format("{:.0f} % of the corners are outliers", 100 * share));
}

void judge_cameras(const Calibration& c, const CalibrationOptions& options, Texts& reasons) {
  const double spacing = std::max(c.layout.s_step_m.norm(), c.layout.t_step_m.norm());
  for (std::size_t i = 0; i < c.cameras.size(); ++i) {
    const std::string& name = c.observations.camera_names[i];
    const CameraSummary& summary = c.cameras[i];
    if (!summary.undetermined.empty()) {
      reasons.push_back(fmt::format("camera {} is not determined, because {}", name, summary.undetermined));
      continue;
    }
    if (summary.boards < 2) reasons.push_back(fmt::format("camera {} saw one board only", name));
    if (summary.coverage < options.least_coverage)
      reasons.push_back(
          fmt::format("boards cover only {:.0f} % of camera {}'s picture", 100 * summary.coverage, name));
    if (c.rig.cameras.size() > 2 && c.rig.cameras[i].off_lattice_m.norm() > 0.5 * spacing)
      reasons.push_back(fmt::format("camera {} stands {:.3f} m off its place in the recorded grid", name,
                                    c.rig.cameras[i].off_lattice_m.norm()));
  }
}

/// Whether boards and halves of the data that were kept apart differ by what the uncertainty says.
void judge_validation(const Calibration& c, const CalibrationOptions& options, Texts& reasons, Texts& notes) {
  // Times the stated uncertainty, which SigmaScale has made as large as the differences are in the mean.
  // What is false but small does no harm.
  constexpr double kFalse = 5, kDoubtful = 2, kHarmlessPx = 0.5;
  const auto say = [&](double ratio, double px, std::string text) {
    if (ratio > kDoubtful) (ratio > kFalse && px > kHarmlessPx ? reasons : notes).push_back(std::move(text));
  };
  if (!c.validation) return;
  const SigmaScale& sigma = c.validation->sigma;
  if (c.place_scale > 1)
    notes.push_back(fmt::format(
        "cameras see the boards shifted by {:.1f} times the noise, and no part of the sets tells by how much "
        "places are off: their stated uncertainties are that much larger",
        c.place_scale));
  if (sigma.scale > kDoubtful)
    notes.push_back(
        fmt::format("solves without some of the sets differ by {:.1f} times what independent errors of the "
                    "corners would make: stated uncertainties are that much larger",
                    sigma.scale));
  if (const auto& cv = c.validation->left_out) {
    say(cv->rms_px / cv->predicted_px, cv->rms_px,
        fmt::format(
            "boards that were left out are predicted to {:.2f} px, the stated uncertainty says {:.2f}: "
            "it is too small",
            cv->rms_px, cv->predicted_px));
    if (cv->rms_px > 5 * c.solution.rms_px)
      (cv->rms_px > options.most_ghosting_px ? reasons : notes)
          .push_back(fmt::format(
              "a board that was left out is predicted to {:.2f} px only, the boards of the solve to "
              "{:.2f}: record more boards, tilted and out to the pictures' corners",
              cv->rms_px, c.solution.rms_px));
  }
  if (const auto& h = c.validation->halves) {
    double sum_sq = 0;
    for (const HalfData::Camera& camera : h->cameras) sum_sq += camera.lens_px * camera.lens_px;
    const double lens = h->lens_ratio / sigma.scale, centre = h->centre_ratio / sigma.scale;
    say(std::max(lens, centre), std::sqrt(sum_sq / static_cast<double>(h->cameras.size())),
        fmt::format("either half of the sets gives lenses {:.1f} and places {:.1f} times as different as the "
                    "stated uncertainty says: it is too small",
                    lens, centre));
  }
}

/// Single cameras: the lens of one that sees its boards at the picture's border only may be the one that does
/// not fit.
void note_lens_misfit(const Calibration& c, Texts& notes) {
  constexpr double kWorthPx = 0.03, kClear = 3;
  std::string names;
  double worst = 0;
  for (std::size_t i = 0; i < c.structure.cameras.size(); ++i) {
    const auto& camera = c.structure.cameras[i];
    if (!(camera.position_px > kWorthPx && camera.position_ratio > kClear)) continue;
    names += (names.empty() ? "" : ", ") + c.observations.camera_names[i];
    worst = std::max(worst, camera.position_px);
  }
  if (names.empty()) return;
  notes.push_back(fmt::format(
      "residuals depend on the place in the picture, up to {:.2f} px rms, in camera(s) {}: the lens "
      "model does not fit there; try --lens opencv8 or splined",
      worst, names));
}

void note_structure(const Calibration& c, Texts& notes) {
  const ResidualStructure& s = c.structure;
  if (s.rows_apart())
    notes.push_back(
        fmt::format("residuals grow along the rows within boards, {:.2f} px at their edge: a rolling "
                    "shutter and a board that moved are suspected; hold it still",
                    s.row_px));
  if (s.frames_apart())
    notes.push_back(
        fmt::format("cameras see one board shifted against each other, {:.2f} px rms: frames of a set "
                    "that were not taken together and a board that moved are suspected; hold it still",
                    s.view_px));
  if (c.lenses_alike)
    notes.emplace_back(
        "opencv4 does not fit these lenses: they are opencv5, each one's distortion taken as alike to the "
        "others' where its own boards do not tell");
  note_lens_misfit(c, notes);
  std::vector<double> rms;
  for (const auto& set : s.sets) rms.push_back(set.rms_px);
  if (rms.size() < 3) return;
  const double usual = median(std::move(rms));
  for (const auto& set : s.sets)
    if (set.rms_px > 2.5 * usual && set.rms_px > 0.5 * ResidualStructure::kWorthPx)
      notes.push_back(
          fmt::format("the board of set {} fits worse than others, {:.2f} against {:.2f} px rms: it "
                      "moved, or is blurred or overexposed; it weighed less",
                      c.observations.set_names[set.set], set.rms_px, usual));
}

void note_noisy_cameras(const Calibration& c, Texts& notes) {
  constexpr double kNoisy = 3, kWorthPx = 0.1;
  std::vector<double> noise;
  for (std::size_t i = 0; i < c.cameras.size(); ++i)
    if (c.solution.solved[i]) noise.push_back(c.cameras[i].noise_px);
  const double usual = median(std::move(noise));
  for (std::size_t i = 0; i < c.cameras.size(); ++i)
    if (c.solution.solved[i] && c.cameras[i].noise_px > std::max(kWorthPx, kNoisy * usual))
      notes.push_back(
          fmt::format("camera {}'s corners are noisier than others', {:.2f} against {:.2f} px: is it "
                      "in focus, clean and sharp? They weighed less",
                      c.observations.camera_names[i], c.cameras[i].noise_px, usual));
}

void note_board(const Calibration& c, Texts& notes) {
  const Board& board = c.observations.board;
  const double size = board.square_m * std::max(board.columns, board.rows);
  const double bend = c.solution.warp_m.cwiseAbs().maxCoeff();
  if (bend > 0.005 * size)
    notes.push_back(fmt::format("the board bends by {:.1f} mm over {:.0f} mm: a stiffer one is worth having",
                                1e3 * bend, 1e3 * size));
  const double spacing = std::max(c.rig.s_step_m.norm(), c.rig.t_step_m.norm());
  if (spacing > 20 || c.rig.nearest_seen_m > 500)
    notes.push_back(
        fmt::format("cameras are {:.0f} m apart and the board is {:.0f} m away: was its square, {:.3g} m, "
                    "given in millimetres as metres?",
                    spacing, c.rig.nearest_seen_m, board.square_m));
  if (spacing > 0 && (spacing < 5e-4 || c.rig.farthest_seen_m < 5e-3))
    notes.push_back(
        fmt::format("cameras are {:.3f} mm apart and the board is at most {:.2f} mm away: is its square, "
                    "{:.3g} m, in the right unit?",
                    1e3 * spacing, 1e3 * c.rig.farthest_seen_m, board.square_m));
}

/// At the depths that boards were seen at. The worst point is one where no board was: whether pictures of
/// boards are right, judge_validation says. What makes a rig not good is that boards were in too few places,
/// so SigmaScale, which does not depend on that, is left out of it: without it the real array of
/// ../shared/data ghosts by 1.4 px at the worst point of its pictures and is usable.
void judge_ghosting(const Calibration& c, const CalibrationOptions& options, Texts& reasons, Texts& notes) {
  constexpr double kUnusablePx = 2;
  Ghosting worst;
  for (const Ghosting& g : c.ghosting)
    if (g.depth_m >= c.rig.nearest_seen_m && g.depth_m <= c.rig.farthest_seen_m &&
        g.worst_px > worst.worst_px)
      worst = g;
  if (!(worst.worst_px > options.most_ghosting_px)) return;
  const double scale = c.validation ? c.validation->sigma.scale : 1;
  const bool unusable = worst.worst_px > kUnusablePx * scale;
  (unusable ? reasons : notes)
      .push_back(fmt::format(
          "pictures of one point at {:.2f} m fall up to {:.2f} px apart (one sigma), more than "
          "{:.2f}, most that of camera {}: show it more boards, out to its picture's corners",
          worst.depth_m, worst.worst_px, unusable ? kUnusablePx * scale : options.most_ghosting_px,
          c.observations.camera_names[worst.worst_camera]));
}

}  // namespace

void note_undetermined(Calibration& c, const CameraGroups& groups, const CalibrationOptions& options) {
  note_unsolved(c, groups);
  const JointSolution& s = c.solution;
  if (!s.converged || s.pose_covariance.size() == 0 || !std::isfinite(s.sigma_px)) {
    for (CameraSummary& summary : c.cameras)
      if (summary.undetermined.empty()) summary.undetermined = "the solve did not converge";
    return;
  }
  const double noise = std::max(kLeastNoisePx, s.sigma_px);
  note_loose_lenses(c, noise, options);
  note_loose_places(c, noise, options);
}

void judge(Calibration& c, const Recording& recording, const CalibrationOptions& options) {
  judge_fit(c, options, c.reasons);
  judge_cameras(c, options, c.reasons);
  judge_validation(c, options, c.reasons, c.notes);
  if (!c.layout.as_recorded)
    c.notes.push_back(
        fmt::format("the recorded grid, {}x{}, does not fit where the cameras stand; rows and columns are "
                    "counted along their centres: {}x{}",
                    recording.rows, recording.cols, c.layout.rows, c.layout.cols));
  note_structure(c, c.notes);
  note_noisy_cameras(c, c.notes);
  note_board(c, c.notes);
  judge_ghosting(c, options, c.reasons, c.notes);
  c.advice = advice_for(c);
  c.good = c.reasons.empty();
}

}  // namespace stuv
