#include "calib/bundle_covariance.h"

#include <map>

namespace stuv {
namespace {

/// What one point adds: its observations, the columns of their cameras one after the other.
class PointBlock {
 public:
  explicit PointBlock(const std::vector<const LinearObservation*>& seen) : seen_(seen) {
    for (const LinearObservation* o : seen_)
      for (Eigen::Index k = 0; k < o->by_camera.cols(); ++k)
        columns_.push_back(o->column + static_cast<int>(k));
    const auto n = static_cast<Eigen::Index>(columns_.size());
    W_ = Eigen::MatrixXd::Zero(n, 3);
    Eigen::Index at = 0;
    for (const LinearObservation* o : seen_) {
      W_.middleRows(at, o->by_camera.cols()) = o->by_camera.transpose() * o->by_point;
      V_ += o->by_point.transpose() * o->by_point;
      at += o->by_camera.cols();
    }
    W_over_V_ = W_ * V_.inverse();
  }

  /// The reduced gradient of each observation, in this block's columns.
  Eigen::MatrixXd gradients() const {
    Eigen::MatrixXd g(static_cast<Eigen::Index>(columns_.size()), static_cast<Eigen::Index>(seen_.size()));
    Eigen::Index at = 0;
    for (Eigen::Index i = 0; i < g.cols(); ++i) {
      const LinearObservation& o = *seen_[static_cast<std::size_t>(i)];
      g.col(i) = -W_over_V_ * (o.by_point.transpose() * o.residual);
      g.col(i).segment(at, o.by_camera.cols()) += o.by_camera.transpose() * o.residual;
      at += o.by_camera.cols();
    }
    return g;
  }

  Eigen::MatrixXd information() const {
    Eigen::MatrixXd S = -W_over_V_ * W_.transpose();
    Eigen::Index at = 0;
    for (const LinearObservation* o : seen_) {
      const Eigen::Index k = o->by_camera.cols();
      S.block(at, at, k, k) += o->by_camera.transpose() * o->by_camera;
      at += k;
    }
    return S;
  }

  void add_to(Eigen::MatrixXd& whole, const Eigen::MatrixXd& block) const {
    for (std::size_t i = 0; i < columns_.size(); ++i)
      for (std::size_t j = 0; j < columns_.size(); ++j)
        whole(columns_[i], columns_[j]) += block(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j));
  }
  const std::vector<int>& columns() const { return columns_; }

 private:
  const std::vector<const LinearObservation*>& seen_;
  std::vector<int> columns_;
  Eigen::Matrix3d V_ = Eigen::Matrix3d::Zero();
  Eigen::MatrixXd W_, W_over_V_;
};

}  // namespace

Eigen::MatrixXd bundle_covariance(const std::vector<LinearObservation>& observations, int columns,
                                  const Eigen::MatrixXd& free) {
  std::map<int, std::vector<const LinearObservation*>> points;
  for (const LinearObservation& o : observations) points[o.point].push_back(&o);
  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(columns, columns), M = S;
  std::map<int, Eigen::VectorXd> parts;
  for (const auto& [point, seen] : points) {
    if (seen.size() < 2) continue;  // says nothing of the cameras
    const PointBlock block(seen);
    block.add_to(S, block.information());
    const Eigen::MatrixXd g = block.gradients();
    const Eigen::VectorXd sum = g.rowwise().sum();
    block.add_to(M, sum * sum.transpose() - g * g.transpose());
    for (std::size_t i = 0; i < seen.size(); ++i) {
      Eigen::VectorXd& part = parts.try_emplace(seen[i]->part, Eigen::VectorXd::Zero(columns)).first->second;
      for (std::size_t k = 0; k < block.columns().size(); ++k)
        part[block.columns()[k]] += g(static_cast<Eigen::Index>(k), static_cast<Eigen::Index>(i));
    }
  }
  for (const auto& [part, g] : parts) M.noalias() += g * g.transpose();
  // Directions of the gauge get a spring of the usual stiffness, so that S can be inverted, and are then
  // taken out of the answer.
  const double spring = S.trace() / columns;
  const Eigen::MatrixXd G = Eigen::HouseholderQR<Eigen::MatrixXd>(free).householderQ() *
                            Eigen::MatrixXd::Identity(columns, free.cols());
  S += spring * G * G.transpose();
  const Eigen::LDLT<Eigen::MatrixXd> solver(S);
  const Eigen::VectorXd pivots = solver.vectorD();
  if (!(pivots.minCoeff() > 1e-13 * pivots.maxCoeff())) return {};
  Eigen::MatrixXd inverse = solver.solve(Eigen::MatrixXd::Identity(columns, columns));
  inverse -= G * (G.transpose() * inverse);
  // Residuals are smaller than errors by what the parameters took up.
  const double residuals = 2.0 * static_cast<double>(observations.size()),
               taken = 3.0 * static_cast<double>(points.size()) + columns - static_cast<double>(free.cols());
  if (!(residuals > taken)) return {};
  // The difference of the clusterings may leave a direction below zero by little.
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(M);
  const Eigen::MatrixXd root =
      inverse * eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0).cwiseSqrt().asDiagonal();
  return residuals / (residuals - taken) * root * root.transpose();
}

}  // namespace stuv
