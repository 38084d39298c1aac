#include "calib/check/check_rig.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "calib/check/lens_turn.h"
#include "core/median.h"
#include "core/parallel.h"

namespace stuv {
namespace {

constexpr double kHypothesisPx = 2.0;  // median residual of pictures that another camera or a turn explains
constexpr double kMuchBetter = 3;      // times better than the camera's own place
constexpr double kLikelyAgreement = 0.5;  // share of sightings that must agree with a new pose
constexpr double kDeg = 180 / M_PI;

double focal_of(const Camera& camera) { return 0.5 * (camera.intrinsics[0] + camera.intrinsics[1]); }

/// Lines of sight of all tracks, once for all.
struct Sight {
  int camera;
  Eigen::Vector2d at_px;
  Eigen::Vector3d ray = {0, 0, 0};  ///< in the camera's frame
};

class Checker {
 public:
  Checker(const SceneEvidence& evidence, const Rig& rig, const CheckOptions& options)
      : in_(evidence), rig_(rig), options_(options), n_(static_cast<int>(rig.cameras.size())) {
    choose_unit();
    see();
    out_.cameras.resize(rig.cameras.size());
    for (int c = 0; c < n_; ++c) out_.cameras[c].name = rig.cameras[c].camera.name;
  }

  SceneCheck run() {
    std::vector<bool> trusted(n_, false);
    for (int c = 0; c < n_; ++c)
      trusted[c] = in_.cameras[c].present && !in_.cameras[c].mirrored && rig_.cameras[c].determined;
    measure_pairs();
    set_aside_by_pairs(trusted);
    const bool ambiguous = set_aside_by_points(trusted);
    for (int c = 0; c < n_; ++c)
      if (trusted[c]) out_.trusted.push_back(c);
    for (int c = 0; c < n_; ++c) judge(c, trusted, ambiguous);
    compare_light();
    conclude();
    return std::move(out_);
  }

 private:
  const Camera& camera(int c) const { return rig_.cameras[c].camera; }

  /// Lengths are measured in the cameras' spread, so that millimetres and kilometres are alike.
  void choose_unit() {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (int c = 0; c < n_; ++c) mean += camera(c).cam_from_rig.centre() / double(n_);
    double sum = 0;
    for (int c = 0; c < n_; ++c) sum += (camera(c).cam_from_rig.centre() - mean).squaredNorm() / double(n_);
    unit_m_ = sum > 0 ? std::sqrt(sum) : 1;
    std::vector<double> nearest;
    for (int a = 0; a < n_; ++a) {
      double best = std::numeric_limits<double>::infinity();
      for (int b = 0; b < n_; ++b)
        if (a != b)
          best = std::min(best, (camera(a).cam_from_rig.centre() - camera(b).cam_from_rig.centre()).norm());
      nearest.push_back(best);
    }
    spacing_m_ = median(nearest);
  }

  Pose pose_of(int c) const {
    Pose p = camera(c).cam_from_rig;
    p.t /= unit_m_;
    return p;
  }

  void see() {
    tracks_.resize(in_.tracks.size());
    for (std::size_t t = 0; t < in_.tracks.size(); ++t)
      for (std::size_t k = 0; k < in_.tracks[t].camera.size(); ++k)
        tracks_[t].push_back({in_.tracks[t].camera[k], in_.tracks[t].at_px[k]});
    for (int c = 0; c < n_; ++c) {
      std::vector<Sight*> of_camera;
      std::vector<Eigen::Vector2d> pixels;
      for (auto& track : tracks_)
        for (Sight& s : track)
          if (s.camera == c) of_camera.push_back(&s), pixels.push_back(s.at_px);
      const std::vector<Eigen::Vector3d> rays = unproject(camera(c), pixels);
      for (std::size_t i = 0; i < rays.size(); ++i) of_camera[i]->ray = rays[i];
    }
  }

  // ---- 1. pairs

  /// Median over the matches of the distance from the epipolar line, first order:
  ///   |b^T E a| / sqrt(|P_b E a|^2 + |P_a E^T b|^2) f,   P_x = I - x x^T,   E = [t]_x R
  double pair_distance(const ScenePair& pair) const {
    const Pose b_from_a = pose_of(pair.b) * pose_of(pair.a).inverse();
    const Eigen::Matrix3d E = cross_matrix(b_from_a.t.normalized()) * b_from_a.R;
    std::vector<Eigen::Vector2d> pa, pb;
    for (const Match& m : pair.matches) pa.push_back(m.a), pb.push_back(m.b);
    const std::vector<Eigen::Vector3d> ra = unproject(camera(pair.a), pa), rb = unproject(camera(pair.b), pb);
    std::vector<double> distances;
    for (std::size_t i = 0; i < ra.size(); ++i) {
      const Eigen::Vector3d la = E * ra[i], lb = E.transpose() * rb[i];
      const double value = rb[i].dot(la);
      const double gradient2 = (la - value * rb[i]).squaredNorm() + (lb - value * ra[i]).squaredNorm();
      distances.push_back(gradient2 > 0 ? std::abs(value) / std::sqrt(gradient2) : 0);
    }
    return 0.5 * (focal_of(camera(pair.a)) + focal_of(camera(pair.b))) * median(distances);
  }

  void measure_pairs() {
    pair_px_.resize(in_.pairs.size());
    parallel_for(static_cast<int>(in_.pairs.size()),
                 [&](int p) { pair_px_[p] = pair_distance(in_.pairs[p]); });
  }

  struct Opinion {
    int pairs = 0, against = 0;
    double worst_px = 0;
    double share() const { return pairs > 0 ? double(against) / pairs : 0; }
  };

  std::vector<Opinion> opinions(const std::vector<bool>& trusted) const {
    std::vector<Opinion> opinion(n_);
    for (std::size_t p = 0; p < in_.pairs.size(); ++p) {
      const auto [a, b] = std::pair(in_.pairs[p].a, in_.pairs[p].b);
      if (!trusted[a] || !trusted[b]) continue;
      for (const int c : {a, b}) {
        ++opinion[c].pairs;
        if (!(pair_px_[p] <= options_.most_pair_px)) {
          ++opinion[c].against;
          opinion[c].worst_px += pair_px_[p];
        }
      }
    }
    return opinion;
  }

  /// The camera that most of its pairs speak against goes first; what it spoiled for the others goes with it.
  void set_aside_by_pairs(std::vector<bool>& trusted) const {
    while (true) {
      const std::vector<Opinion> opinion = opinions(trusted);
      int worst = -1;
      for (int c = 0; c < n_; ++c) {
        if (!trusted[c]) continue;
        if (opinion[c].pairs == 0) {
          worst = c;  // nobody vouches for it
          break;
        }
        if (opinion[c].share() < 0.5) continue;
        if (worst < 0 || std::pair(opinion[c].share(), opinion[c].worst_px) >
                             std::pair(opinion[worst].share(), opinion[worst].worst_px))
          worst = c;
      }
      if (worst < 0) return;
      trusted[worst] = false;
    }
  }

  // ---- 2. points

  /// What the trusted cameras but c know of the points that c sees.
  std::vector<PointSighting> sightings_of(int c, const std::vector<bool>& trusted) const {
    std::vector<PointSighting> sightings;
    for (const auto& track : tracks_) {
      std::vector<SightLine> lines;
      const Sight* own = nullptr;
      for (const Sight& s : track) {
        if (s.camera == c) own = &s;
        if (s.camera == c || !trusted[s.camera]) continue;
        const Pose p = pose_of(s.camera);
        lines.push_back({p.centre(), p.R.transpose() * s.ray, focal_of(camera(s.camera))});
      }
      if (own == nullptr) continue;
      if (const auto point = triangulate(lines, options_.most_point_px))
        sightings.push_back({*point, own->ray, own->at_px});
    }
    return sightings;
  }

  ResectionOptions resection_options(int c, bool hold_centre) const {
    const Camera& k = camera(c);
    return {focal_of(k), Eigen::Vector2d(k.width, k.height), hold_centre, options_.least_points};
  }

  /// Covariance that the rig itself leaves a camera's change: see check_rig.
  Matrix6d rig_covariance(int c) const {
    Matrix6d S = Matrix6d::Zero();
    const Eigen::Vector3d sigma = rig_.cameras[c].position_sigma_m;
    if (!sigma.allFinite()) return S;
    const double depth =
        rig_.nearest_seen_m > 0 ? rig_.nearest_seen_m : std::numeric_limits<double>::infinity();
    S.diagonal().head<3>().setConstant(2 * std::pow(sigma.head<2>().norm() / depth, 2));
    S.diagonal().tail<3>() = 2 * sigma.cwiseAbs2();
    return S;
  }

  /// Back to metres, the rig's own uncertainty added.
  Resection in_metres(Resection r, int c) const {
    r.cam_from_rig.t *= unit_m_;
    r.change.tail<3>() *= unit_m_;
    r.covariance.rightCols<3>() *= unit_m_;
    r.covariance.bottomRows<3>() *= unit_m_;
    r.covariance += rig_covariance(c);
    return r;
  }

  struct Change {
    Resection r;
    bool shift_known = true;
  };

  /// Turn and shift; or, where the scene is too far for a shift to be seen, the turn alone.
  std::optional<Change> change_of(int c, const std::vector<PointSighting>& sightings,
                                  bool from_nothing) const {
    const auto solve = [&](bool hold_centre) {
      const ResectionOptions o = resection_options(c, hold_centre);
      return from_nothing ? resect_from_nothing(sightings, pose_of(c), o) : resect(sightings, pose_of(c), o);
    };
    std::optional<Resection> both = solve(false);
    const auto share = [](const Resection& r) { return double(r.inliers) / r.sightings; };
    if (both) {
      const Eigen::Matrix3d shift = both->covariance.bottomRightCorner<3, 3>() * unit_m_ * unit_m_;
      const double sigma =
          std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(shift).eigenvalues().maxCoeff());
      if (sigma <= options_.most_shift_sigma * spacing_m_ && share(*both) >= kLikelyAgreement)
        return Change{in_metres(*both, c), true};
    }
    const std::optional<Resection> turn = solve(true);
    if (!turn || share(*turn) < kLikelyAgreement) return std::nullopt;
    return Change{in_metres(*turn, c), false};
  }

  bool is_significant(const Change& change) const {
    const int n = change.shift_known ? 6 : 3;
    const Eigen::VectorXd d = change.r.change.head(n);
    const Eigen::MatrixXd S = change.r.covariance.topLeftCorner(n, n);
    return d.dot(S.ldlt().solve(d)) > options_.most_chi2 && change.r.effect_px > options_.least_effect_px;
  }

  /// Effect [px] of every trusted camera's change, as the others see it; 0 where it is not significant.
  std::vector<double> disagreement(const std::vector<bool>& trusted) const {
    std::vector<double> effect(n_, 0);
    parallel_for(n_, [&](int c) {
      if (!trusted[c]) return;
      const auto change = change_of(c, sightings_of(c, trusted), false);
      if (change && is_significant(*change)) effect[c] = change->r.effect_px;
    });
    return effect;
  }

  /// A camera that moved spoils the points of its neighbours, which then look moved themselves: of the worst
  /// few, the one goes whose going leaves the least disagreement. Returns whether the rest is too small to
  /// tell which of them is wrong.
  bool set_aside_by_points(std::vector<bool>& trusted) const {
    constexpr std::size_t kCandidates = 4;
    while (true) {
      const std::vector<double> effect = disagreement(trusted);
      std::vector<int> candidates;
      for (int c = 0; c < n_; ++c)
        if (effect[c] > 0) candidates.push_back(c);
      if (candidates.empty()) return false;
      if (std::count(trusted.begin(), trusted.end(), true) <= 3) return true;
      std::sort(candidates.begin(), candidates.end(), [&](int a, int b) { return effect[a] > effect[b]; });
      candidates.resize(std::min(candidates.size(), kCandidates));
      int best = candidates[0];
      double least = std::numeric_limits<double>::infinity();
      for (const int c : candidates) {
        if (candidates.size() == 1) break;
        std::vector<bool> rest = trusted;
        rest[c] = false;
        const std::vector<double> left = disagreement(rest);
        const double sum = std::accumulate(left.begin(), left.end(), 0.0);
        if (sum < least) least = sum, best = c;
      }
      trusted[best] = false;
    }
  }

  // ---- 3. verdict on one camera

  void judge(int c, const std::vector<bool>& trusted, bool ambiguous) {
    CameraCheck& check = out_.cameras[c];
    const auto say = [&](CheckStatus status, std::string reason) {
      check.status = status;
      check.reason = std::move(reason);
    };
    if (!in_.cameras[c].present) return say(CheckStatus::missing, in_.cameras[c].problem);
    if (!rig_.cameras[c].determined)
      return say(CheckStatus::undetermined, "the rig does not know where it stands: calibrate again");
    if (ambiguous && trusted[c])
      return say(
          CheckStatus::undetermined,
          "one of the last three cameras that agree along their epipolar lines has moved; three do not "
          "tell which");
    const auto others = std::count(trusted.begin(), trusted.end(), true) - (trusted[c] ? 1 : 0);
    if (others < 1)
      return say(CheckStatus::undetermined, "no two cameras agree with the rig: calibrate again");
    if (others == 1 && trusted[c]) return say(CheckStatus::ok, "");
    if (others == 1)
      return say(CheckStatus::undetermined, "only one other camera is left to compare it with");
    const std::vector<PointSighting> sightings = sightings_of(c, trusted);
    if (static_cast<int>(sightings.size()) < options_.least_points)
      return say(
          CheckStatus::undetermined,
          fmt::format("shares {} points with cameras that agree, needs {}: record a scene with more texture",
                      sightings.size(), options_.least_points));
    if (in_.cameras[c].mirrored) return judge_mirrored(c, sightings, check);
    if (!trusted[c] && explained_by_another(c, sightings, check)) return;
    if (!trusted[c] && explained_by_half_turn(c, sightings, check)) return;
    judge_change(c, sightings, check);
  }

  /// Of its pairs with the trusted, more than half.
  bool pairs_agree(int c) const {
    std::vector<bool> with = std::vector<bool>(n_, false);
    for (const int k : out_.trusted) with[k] = true;
    with[c] = true;
    return opinions(with)[c].share() < 0.5;
  }

  /// Median distance [px] between where the camera k sees the points and where they were found.
  double median_residual(const Camera& k, const std::vector<PointSighting>& sightings,
                         const std::vector<Eigen::Vector2d>& found_px) const {
    std::vector<Eigen::Vector3d> points;
    Pose pose = k.cam_from_rig;
    pose.t /= unit_m_;
    for (const PointSighting& s : sightings)
      points.emplace_back(pose.R * s.point.X.head<3>() + s.point.X[3] * pose.t);
    const std::vector<Eigen::Vector2d> pixels = project(k, points);
    std::vector<double> distances;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      const double d = (pixels[i] - found_px[i]).norm();
      distances.push_back(std::isfinite(d) && points[i].z() > 0 ? d : 1e9);
    }
    return median(distances);
  }

  static std::vector<Eigen::Vector2d> places_of(const std::vector<PointSighting>& sightings) {
    std::vector<Eigen::Vector2d> places;
    for (const PointSighting& s : sightings) places.push_back(s.at_px);
    return places;
  }

  bool explained_by_another(int c, const std::vector<PointSighting>& sightings, CameraCheck& check) const {
    const std::vector<Eigen::Vector2d> places = places_of(sightings);
    const double own = median_residual(camera(c), sightings, places);
    int best = -1;
    double least = std::numeric_limits<double>::infinity();
    for (int k = 0; k < n_; ++k) {
      if (k == c || !rig_.cameras[k].determined) continue;
      const double residual = median_residual(camera(k), sightings, places);
      if (residual < least) least = residual, best = k;
    }
    if (best < 0 || least > kHypothesisPx || kMuchBetter * least > own) return false;
    check.status = CheckStatus::swapped_with;
    check.partner = camera(best).name;
    check.reason = fmt::format("its pictures are what camera {} sees: exchange the two", check.partner);
    Camera corrected = camera(best);
    corrected.name = check.name;
    check.corrected = corrected;
    return true;
  }

  bool explained_by_half_turn(int c, const std::vector<PointSighting>& sightings, CameraCheck& check) const {
    const std::optional<Camera> turned = half_turned(camera(c));
    if (!turned) return false;
    const std::vector<Eigen::Vector2d> places = places_of(sightings);
    if (median_residual(*turned, sightings, places) > kHypothesisPx) return false;
    check.status = CheckStatus::upside_down;
    check.reason = "its pictures are turned by half a turn";
    check.corrected = turned;
    return true;
  }

  /// The sightings are of the flipped picture, which is as the camera would see it.
  void judge_mirrored(int c, const std::vector<PointSighting>& sightings, CameraCheck& check) const {
    check.status = CheckStatus::mirrored;
    const std::vector<Eigen::Vector2d> places = places_of(sightings);
    const std::optional<Camera> turned = half_turned(camera(c));
    check.half_turn =
        turned && median_residual(*turned, sightings, places) < median_residual(camera(c), sightings, places);
    check.reason = check.half_turn ? "its pictures are flipped top to bottom: flip them back"
                                   : "its pictures are flipped left to right: flip them back";
  }

  void judge_change(int c, const std::vector<PointSighting>& sightings, CameraCheck& check) const {
    std::optional<Change> change = change_of(c, sightings, false);
    if (!change) change = change_of(c, sightings, true);
    if (!change) {
      check.reason =
          fmt::format("no pose agrees with half of the {} points it shares: moved far, or the scene moved",
                      sightings.size());
      return;
    }
    check.change = change->r;
    check.shift_known = change->shift_known;
    if (change->r.effect_sigma_px > options_.most_effect_sigma_px) {
      check.reason = fmt::format(
          "its place is known to {:.1f} px only, from {} points: record a scene with more texture",
          change->r.effect_sigma_px, change->r.inliers);
      return;
    }
    if (!is_significant(*change)) {
      check.status = CheckStatus::ok;
      if (!pairs_agree(c)) {
        check.status = CheckStatus::undetermined;
        check.reason = "its pairs speak against the rig, its points do not";
      }
      return;
    }
    describe_move(c, check);
  }

  void describe_move(int c, CameraCheck& check) const {
    const double turn = check.change->change.head<3>().norm() * kDeg;
    const double about_axis = std::abs(check.change->change[2]) * kDeg;
    const bool over = turn > 150 && about_axis > 140;
    check.status = over ? CheckStatus::upside_down : CheckStatus::moved;
    check.reason = over ? fmt::format("turned by {:.1f} degrees", turn)
                        : fmt::format("its picture is {:.1f} px off", check.change->effect_px);
    if (!check.shift_known)
      check.reason += "; the scene is too far off to tell a shift, the camera is taken to have turned only";
    Camera corrected = camera(c);
    corrected.cam_from_rig = check.change->cam_from_rig;
    check.corrected = corrected;
  }

  // ---- the whole

  void compare_light() {
    std::vector<double> levels;
    for (const SceneSight& s : in_.cameras)
      if (s.present) levels.push_back(s.level);
    const double usual = median(levels);
    for (int c = 0; c < n_; ++c) {
      if (!(usual > 0) || !in_.cameras[c].present) continue;
      CameraCheck& check = out_.cameras[c];
      check.light = in_.cameras[c].level / usual;
      if (check.light < 0.5 || check.light > 2)
        out_.notes.push_back(fmt::format("camera {} is {:.1f} times {} than is usual: check its exposure",
                                         check.name, check.light < 1 ? 1 / check.light : check.light,
                                         check.light < 1 ? "darker" : "brighter"));
    }
  }

  void conclude() {
    for (const CameraCheck& check : out_.cameras)
      if (check.status != CheckStatus::ok)
        out_.reasons.push_back(fmt::format("camera {} {}: {}", check.name, phrase(check), check.reason));
    out_.good = out_.reasons.empty();
  }

  static std::string phrase(const CameraCheck& check) {
    switch (check.status) {
      case CheckStatus::moved:
        return "has moved";
      case CheckStatus::swapped_with:
        return "is swapped with " + check.partner;
      case CheckStatus::mirrored:
        return "is mirrored";
      case CheckStatus::upside_down:
        return "is upside down";
      case CheckStatus::missing:
        return "is missing";
      default:
        return "could not be checked";
    }
  }

  const SceneEvidence& in_;
  const Rig& rig_;
  const CheckOptions& options_;
  const int n_;
  double unit_m_ = 1, spacing_m_ = 1;
  std::vector<std::vector<Sight>> tracks_;
  std::vector<double> pair_px_;
  SceneCheck out_;
};

/// Centre less its lattice point, and less the plane.
Eigen::Vector3d off_lattice(const Rig& rig, const RigCamera& rc) {
  Eigen::Vector3d off = rc.camera.cam_from_rig.centre();
  off.head<2>() -= rig.lattice_origin_m + rc.col * rig.s_step_m + rc.row * rig.t_step_m;
  return off;
}

/// The moved camera's block of the centres' covariance: its own, and nothing in common with the others.
void renew_covariance(Rig& rig, int c, const Eigen::Matrix3d& covariance) {
  Eigen::Index place = 0;
  for (int k = 0; k < c; ++k) place += rig.cameras[k].determined ? 3 : 0;
  Eigen::MatrixXd& S = rig.centre_covariance_m2;
  if (S.rows() < place + 3) return;
  S.middleRows(place, 3).setZero();
  S.middleCols(place, 3).setZero();
  S.block<3, 3>(place, place) = covariance;
}

void correct_move(Rig& rig, int c, const CameraCheck& check) {
  RigCamera& rc = rig.cameras[c];
  rc.camera = *check.corrected;
  rc.off_lattice_m = off_lattice(rig, rc);
  if (!check.change || !check.shift_known) return;
  const Eigen::Matrix3d covariance = check.change->covariance.bottomRightCorner<3, 3>();
  rc.position_sigma_m = covariance.diagonal().cwiseMax(0).cwiseSqrt();
  renew_covariance(rig, c, covariance);
}

Json sigma_along(const Eigen::Vector3d& v, const Eigen::Matrix3d& covariance, double factor) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(covariance);
  const double largest = std::sqrt(std::max(0.0, eigen.eigenvalues()[2]));
  // Of a length below its own uncertainty the direction says nothing.
  const double sigma =
      v.norm() > largest ? std::sqrt(v.normalized().dot(covariance * v.normalized())) : largest;
  return factor * sigma;
}

Json list(const Eigen::Vector3d& v) { return {v.x(), v.y(), v.z()}; }

}  // namespace

Json to_json(const CameraCheck& check) {
  Json json = {{"name", check.name},
               {"status", name_of(check.status)},
               {"reason", check.reason},
               {"swapped_with", nullptr},
               {"rotation_deg", nullptr},
               {"rotation_sigma_deg", nullptr},
               {"translation_mm", nullptr},
               {"translation_sigma_mm", nullptr},
               {"effect_px", nullptr},
               {"rms_px", nullptr},
               {"points", 0},
               {"rotation_rad", nullptr},
               {"shift_m", nullptr},
               {"correctable", check.corrected.has_value()},
               {"light", check.light}};
  if (!check.partner.empty()) json["swapped_with"] = check.partner;
  if (!check.change) return json;
  const Resection& r = *check.change;
  const Eigen::Vector3d turn = r.change.head<3>(), shift = r.change.tail<3>();
  json["rotation_deg"] = kDeg * turn.norm();
  json["rotation_sigma_deg"] = sigma_along(turn, r.covariance.topLeftCorner<3, 3>(), kDeg);
  json["rotation_rad"] = list(turn);
  if (check.shift_known) {
    json["translation_mm"] = 1e3 * shift.norm();
    json["translation_sigma_mm"] = sigma_along(shift, r.covariance.bottomRightCorner<3, 3>(), 1e3);
    json["shift_m"] = list(shift);
  }
  json["effect_px"] = r.effect_px;
  json["rms_px"] = r.rms_px;
  json["points"] = r.inliers;
  return json;
}

const char* name_of(CheckStatus status) {
  switch (status) {
    case CheckStatus::ok:
      return "ok";
    case CheckStatus::moved:
      return "moved";
    case CheckStatus::swapped_with:
      return "swapped_with";
    case CheckStatus::mirrored:
      return "mirrored";
    case CheckStatus::upside_down:
      return "upside_down";
    case CheckStatus::missing:
      return "missing";
    default:
      return "undetermined";
  }
}

SceneCheck check_rig(const SceneEvidence& evidence, const Rig& rig, const CheckOptions& options) {
  return Checker(evidence, rig, options).run();
}

Rig corrected_rig(const Rig& rig, const SceneCheck& check) {
  Rig result = rig;
  for (std::size_t c = 0; c < rig.cameras.size(); ++c) {
    const CameraCheck& camera = check.cameras[c];
    if (!camera.corrected) continue;
    if (camera.status == CheckStatus::swapped_with) {
      const std::string name = rig.cameras[c].camera.name;
      result.cameras[c] = rig.cameras[rig.camera_index(camera.partner)];
      result.cameras[c].camera.name = name;
    } else {
      correct_move(result, static_cast<int>(c), camera);
    }
  }
  return result;
}

Json to_json(const SceneCheck& check) {
  Json cameras = Json::array(), trusted = Json::array();
  for (const CameraCheck& camera : check.cameras) cameras.push_back(to_json(camera));
  for (const int c : check.trusted) trusted.push_back(check.cameras[c].name);
  return {{"verdict", {{"good", check.good}, {"reasons", check.reasons}}},
          {"notes", check.notes},
          {"trusted", trusted},
          {"cameras", cameras}};
}

}  // namespace stuv
