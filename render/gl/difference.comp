// Equation 5 on plane n.
uniform int n;

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  if (any(greaterThanEqual(pixel, size))) return;
  int index = pixel.y * size.x + pixel.x;
  costs[index] = vec4(0.0);
  vec2 coordinate;
  if (!coordinate_of(pixel, coordinate)) return;
  Sums sums = views_of(n, pixel, coordinate, bvec3(true));
  const ivec2 pairs[3] = ivec2[](ivec2(0, 1), ivec2(0, 2), ivec2(1, 2));
  float e = 0.0;
  bool defined = true;
  for (int q = 0; q < 3; ++q) {
    if (pair_weights[q] == 0.0) continue;
    defined = defined && coverage_of(sums, pairs[q].x) >= least_coverage && coverage_of(sums, pairs[q].y) >= least_coverage;
    e += pair_weights[q] * dot(abs(colour_of(sums, pairs[q].x) - colour_of(sums, pairs[q].y)), channel_sum);
  }
  costs[index] = vec4(defined ? e : 0.0, defined ? 1.0 : 0.0, sums.sampled[k] > 0.0 ? 1.0 : 0.0, 0.0);
}
