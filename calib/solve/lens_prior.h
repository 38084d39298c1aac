#pragma once

#include <Eigen/Dense>
#include <vector>

namespace stuv {

/// What is known of lenses beforehand: of every camera's, in units of the noise of a corner of weight 1,
/// cost |whiten (p - mean)|^2 with p the parameters of these numbers. Without parameters: nothing.
struct LensPrior {
  std::vector<int> parameter;
  Eigen::VectorXd mean;
  Eigen::MatrixXd whiten;
};

}  // namespace stuv
