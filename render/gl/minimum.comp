// Equation 6, second half, and equation 7 as planes go by, farthest first.
uniform int M;
uniform int n;
uniform float tie;

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  if (any(greaterThanEqual(pixel, size))) return;
  int index = pixel.y * size.x + pixel.x;
  if (n == 0) best[index] = vec4(uintBitsToFloat(0x7f800000u), 0.0, 0.0, -1.0);
  if (costs[index].z == 0.0) return;
  vec2 sum = vec2(0.0);
  for (int y = max(pixel.y - M, 0); y <= min(pixel.y + M, size.y - 1); ++y) sum += rows[y * size.x + pixel.x];
  vec4 b = best[index];
  bool defined = sum.y > 0.0;
  float e = defined ? sum.x / sum.y : uintBitsToFloat(0x7f800000u);
  if (defined) b.yz += vec2(e, 1.0);
  if (b.w < 0.0 || e < b.x - tie) {
    b.x = e;
    b.w = float(n);
  }
  best[index] = b;
}
