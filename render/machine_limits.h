#pragma once

namespace stuv {

/// What this machine does at best, all threads together; 0: not measured.
struct MachineLimits {
  double multiply_adds_per_s = 0;  ///< of float, on numbers in registers, with the widest instructions in use
  double bytes_per_s = 0;          ///< read from memory, one stream a thread
  double texels_per_s = 0;         ///< fetched by a shader, neighbours side by side
};

/// Takes about half a second. texels_per_s only if `opengl`; throws Error if there is none then.
MachineLimits measure_machine_limits(bool opengl);

}  // namespace stuv
