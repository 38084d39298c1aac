// Equation 8: the view through filter k on the pixel's own plane.
void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  if (any(greaterThanEqual(pixel, size))) return;
  int index = pixel.y * size.x + pixel.x;
  vec4 b = best[index];
  result[2 * index] = vec4(0.0);
  result[2 * index + 1] = vec4(-1.0, 0.0, 0.0, 0.0);
  vec2 coordinate;
  if (b.w < 0.0 || !coordinate_of(pixel, coordinate)) return;
  Sums sums = views_of(int(b.w), pixel, coordinate, equal(ivec3(0, 1, 2), ivec3(k)));
  float contrast = b.y > 0.0 ? clamp(1.0 - b.x * b.z / b.y, 0.0, 1.0) : 0.0;
  result[2 * index] = vec4(colour_of(sums, k), coverage_of(sums, k));
  result[2 * index + 1] = vec4(b.w, contrast, 0.0, 0.0);
}
