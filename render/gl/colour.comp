// Equation 8: the view through filter k on the pixel's own plane.
uniform bool search;

// GlExactRenderer takes it apart.
uvec4 pixel_of(vec3 colour, int plane, float confidence) {
  return uvec4(floatBitsToUint(colour), uint(plane) << 15 | uint(round(clamp(confidence, 0.0, 1.0) * 32767.0)));
}

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  if (any(greaterThanEqual(pixel, size))) return;
  int index = pixel.y * size.x + pixel.x;
  vec4 b = best[index];
  result[index] = pixel_of(vec3(0.0), 0x1ffff, 0.0);
  vec2 coordinate;
  if (b.w < 0.0 || !coordinate_of(pixel, coordinate)) return;
  Sums sums = views_of(int(b.w), pixel, coordinate, equal(ivec3(0, 1, 2), ivec3(k)));
  float contrast = b.y > 0.0 ? clamp(1.0 - b.x * b.z / b.y, 0.0, 1.0) : 0.0;
  result[index] = pixel_of(colour_of(sums, k), int(b.w), coverage_of(sums, k) * (search ? contrast : 1.0));
}
