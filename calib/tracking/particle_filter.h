#pragma once

#include <functional>
#include <vector>

#include "calib/tracking/se3.h"

namespace stuv::tracking {

struct Particle {
  Pose pose;                       ///< X_t
  Twist velocity = Twist::Zero();  ///< A_t of equation 4, a frame
  double log_weight = 0;
};

/// exp(log weights) normalised to sum 1, equation 12; safe however small they are. If none is finite, all are
/// equal.
std::vector<double> normalised_weights(const std::vector<Particle>& particles);

/// Equation 13: 1 / sum w^2 of normalised weights; 1 .. n.
double effective_number(const std::vector<double>& weights);

/// Systematic resampling to `count` particles: particle i is drawn count w_i times, rounded up or down by one
/// number `offset` in [0, 1). Weights become equal, velocities go with the poses.
std::vector<Particle> resample(const std::vector<Particle>& particles, const std::vector<double>& weights,
                               int count, double offset);

/// Equations 1 and 3, first-order Euler on the group: X_t = X_{t-1} exp(A_{t-1} + noise).
inline Pose propagate(const Particle& particle, const Twist& noise) {
  return particle.pose * exp(particle.velocity + noise);
}

/// Equation 4: A_t = a log(X_{t-1}^-1 X_t).
inline Twist velocity(double a, const Pose& before, const Pose& now) {
  return a * log(before.inverse() * now);
}

/// How many particles a distribution that fills `bins` cells needs for the Kullback-Leibler distance to its
/// sample to stay below 0.05 with probability 0.99 (Fox, IJRR 2003). 1 bin: 1.
double particles_for(int bins);

}  // namespace stuv::tracking
