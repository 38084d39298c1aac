// Equation 6, first half: sums along the row.
uniform int M;

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  if (any(greaterThanEqual(pixel, size))) return;
  vec2 sum = vec2(0.0);
  for (int x = max(pixel.x - M, 0); x <= min(pixel.x + M, size.x - 1); ++x) sum += costs[pixel.y * size.x + x].xy;
  rows[pixel.y * size.x + pixel.x] = sum;
}
