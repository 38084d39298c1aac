// What the shaders of the sweep share; see FocalPlaneRenderer (render/focal_plane.h) for the equations. Row 0 is the top
// row everywhere. Before this stand the version, and TEXEL_ and BLOCKS of the pictures (GlPictures).
layout(local_size_x = 32, local_size_y = 4) in;  // a row of 32 reads neighbouring texels

// u = whole_u + fraction_u + slope * coordinate, split so that float keeps its digits for the fraction.
struct Camera {
  ivec2 whole;
  vec2 fraction;
  float slope;
  int visible;
  int block;        // of the pictures
  int first_texel;  // in that block
};
struct Stand { int camera; float weight; };
struct Member { int camera; float weight[3]; };

#if defined(TEXEL_U8)
#define Texel uint
#elif defined(TEXEL_U16)
#define Texel uvec2
#else
#define Texel vec4
#endif

layout(std430, binding = 0) readonly buffer Cameras { Camera cameras[]; };  // [plane][camera]
layout(std430, binding = 1) readonly buffer Positions { vec2 positions[]; };
// Filters normal and wide share their nodes: the first lattice; the second is the thinned one.
layout(std430, binding = 2) readonly buffer Starts { int starts[]; };
layout(std430, binding = 3) readonly buffer Stands { Stand stands[]; };
// Of a batch of planes, [plane][pixel]: E_0; 1 if it is defined, and 2 more if the plane is a candidate.
layout(std430, binding = 4) buffer Costs { vec2 costs[]; };
layout(std430, binding = 5) buffer Rows { vec2 rows[]; };  // sums of E_0 and of defined along the row, [plane][pixel]
layout(std430, binding = 6) buffer Best { vec4 best[]; };  // E_min, sum of E, count of E, plane
// The bits of red, green and blue; 17 bits of the plane, 15 of confidence.
layout(std430, binding = 7) writeonly buffer Output { uvec4 result[]; };
// Cameras with their weights by filter, where these are the same for all pixels.
layout(std430, binding = 8) readonly buffer Members { Member members[]; };
layout(std430, binding = 9) readonly buffer Pictures0 { Texel pictures0[]; };
layout(std430, binding = 10) readonly buffer Pictures1 { Texel pictures1[]; };
layout(std430, binding = 11) readonly buffer Pictures2 { Texel pictures2[]; };
layout(std430, binding = 12) readonly buffer Pictures3 { Texel pictures3[]; };

uniform ivec2 size;            // of the output
uniform ivec2 picture_size;    // of the cameras
uniform int member_count;
uniform bool constant_position;
uniform bool shifted;          // every camera is met at one whole + fraction, already split, for all pixels
uniform bool parallel_view;    // coordinate = pixel, u counted from the pixel; else coordinate = slope of the ray
uniform mat3 ray_from_pixel;
uniform ivec2 full_lattice;    // cols, rows
uniform ivec2 thinned_lattice;
uniform int second_lattice;    // where the starts of the thinned lattice begin
uniform int camera_count;
uniform float snap_px;
uniform float least_coverage;
uniform vec3 pair_weights;     // a_01, a_02, a_12
uniform int k;                 // filter of the picture
uniform vec3 channel_sum;      // 1 for each channel there is, else 0

#if defined(TEXEL_U8)
// Scaled by kUnit once blended. Integers below 2^23 lie in the last bits of 2^23 + integer: two quick operations, where
// a conversion is a slow one.
vec3 rgb_of(uint p) {
  uvec3 bytes = uvec3(p, p >> 8, p >> 16) & 0xffu;
  return uintBitsToFloat(bytes | 0x4b000000u) - 8388608.0;
}
const float kUnit = 1.0 / 255.0;
bool all_there(uint a, uint b) { return (a & b) >= 0xff000000u; }
#elif defined(TEXEL_U16)
vec3 rgb_of(uvec2 p) { return vec3(p.x & 0xffffu, p.x >> 16, p.y & 0xffffu) / 65535.0; }
const float kUnit = 1.0;
bool all_there(uvec2 a, uvec2 b) { return (a.y & b.y) >= 0xffff0000u; }
#else
vec3 rgb_of(vec4 p) { return p.rgb; }
const float kUnit = 1.0;
bool all_there(vec4 a, vec4 b) { return min(a.a, b.a) >= 0.5; }
#endif

bool split(float at, int whole, int limit, out int i, out float a) {
  float nearest = round(at);
  if (abs(at - nearest) < snap_px) at = nearest;
  if (!(abs(at) < 1e6)) return false;
  float below = floor(at);
  i = whole + int(below);
  a = at - below;
  return i >= 0 && i + (a > 0.0 ? 1 : 0) < limit;
}

// Two neighbouring texels of one picture.
#if BLOCKS == 1
#define PAIR(block, at, dx, p0, p1) p0 = pictures0[at], p1 = pictures0[(at) + (dx)]
#else
#define PAIR(block, at, dx, p0, p1)                                         \
  if (block == 0) {                                                         \
    p0 = pictures0[at], p1 = pictures0[(at) + (dx)];                        \
  } else if (block == 1) {                                                  \
    p0 = pictures1[at], p1 = pictures1[(at) + (dx)];                        \
  } else if (block == 2) {                                                  \
    p0 = pictures2[at], p1 = pictures2[(at) + (dx)];                        \
  } else {                                                                  \
    p0 = pictures3[at], p1 = pictures3[(at) + (dx)];                        \
  }
#endif

bool fetch(Camera camera, ivec2 pixel, vec2 coordinate, out vec3 colour) {
  if (camera.visible == 0) return false;
  ivec2 i = camera.whole + (parallel_view ? pixel : ivec2(0));
  vec2 a = camera.fraction;
  if (shifted) {
    if (any(lessThan(i, ivec2(0))) || any(greaterThanEqual(i + ivec2(greaterThan(a, vec2(0.0))), picture_size)))
      return false;
  } else {
    a += camera.slope * coordinate;
    if (!split(a.x, i.x, picture_size.x, i.x, a.x) || !split(a.y, i.y, picture_size.y, i.y, a.y)) return false;
  }
  int dx = a.x > 0.0 ? 1 : 0, dy = a.y > 0.0 ? picture_size.x : 0;
  int at = camera.first_texel + i.y * picture_size.x + i.x;
  Texel p00, p01, p10, p11;
  PAIR(camera.block, at, dx, p00, p01);
  PAIR(camera.block, at + dy, dx, p10, p11);
  if (!all_there(p00, p01) || !all_there(p10, p11)) return false;
  colour = mix(mix(rgb_of(p00), rgb_of(p01), a.x), mix(rgb_of(p10), rgb_of(p11), a.x), a.y) * kUnit;
  return true;
}

float tent(int node, float at, int full, float half_width) {
  return full == 1 ? 1.0 : max(0.0, 1.0 - abs(float(node) - at) / half_width);
}

// False: the ray does not look towards the scene.
bool coordinate_of(ivec2 pixel, out vec2 coordinate) {
  coordinate = vec2(pixel);
  if (parallel_view) return true;
  vec3 r = ray_from_pixel * vec3(vec2(pixel), 1.0);
  coordinate = r.xy / r.z;
  return r.z > 0.0;
}

// By filter: columns of `colour`, components of the others. Written out, since drivers keep arrays in memory.
struct Sums {
  mat3 colour;
  vec3 sampled, total;
};

Sums no_sums() { return Sums(mat3(0.0), vec3(0.0), vec3(0.0)); }

void add(inout Sums sums, vec3 weight, bool seen, vec3 colour) {
  sums.total += weight;
  if (!seen) return;
  sums.colour[0] += weight.x * colour;
  sums.colour[1] += weight.y * colour;
  sums.colour[2] += weight.z * colour;
  sums.sampled += weight;
}

Sums views_of_members(int n, ivec2 pixel, vec2 coordinate, bvec3 wanted) {
  Sums sums = no_sums();
  for (int m = 0; m < member_count; ++m) {
    vec3 weight = vec3(members[m].weight[0], members[m].weight[1], members[m].weight[2]) * vec3(wanted);
    if (weight.x + weight.y + weight.z <= 0.0) continue;
    vec3 colour = vec3(0.0);
    bool seen = fetch(cameras[n * camera_count + members[m].camera], pixel, coordinate, colour);
    add(sums, weight, seen, colour);
  }
  return sums;
}

// The views through all three filters on plane n; every camera is sampled once, but for those that stand in
// for holes of the thinned lattice.
Sums views_of(int n, ivec2 pixel, vec2 coordinate, bvec3 wanted) {
  if (constant_position) return views_of_members(n, pixel, coordinate, wanted);
  Sums sums = no_sums();
  vec2 p = clamp(positions[pixel.y * size.x + pixel.x], vec2(0.0), vec2(full_lattice - 1));
  int reach = wanted.y || wanted.z ? 2 : 1;
  ivec2 first = ivec2(floor(p)) - reach + 1, last = min(first + 2 * reach - 1, full_lattice - 1);
  for (int row = max(first.y, 0); row <= last.y; ++row) {
    for (int col = max(first.x, 0); col <= last.x; ++col) {
      int node = row * full_lattice.x + col;
      vec3 weight = vec3(tent(row, p.y, full_lattice.y, 1.0) * tent(col, p.x, full_lattice.x, 1.0),
                         tent(row, p.y, full_lattice.y, 2.0) * tent(col, p.x, full_lattice.x, 2.0), 0.0);
      // A camera of the thinned lattice that stands for itself is sampled here already.
      int thin = second_lattice + row / 2 * thinned_lattice.x + col / 2;
      bool own = (row & 1) == 0 && (col & 1) == 0 && starts[node + 1] - starts[node] == 1 &&
                 starts[thin + 1] - starts[thin] == 1 && stands[starts[thin]].camera == stands[starts[node]].camera;
      if (own) weight.z = tent(row / 2, p.y / 2.0, full_lattice.y, 1.0) * tent(col / 2, p.x / 2.0, full_lattice.x, 1.0);
      weight *= vec3(wanted);
      if (weight.x + weight.y + weight.z <= 0.0) continue;
      for (int s = starts[node]; s < starts[node + 1]; ++s) {
        vec3 colour = vec3(0.0);
        bool seen = fetch(cameras[n * camera_count + stands[s].camera], pixel, coordinate, colour);
        add(sums, weight * stands[s].weight, seen, colour);
      }
    }
  }
  if (!wanted.z) return sums;
  ivec2 corner = ivec2(floor(p / 2.0));
  for (int row = corner.y; row <= min(corner.y + 1, thinned_lattice.y - 1); ++row) {
    for (int col = corner.x; col <= min(corner.x + 1, thinned_lattice.x - 1); ++col) {
      int thin = second_lattice + row * thinned_lattice.x + col, node = 2 * row * full_lattice.x + 2 * col;
      bool own = starts[node + 1] - starts[node] == 1 && starts[thin + 1] - starts[thin] == 1 &&
                 stands[starts[thin]].camera == stands[starts[node]].camera;
      float weight = tent(row, p.y / 2.0, full_lattice.y, 1.0) * tent(col, p.x / 2.0, full_lattice.x, 1.0);
      if (own || weight <= 0.0) continue;
      for (int s = starts[thin]; s < starts[thin + 1]; ++s) {
        vec3 colour = vec3(0.0);
        bool seen = fetch(cameras[n * camera_count + stands[s].camera], pixel, coordinate, colour);
        add(sums, vec3(0.0, 0.0, weight * stands[s].weight), seen, colour);
      }
    }
  }
  return sums;
}

float coverage_of(Sums sums, int f) { return sums.sampled[f] > 0.0 ? min(sums.sampled[f] / sums.total[f], 1.0) : 0.0; }

vec3 colour_of(Sums sums, int f) { return sums.sampled[f] > 0.0 ? sums.colour[f] / sums.sampled[f] : vec3(0.0); }

// Equation 5 of one pixel, as `costs` has it.
vec2 cost_of(Sums sums) {
  const ivec2 pairs[3] = ivec2[](ivec2(0, 1), ivec2(0, 2), ivec2(1, 2));
  float e = 0.0;
  bool defined = true;
  for (int q = 0; q < 3; ++q) {
    if (pair_weights[q] == 0.0) continue;
    defined = defined && coverage_of(sums, pairs[q].x) >= least_coverage && coverage_of(sums, pairs[q].y) >= least_coverage;
    e += pair_weights[q] * dot(abs(colour_of(sums, pairs[q].x) - colour_of(sums, pairs[q].y)), channel_sum);
  }
  return vec2(defined ? e : 0.0, (defined ? 1.0 : 0.0) + (sums.sampled[k] > 0.0 ? 2.0 : 0.0));
}
