#pragma once

namespace stuv {

/// Texels per second that a compute shader fetches from 8-bit colour pictures. Throws Error if
/// this machine has no OpenGL 4.5.
double measure_texel_fetches(double seconds);

}  // namespace stuv
