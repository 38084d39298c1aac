#include "calib/solve/lens_likeness.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace stuv {
namespace {

constexpr std::array<int, 3> kRadial = {4, 5, 8};  ///< k1, k2, k3 among opencv5's parameters
constexpr int kRounds = 200;

/// A camera's estimate and its covariance, as displacements at the picture's corner.
struct Estimate {
  Eigen::Vector3d d;
  Eigen::Matrix3d P;
};

/// Displacements at the corner of unit distortions.
Eigen::Vector3d displacement(double focal_px, double width, double height) {
  const double rho = 0.5 * std::hypot(width, height) / focal_px;
  return {focal_px * std::pow(rho, 3), focal_px * std::pow(rho, 5), focal_px * std::pow(rho, 7)};
}

/// What the cameras have in common.
struct Kind {
  Eigen::Vector3d m;
  Eigen::Matrix3d S;
};

Kind kind_of(const std::vector<Estimate>& estimates) {
  const auto n = static_cast<double>(estimates.size());
  const Eigen::Matrix3d least = kLeastSpreadPx * kLeastSpreadPx * Eigen::Matrix3d::Identity();
  Kind kind{Eigen::Vector3d::Zero(), 100 * 100 * Eigen::Matrix3d::Identity()};
  for (int round = 0; round < kRounds; ++round) {
    Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (const Estimate& e : estimates) {
      const Eigen::Matrix3d W = (kind.S + e.P).inverse();
      information += W;
      sum += W * e.d;
    }
    kind.m = information.ldlt().solve(sum);
    Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
    for (const Estimate& e : estimates) {
      const Eigen::Matrix3d K = kind.S * (kind.S + e.P).inverse();
      const Eigen::Vector3d off = K * (e.d - kind.m);
      spread += off * off.transpose() + (Eigen::Matrix3d::Identity() - K) * kind.S;
    }
    // n - 1: the mean is from the same cameras.
    kind.S = 0.5 * (spread + spread.transpose()) / (n - 1) + least;
  }
  return kind;
}

bool one_size(const JointSolution& s) {
  const Camera* first = nullptr;
  for (std::size_t c = 0; c < s.cameras.size(); ++c) {
    if (!s.solved[c]) continue;
    if (first == nullptr) first = &s.cameras[c];
    if (s.cameras[c].width != first->width || s.cameras[c].height != first->height) return false;
  }
  return true;
}

}  // namespace

std::optional<LensPrior> lens_likeness(const JointSolution& s) {
  std::vector<Estimate> estimates;
  Eigen::Vector3d scale = Eigen::Vector3d::Zero();
  if (!s.converged || s.camera_covariance.size() == 0 || !(s.sigma_px > 0) || !one_size(s))
    return std::nullopt;
  for (std::size_t c = 0; c < s.cameras.size(); ++c) {
    const Camera& camera = s.cameras[c];
    if (!s.solved[c] || camera.lens_model != "LENSMODEL_OPENCV5") continue;
    if (scale.isZero()) scale = displacement(camera.intrinsics[0], camera.width, camera.height);
    Estimate e;
    for (int i = 0; i < 3; ++i) {
      e.d[i] = scale[i] * camera.intrinsics[kRadial[i]];
      for (int j = 0; j < 3; ++j) {
        const auto at = static_cast<Eigen::Index>(c) * s.camera_states;
        e.P(i, j) = scale[i] * scale[j] * s.sigma_px * s.sigma_px *
                    s.camera_covariance(at + kRadial[i], at + kRadial[j]);
      }
    }
    if (e.d.allFinite() && e.P.allFinite()) estimates.push_back(e);
  }
  if (estimates.size() < static_cast<std::size_t>(kFewestAlike)) return std::nullopt;
  const Kind kind = kind_of(estimates);
  const Eigen::LLT<Eigen::Matrix3d> root(kind.S);
  if (!kind.m.allFinite() || root.info() != Eigen::Success) return std::nullopt;
  LensPrior prior;
  prior.parameter.assign(kRadial.begin(), kRadial.end());
  prior.mean = kind.m.cwiseQuotient(scale);
  const Eigen::Matrix3d inverse = root.matrixL().solve(Eigen::Matrix3d::Identity());
  prior.whiten = s.sigma_px * inverse * scale.asDiagonal();
  return prior;
}

}  // namespace stuv
