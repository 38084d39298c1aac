// Equation 5 on the planes of a batch, as difference.comp, where every camera is met at one offset: an invocation
// makes a column of pixels, whose taps overlap.
uniform int first_plane;
const int kColumn = 4;

// The blend along x of a row's two taps.
bool row_of(Camera camera, ivec2 i, float a, out vec3 colour) {
  int dx = a > 0.0 ? 1 : 0;
  if (i.y < 0 || i.y >= picture_size.y || i.x < 0 || i.x + dx >= picture_size.x) return false;
  int at = camera.first_texel + i.y * picture_size.x + i.x;
  Texel p0, p1;
  PAIR(camera.block, at, dx, p0, p1);
  colour = mix(rgb_of(p0), rgb_of(p1), a);
  return all_there(p0, p1);
}

void store(int z, ivec2 pixel, Sums sums) {
  if (pixel.y >= size.y) return;
  costs[(z * size.y + pixel.y) * size.x + pixel.x] = cost_of(sums);
}

// Adds the pixel between the rows `above` and `below`, and moves on.
#define PIXEL(sums, r)                                                           \
  below_there = row_of(camera, i + ivec2(0, r + 1), a.x, below);                 \
  add(sums, weight, above_there && (below_there || a.y == 0.0),                  \
      (a.y > 0.0 ? mix(above, below, a.y) : above) * kUnit);                     \
  above = below;                                                                 \
  above_there = below_there

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.x, gl_GlobalInvocationID.y * kColumn);
  if (any(greaterThanEqual(pixel, size))) return;
  int z = int(gl_GlobalInvocationID.z);
  Sums s0 = no_sums(), s1 = no_sums(), s2 = no_sums(), s3 = no_sums();
  for (int m = 0; m < member_count; ++m) {
    vec3 weight = vec3(members[m].weight[0], members[m].weight[1], members[m].weight[2]);
    if (weight.x + weight.y + weight.z <= 0.0) continue;
    Camera camera = cameras[(first_plane + z) * camera_count + members[m].camera];
    vec2 a = camera.fraction;
    ivec2 i = camera.whole + pixel;
    vec3 above = vec3(0.0), below = vec3(0.0);
    bool above_there = false, below_there = false;
    if (camera.visible == 0) i = ivec2(-kColumn - 1);
    above_there = row_of(camera, i, a.x, above);
    PIXEL(s0, 0);
    PIXEL(s1, 1);
    PIXEL(s2, 2);
    PIXEL(s3, 3);
  }
  store(z, pixel, s0);
  store(z, pixel + ivec2(0, 1), s1);
  store(z, pixel + ivec2(0, 2), s2);
  store(z, pixel + ivec2(0, 3), s3);
}
