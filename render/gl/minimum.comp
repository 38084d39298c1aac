// Equation 6, second half, and equation 7 as planes go by, farthest first.
uniform int M;
uniform int first_plane;
uniform int batch;
uniform float tie;

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  if (any(greaterThanEqual(pixel, size))) return;
  int index = pixel.y * size.x + pixel.x, pixels = size.x * size.y;
  const float infinity = uintBitsToFloat(0x7f800000u);
  vec4 b = first_plane == 0 ? vec4(infinity, 0.0, 0.0, -1.0) : best[index];
  for (int z = 0; z < batch; ++z) {
    if (costs[z * pixels + index].y < 2.0) continue;
    vec2 sum = vec2(0.0);
    for (int y = max(pixel.y - M, 0); y <= min(pixel.y + M, size.y - 1); ++y)
      sum += rows[z * pixels + y * size.x + pixel.x];
    bool defined = sum.y > 0.0;
    float e = defined ? sum.x / sum.y : infinity;
    if (defined) b.yz += vec2(e, 1.0);
    if (b.w < 0.0 || e < b.x - tie) {
      b.x = e;
      b.w = float(first_plane + z);
    }
  }
  best[index] = b;
}
