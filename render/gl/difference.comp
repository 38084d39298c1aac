// Equation 5 on the planes of a batch.
uniform int first_plane;

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  if (any(greaterThanEqual(pixel, size))) return;
  int z = int(gl_GlobalInvocationID.z);
  int index = (z * size.y + pixel.y) * size.x + pixel.x;
  costs[index] = vec2(0.0);
  vec2 coordinate;
  if (!coordinate_of(pixel, coordinate)) return;
  Sums sums = views_of(first_plane + z, pixel, coordinate, bvec3(true));
  costs[index] = cost_of(sums);
}
