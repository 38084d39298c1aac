#pragma once

#include <cmath>
#include <cstdint>
#include <initializer_list>
#include <numbers>

namespace stuv::synthetic {

// Random numbers as a function of what they are for (seed, set, camera, pixel, ...), so that results depend
// neither on the order of evaluation nor on the number of threads nor on the standard library.

/// The finaliser of splitmix64 (Steele, Lea, Flood, OOPSLA 2014): a bijection that mixes all bits.
inline std::uint64_t mix(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15ULL;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ULL;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBULL;
  return x ^ (x >> 31);
}

inline std::uint64_t hash(std::initializer_list<std::uint64_t> keys) {
  std::uint64_t h = 0;
  for (const std::uint64_t key : keys) h = mix(h ^ key);
  return h;
}

/// Uniform in (0, 1).
inline double uniform(std::uint64_t h) { return (static_cast<double>(h >> 11) + 0.5) * 0x1p-53; }

/// Standard normal (Box and Muller).
inline double gaussian(std::uint64_t h) {
  return std::sqrt(-2 * std::log(uniform(h))) * std::cos(2 * std::numbers::pi * uniform(mix(h)));
}

/// Nearly standard normal and cheap, for pixels: the sum of four uniform numbers, within +-3.46, mean 0,
/// variance 1, kurtosis 2.7 instead of 3.
inline float rough_gaussian(std::uint64_t h) {
  const auto sum = static_cast<int>((h & 0xFFFF) + ((h >> 16) & 0xFFFF) + ((h >> 32) & 0xFFFF) + (h >> 48));
  constexpr float scale = 1.7320508F / 65536.0F;  // variance of the sum: 4 * 65536^2 / 12
  return static_cast<float>(sum - 131070) * scale;
}

}  // namespace stuv::synthetic
