#include <ceres/ceres.h>
#include <ceres/normal_prior.h>
#include <ceres/rotation.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <opencv2/calib3d.hpp>

#include "calib/two_view/essential.h"
#include "calib/two_view/estimate.h"
#include "calib/two_view/no_board.h"
#include "core/median.h"

namespace stuv {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// Rotation vector and centre: x = R (X - c).
struct View {
  std::array<double, 3> r{}, c{};
  Pose pose() const {
    Pose p;
    p.R = rotation_from_vector({r[0], r[1], r[2]});
    p.t = -(p.R * Eigen::Vector3d(c[0], c[1], c[2]));
    return p;
  }
  static View of(const Pose& pose) {
    const Eigen::Vector3d r = vector_from_rotation(pose.R), c = pose.centre();
    return {{r.x(), r.y(), r.z()}, {c.x(), c.y(), c.z()}};
  }
};

struct Reprojection {
  Eigen::Vector2d at;
  template <class T>
  bool operator()(const T* f, const T* r, const T* c, const T* X, T* residual) const {
    const T d[3] = {X[0] - c[0], X[1] - c[1], X[2] - c[2]};
    T x[3];
    ceres::AngleAxisRotatePoint(r, d, x);
    residual[0] = f[0] * x[0] / x[2] - at.x();
    residual[1] = f[0] * x[1] / x[2] - at.y();
    return true;
  }
};

/// The same with a lens that is known with a covariance.
struct ReprojectionByLens {
  Eigen::Vector2d at;
  LensSlope by_lens;
  template <class T>
  bool operator()(const T* f, const T* r, const T* c, const T* X, const T* y, T* residual) const {
    Reprojection{at}(f, r, c, X, residual);
    for (int i = 0; i < kMostLensStates; ++i) {
      residual[0] -= by_lens(0, i) * y[i];
      residual[1] -= by_lens(1, i) * y[i];
    }
    return true;
  }
};
using FixedLensCost = ceres::AutoDiffCostFunction<Reprojection, 2, 1, 3, 3, 3>;
using FreeLensCost = ceres::AutoDiffCostFunction<ReprojectionByLens, 2, 1, 3, 3, 3, kMostLensStates>;

class Sfm {
 public:
  Sfm(const SfmProblem& in, std::uint64_t seed, const Reporter& reporter)
      : in_(in), seed_(seed), reporter_(reporter), focal_(in.focal_px) {
    views_.resize(in.cameras);
    lens_.assign(in.cameras, SfmSolution::LensStates::Zero());
    lenses_free_ = !in.tracks.empty() && std::all_of(in.tracks.begin(), in.tracks.end(),
                                                     [](const Track& t) { return !t.by_lens.empty(); });
    placed_.assign(in.cameras, false);
    points_.assign(in.tracks.size(), Eigen::Vector3d::Constant(kNaN));
    for (const Track& t : in.tracks) inlier_.emplace_back(t.camera.size(), true);
  }

  SfmSolution solve() {
    SfmSolution out;
    const bool given = take_start();
    if (given || begin()) {
      int count = 2;
      while (!given && place_next()) {
        adjust(true, 20);
        triangulate_new();
        reporter_.at("placing cameras", ++count, in_.cameras);
      }
      for (int round = 0; round < 3; ++round) {
        adjust(true, 50);
        for (std::size_t t = 0; t < points_.size(); ++t) points_[t].setConstant(kNaN);
        triangulate_new();
        reject();
        huber_px_ = std::clamp(2 * residual_sigma(), 0.02, 1.0);
      }
      for (int round = 0; round < 3; ++round) {
        noise_px_ = std::max(0.01, residual_sigma());
        out.converged = adjust(false, 100);
        if (!reject()) break;
      }
      out.converged = adjust(false, 100);
      covariance(out);
    }
    finish(out);
    return out;
  }

 private:
  Eigen::Vector2d ray(const Eigen::Vector2d& at) const { return at / focal_; }

  /// Where the lens as it is now says the observation is.
  Eigen::Vector2d at(std::size_t t, std::size_t k) const {
    const Track& track = in_.tracks[t];
    return lenses_free_ ? Eigen::Vector2d(track.at_px[k] + track.by_lens[k] * lens_[track.camera[k]])
                        : track.at_px[k];
  }

  Eigen::Vector2d residual(std::size_t t, std::size_t k) const {
    const Pose p = views_[in_.tracks[t].camera[k]].pose();
    const Eigen::Vector3d x = p * points_[t];
    return x.z() > 0 ? Eigen::Vector2d(focal_ * x.hnormalized() - at(t, k)) : Eigen::Vector2d::Constant(1e6);
  }

  bool used(std::size_t t, std::size_t k) const {
    return inlier_[t][k] && placed_[in_.tracks[t].camera[k]] && points_[t].allFinite();
  }

  /// Matches of two cameras in ideal pixels.
  Matches between(int a, int b) const {
    Matches m;
    for (const Track& t : in_.tracks) {
      const auto ia = std::find(t.camera.begin(), t.camera.end(), a),
                 ib = std::find(t.camera.begin(), t.camera.end(), b);
      if (ia != t.camera.end() && ib != t.camera.end())
        m.push_back({t.at_px[ia - t.camera.begin()], t.at_px[ib - t.camera.begin()]});
    }
    return m;
  }

  /// The poses of the problem, if it has two; the gauge is held by those farthest apart.
  bool take_start() {
    double farthest = 0;
    for (std::size_t a = 0; a < in_.started.size(); ++a)
      for (std::size_t b = a + 1; b < in_.started.size(); ++b) {
        const double d = (in_.start[a].centre() - in_.start[b].centre()).norm();
        if (!in_.started[a] || !in_.started[b] || !(d > farthest)) continue;
        farthest = d;
        first_ = static_cast<int>(a);
        second_ = static_cast<int>(b);
      }
    if (!(farthest > 0)) return false;
    placed_ = in_.started;
    for (int c = 0; c < in_.cameras; ++c)
      if (placed_[c]) views_[c] = View::of(in_.start[c]);
    triangulate_new();
    return true;
  }

  /// The pair with the most matches times their median motion beyond a turn's, tried in that order until one
  /// gives a pose.
  bool begin() {
    std::vector<std::pair<double, std::pair<int, int>>> pairs;
    for (int a = 0; a < in_.cameras; ++a)
      for (int b = a + 1; b < in_.cameras; ++b) {
        const Matches m = between(a, b);
        if (m.size() < 30) continue;
        // Spread of the motion about its mean: what parallax makes, a turn hardly.
        Eigen::Vector2d mean = Eigen::Vector2d::Zero();
        for (const Match& q : m) mean += (q.b - q.a) / static_cast<double>(m.size());
        std::vector<double> spread;
        for (const Match& q : m) spread.push_back((q.b - q.a - mean).norm());
        pairs.push_back({-std::sqrt(double(m.size())) * median(std::move(spread)), {a, b}});
      }
    std::sort(pairs.begin(), pairs.end());
    for (std::size_t i = 0; i < std::min<std::size_t>(pairs.size(), 20); ++i)
      if (start_with(pairs[i].second.first, pairs[i].second.second)) return true;
    return false;
  }

  bool start_with(int a, int b) {
    const Matches m = between(a, b);
    std::vector<cv::Point2d> pa, pb;
    Matches rays;
    for (const Match& q : m) {
      rays.push_back({ray(q.a), ray(q.b)});
      pa.emplace_back(rays.back().a.x(), rays.back().a.y());
      pb.emplace_back(rays.back().b.x(), rays.back().b.y());
    }
    cv::Mat mask;
    cv::theRNG().state = seed_;
    const cv::Mat E =
        cv::findEssentialMat(pa, pb, cv::Mat::eye(3, 3, CV_64F), cv::RANSAC, 0.999, 1.5 / focal_, mask);
    if (E.rows != 3) return false;
    Eigen::Matrix3d e;
    for (int i = 0; i < 9; ++i) e(i / 3, i % 3) = E.at<double>(i / 3, i % 3);
    Matches good;
    for (std::size_t i = 0; i < rays.size(); ++i)
      if (mask.at<std::uint8_t>(static_cast<int>(i)) != 0) good.push_back(rays[i]);
    const RelativePose pose = pose_of(e, good);
    if (good.size() < 20 || pose.in_front < 0.8 * static_cast<double>(good.size())) return false;
    views_[a] = View{};
    views_[b] = View::of(pose.b_from_a);
    placed_.assign(in_.cameras, false);
    placed_[a] = placed_[b] = true;
    first_ = a;
    second_ = b;
    triangulate_new();
    return adjust(true, 50);
  }

  /// Points seen by two placed cameras or more, where rays meet at an angle and every residual is small.
  void triangulate_new() {
    for (std::size_t t = 0; t < points_.size(); ++t) {
      if (points_[t].allFinite()) continue;
      std::vector<Eigen::Vector3d> centre, direction;
      for (std::size_t k = 0; k < in_.tracks[t].camera.size(); ++k) {
        if (!placed_[in_.tracks[t].camera[k]] || !inlier_[t][k]) continue;
        const Pose p = views_[in_.tracks[t].camera[k]].pose();
        centre.push_back(p.centre());
        direction.push_back((p.R.transpose() * ray(at(t, k)).homogeneous()).normalized());
      }
      if (centre.size() < 2) continue;
      Eigen::Matrix3d A = Eigen::Matrix3d::Zero();
      Eigen::Vector3d b = Eigen::Vector3d::Zero();
      double least_cos = 1;
      for (std::size_t i = 0; i < centre.size(); ++i) {
        const Eigen::Matrix3d P = Eigen::Matrix3d::Identity() - direction[i] * direction[i].transpose();
        A += P;
        b += P * centre[i];
        for (std::size_t j = 0; j < i; ++j) least_cos = std::min(least_cos, direction[i].dot(direction[j]));
      }
      if (least_cos > std::cos(0.005)) continue;
      points_[t] = A.ldlt().solve(b);
      bool good = points_[t].allFinite();
      for (std::size_t k = 0; good && k < in_.tracks[t].camera.size(); ++k)
        good = !used(t, k) || residual(t, k).norm() < 6;
      if (!good) points_[t].setConstant(kNaN);
    }
  }

  /// The camera that sees most of the points there are.
  bool place_next() {
    std::vector<int> seen(in_.cameras, 0);
    for (std::size_t t = 0; t < points_.size(); ++t)
      if (points_[t].allFinite())
        for (const int c : in_.tracks[t].camera) seen[c] += placed_[c] ? 0 : 1;
    const int next = static_cast<int>(std::max_element(seen.begin(), seen.end()) - seen.begin());
    if (seen[next] < 12) return false;
    std::vector<cv::Point3d> X;
    std::vector<cv::Point2d> x;
    for (std::size_t t = 0; t < points_.size(); ++t)
      for (std::size_t k = 0; k < in_.tracks[t].camera.size(); ++k)
        if (in_.tracks[t].camera[k] == next && points_[t].allFinite()) {
          X.emplace_back(points_[t].x(), points_[t].y(), points_[t].z());
          x.emplace_back(in_.tracks[t].at_px[k].x(), in_.tracks[t].at_px[k].y());
        }
    const cv::Mat K = (cv::Mat_<double>(3, 3) << focal_, 0, 0, 0, focal_, 0, 0, 0, 1);
    cv::Mat r, t;
    cv::theRNG().state = seed_;
    if (!cv::solvePnPRansac(X, x, K, cv::noArray(), r, t, false, 300, 4.0F, 0.999, cv::noArray(),
                            cv::SOLVEPNP_SQPNP))
      return false;
    Pose pose;
    pose.R = rotation_from_vector({r.at<double>(0), r.at<double>(1), r.at<double>(2)});
    pose.t = {t.at<double>(0), t.at<double>(1), t.at<double>(2)};
    views_[next] = View::of(pose);
    placed_[next] = true;
    return true;
  }

  /// Adds all used observations; holds the gauge.
  void build(ceres::Problem& problem, bool robust) {
    problem.AddParameterBlock(&focal_, 1);
    // Two or three cameras hardly tell a focal length.
    if (in_.focal_known || std::count(placed_.begin(), placed_.end(), true) < 4)
      problem.SetParameterBlockConstant(&focal_);
    for (std::size_t t = 0; t < points_.size(); ++t)
      for (std::size_t k = 0; k < in_.tracks[t].camera.size(); ++k) {
        if (!used(t, k)) continue;
        View& v = views_[in_.tracks[t].camera[k]];
        if (lenses_free_ && !robust)
          problem.AddResidualBlock(free_lens_cost(t, k), nullptr, &focal_, v.r.data(), v.c.data(),
                                   points_[t].data(), lens_[in_.tracks[t].camera[k]].data());
        else
          problem.AddResidualBlock(new FixedLensCost(new Reprojection{at(t, k)}),
                                   robust ? new ceres::HuberLoss(huber_px_) : nullptr, &focal_, v.r.data(),
                                   v.c.data(), points_[t].data());
      }
    for (auto& y : lens_)
      if (problem.HasParameterBlock(y.data()))
        problem.AddResidualBlock(
            new ceres::NormalPrior(noise_px_ * Eigen::MatrixXd::Identity(kMostLensStates, kMostLensStates),
                                   Eigen::VectorXd::Zero(kMostLensStates)),
            nullptr, y.data());
    View &a = views_[first_], &b = views_[second_];
    for (double* block : {a.r.data(), a.c.data()})
      if (problem.HasParameterBlock(block)) problem.SetParameterBlockConstant(block);
    int longest = 0;
    for (int i = 1; i < 3; ++i)
      if (std::abs(b.c[i] - a.c[i]) > std::abs(b.c[longest] - a.c[longest])) longest = i;
    if (problem.HasParameterBlock(b.c.data()))
      problem.SetManifold(b.c.data(), new ceres::SubsetManifold(3, {longest}));
  }

  FreeLensCost* free_lens_cost(std::size_t t, std::size_t k) const {
    return new FreeLensCost(new ReprojectionByLens{in_.tracks[t].at_px[k], in_.tracks[t].by_lens[k]});
  }

  bool adjust(bool robust, int steps) {
    ceres::Problem problem;
    build(problem, robust);
    if (problem.NumResidualBlocks() < 20) return false;
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_SCHUR;
    options.max_num_iterations = steps;
    options.function_tolerance = 1e-10;
    options.logging_type = ceres::SILENT;
    options.num_threads = 1;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    return summary.IsSolutionUsable() && (robust || summary.termination_type == ceres::CONVERGENCE);
  }

  /// Deviation of one coordinate, from the median of the residuals.
  double residual_sigma() const {
    std::vector<double> r;
    for (std::size_t t = 0; t < points_.size(); ++t)
      for (std::size_t k = 0; k < inlier_[t].size(); ++k)
        if (used(t, k)) r.push_back(residual(t, k).norm());
    if (r.empty()) return 0;
    return median(std::move(r)) / 1.1774;  // of Rayleigh's distribution
  }

  /// Takes observations beyond four deviations out, and points left with one ray; whether there were any.
  bool reject() {
    const double sigma = std::max(0.01, residual_sigma());
    bool any = false;
    for (std::size_t t = 0; t < points_.size(); ++t) {
      int left = 0;
      for (std::size_t k = 0; k < inlier_[t].size(); ++k) {
        if (!used(t, k)) continue;
        if (residual(t, k).norm() > 4 * sigma)
          inlier_[t][k] = false, any = true;
        else
          ++left;
      }
      if (left < 2) points_[t].setConstant(kNaN);
    }
    return any;
  }

  struct Linear {
    Eigen::Vector2d r;
    Eigen::Matrix<double, 2, Eigen::Dynamic> J;  ///< by focal, r, c and lens
    Eigen::Matrix<double, 2, 3> Jx;
  };
  Linear linearise(std::size_t t, std::size_t k) const {
    const int camera = in_.tracks[t].camera[k];
    const View& v = views_[camera];
    Eigen::Matrix<double, 2, 1> Jf;
    Eigen::Matrix<double, 2, 3, Eigen::RowMajor> Jr, Jc, Jx;
    double* jacobians[] = {Jf.data(), Jr.data(), Jc.data(), Jx.data()};
    const double* parameters[] = {&focal_, v.r.data(), v.c.data(), points_[t].data()};
    Linear l;
    FixedLensCost(new Reprojection{at(t, k)}).Evaluate(parameters, l.r.data(), jacobians);
    l.J.resize(2, lenses_free_ ? 7 + kMostLensStates : 7);
    l.J.leftCols<7>() << Jf, Jr, Jc;
    if (lenses_free_) l.J.rightCols<kMostLensStates>() = -in_.tracks[t].by_lens[k];
    l.Jx = Jx;
    return l;
  }

  /// S^-1 M S^-1 of focal length, rotations, centres and lenses: S the Schur complement of the points in J^T
  /// J, M the sum of g g^T over gradients g that are taken as one: of a track, and of a sixteenth of a
  /// picture, less what both count (Cameron, Gelbach, Miller, 2011). A feature's errors in neighbouring
  /// pictures are alike, and so are those of neighbouring features, which (J^T J)^-1 does not know.
  void covariance(SfmSolution& out) {
    // Columns: focal, then r, c and lens of each camera. What the gauge holds is left out.
    const int lens_states = lenses_free_ ? kMostLensStates : 0, states = 6 + lens_states;
    const int n = 1 + states * in_.cameras;
    Eigen::MatrixXd S = Eigen::MatrixXd::Zero(n, n), M = S;
    std::map<std::pair<int, int>, Eigen::VectorXd> parts;  // gradients of (camera, part of its picture)
    Eigen::Vector2d extent = Eigen::Vector2d::Ones();
    for (const Track& t : in_.tracks)
      for (const Eigen::Vector2d& at : t.at_px) extent = extent.cwiseMax(at.cwiseAbs());
    for (std::size_t t = 0; t < points_.size(); ++t) {
      Eigen::Matrix3d V = Eigen::Matrix3d::Zero();
      std::vector<int> columns;
      Eigen::MatrixXd W = Eigen::MatrixXd::Zero(n, 3);
      struct Part {
        Eigen::VectorXd g;
        Eigen::Vector3d gx;
        std::vector<int> at;
        std::pair<int, int> key;
      };
      std::vector<Part> observed;
      for (std::size_t k = 0; k < inlier_[t].size(); ++k) {
        if (!used(t, k)) continue;
        const int camera = in_.tracks[t].camera[k];
        const Linear l = linearise(t, k);
        std::vector<int> at{0};
        for (int i = 0; i < states; ++i) at.push_back(1 + states * camera + i);
        for (int i = 0; i <= states; ++i) {
          columns.push_back(at[i]);
          for (int j = 0; j <= states; ++j) S(at[i], at[j]) += l.J.col(i).dot(l.J.col(j));
          W.row(at[i]) += l.J.col(i).transpose() * l.Jx;
        }
        const Eigen::Vector2d place = 2 * (in_.tracks[t].at_px[k].cwiseQuotient(extent).array() + 1);
        const int part = 4 * std::clamp(int(place.y()), 0, 3) + std::clamp(int(place.x()), 0, 3);
        observed.push_back({l.J.transpose() * l.r, l.Jx.transpose() * l.r, at, {camera, part}});
        V += l.Jx.transpose() * l.Jx;
      }
      if (columns.empty()) continue;
      std::sort(columns.begin(), columns.end());
      columns.erase(std::unique(columns.begin(), columns.end()), columns.end());
      const Eigen::Matrix3d V_inverse = V.inverse();
      for (const int i : columns)
        for (const int j : columns) S(i, j) -= W.row(i) * V_inverse * W.row(j).transpose();
      Eigen::VectorXd track = Eigen::VectorXd::Zero(n);
      for (const Part& o : observed) {
        Eigen::VectorXd g = -W * (V_inverse * o.gx);
        for (std::size_t i = 0; i < o.at.size(); ++i) g[o.at[i]] += o.g[static_cast<Eigen::Index>(i)];
        track += g;
        for (const int i : columns)
          for (const int j : columns) M(i, j) -= g[i] * g[j];
        auto [found, added] = parts.try_emplace(o.key, g);
        if (!added) found->second += g;
      }
      for (const int i : columns)
        for (const int j : columns) M(i, j) += track[i] * track[j];
    }
    for (const auto& [key, g] : parts) M += g * g.transpose();
    // What is known of the lenses is a measurement whose noise is noise_px_.
    for (int c = 0; c < in_.cameras; ++c)
      for (int i = 1 + states * c + 6; i < 1 + states * (c + 1); ++i) {
        S(i, i) += std::pow(noise_px_, 2);
        M(i, i) += std::pow(noise_px_, 4);
      }
    std::vector<int> free;
    const View &a = views_[first_], &b = views_[second_];
    int longest = 0;
    for (int i = 1; i < 3; ++i)
      if (std::abs(b.c[i] - a.c[i]) > std::abs(b.c[longest] - a.c[longest])) longest = i;
    for (int i = 0; i < n; ++i) {
      const int camera = (i - 1) / states, state = (i - 1) % states;
      const bool held = i == 0 ? in_.focal_known
                               : !placed_[camera] || (camera == first_ && state < 6) ||
                                     (camera == second_ && state == 3 + longest);
      if (!held) free.push_back(i);
    }
    Eigen::MatrixXd R(free.size(), free.size()), Q = R;
    for (std::size_t i = 0; i < free.size(); ++i)
      for (std::size_t j = 0; j < free.size(); ++j) {
        R(i, j) = S(free[i], free[j]);
        Q(i, j) = M(free[i], free[j]);
      }
    const Eigen::MatrixXd inverse = R.ldlt().solve(Eigen::MatrixXd::Identity(R.rows(), R.cols()));
    // The difference may leave a direction below zero by little.
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(Q);
    const Eigen::MatrixXd root =
        inverse * eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
    const Eigen::MatrixXd robust = root * root.transpose();
    Eigen::MatrixXd all = Eigen::MatrixXd::Zero(n, n);
    for (std::size_t i = 0; i < free.size(); ++i)
      for (std::size_t j = 0; j < free.size(); ++j) all(free[i], free[j]) = robust(i, j);
    out.centre_covariance = Eigen::MatrixXd::Zero(3 * in_.cameras, 3 * in_.cameras);
    for (int i = 0; i < in_.cameras; ++i)
      for (int j = 0; j < in_.cameras; ++j)
        out.centre_covariance.block<3, 3>(3 * i, 3 * j) = all.block<3, 3>(4 + states * i, 4 + states * j);
    if (lenses_free_)
      for (int i = 0; i < in_.cameras; ++i)
        out.lens_covariance.push_back(all.block(7 + states * i, 7 + states * i, lens_states, lens_states));
    out.focal_sigma_px = std::sqrt(std::max(0.0, all(0, 0)));
  }

  void finish(SfmSolution& out) {
    out.focal_px = focal_;
    out.lens = lens_;
    out.placed = placed_;
    for (const View& v : views_) out.cam_from_ref.push_back(v.pose());
    out.points = points_;
    out.inlier = inlier_;
    std::vector<double> sum(in_.cameras, 0);
    out.camera_inliers.assign(in_.cameras, 0);
    double total = 0;
    int points = 0;
    for (std::size_t t = 0; t < points_.size(); ++t) {
      points += points_[t].allFinite() ? 1 : 0;
      for (std::size_t k = 0; k < inlier_[t].size(); ++k) {
        if (!used(t, k)) {
          ++out.outliers;
          continue;
        }
        const double d2 = residual(t, k).squaredNorm();
        total += d2;
        sum[in_.tracks[t].camera[k]] += d2;
        ++out.camera_inliers[in_.tracks[t].camera[k]];
        out.worst_px = std::max(out.worst_px, std::sqrt(d2));
        ++out.inliers;
      }
    }
    for (int c = 0; c < in_.cameras; ++c)
      out.camera_rms_px.push_back(std::sqrt(sum[c] / (2.0 * out.camera_inliers[c])));
    out.rms_px = std::sqrt(total / (2.0 * out.inliers));
    const auto placed = static_cast<double>(std::count(placed_.begin(), placed_.end(), true));
    const double freedom = 2.0 * out.inliers - 3.0 * points - 6 * placed + 7 - (in_.focal_known ? 0 : 1);
    out.noise_px = freedom > 0 ? std::sqrt(total / freedom) : kNaN;
  }

  const SfmProblem& in_;
  std::uint64_t seed_;
  const Reporter& reporter_;
  double focal_;
  std::vector<View> views_;
  std::vector<bool> placed_;
  std::vector<Eigen::Vector3d> points_;
  std::vector<std::vector<bool>> inlier_;
  int first_ = 0, second_ = 1;
  double huber_px_ = 1;
  double noise_px_ = 0;  ///< of one coordinate
  bool lenses_free_ = false;
  std::vector<SfmSolution::LensStates> lens_;
};

}  // namespace

SfmSolution solve_sfm(const SfmProblem& problem, std::uint64_t seed, const Reporter& reporter) {
  return Sfm(problem, seed, reporter).solve();
}

}  // namespace stuv
