// Equation 6, first half: sums along the row.
uniform int M;

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  if (any(greaterThanEqual(pixel, size))) return;
  int row = (int(gl_GlobalInvocationID.z) * size.y + pixel.y) * size.x;
  vec2 sum = vec2(0.0);
  for (int x = max(pixel.x - M, 0); x <= min(pixel.x + M, size.x - 1); ++x) {
    vec2 cost = costs[row + x];
    sum += vec2(cost.x, mod(cost.y, 2.0));
  }
  rows[row + pixel.x] = sum;
}
