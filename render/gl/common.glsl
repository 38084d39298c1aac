#version 450 core
// What the shaders of the sweep share; see FocalPlaneRenderer (render/focal_plane.h) for the equations. Row 0 is the top
// row everywhere: buffers and texelFetch have no bottom-left origin.
layout(local_size_x = 8, local_size_y = 8) in;

// u = whole_u + fraction_u + slope * coordinate, split so that float keeps its digits for the fraction.
struct Camera {
  ivec2 whole;
  vec2 fraction;
  float slope;
  int visible;
  int layer;
  int pad;
};
struct Stand { int camera; float weight; };
struct Member { int camera; float weight[3]; };

layout(binding = 0) uniform sampler2DArray pictures;                      // alpha 0: missing
layout(std430, binding = 0) readonly buffer Cameras { Camera cameras[]; };  // [plane][camera]
layout(std430, binding = 1) readonly buffer Positions { vec2 positions[]; };
// Filters normal and wide share their nodes: the first lattice; the second is the thinned one.
layout(std430, binding = 2) readonly buffer Starts { int starts[]; };
layout(std430, binding = 3) readonly buffer Stands { Stand stands[]; };
layout(std430, binding = 4) buffer Costs { vec4 costs[]; };    // E_0, defined, candidate
layout(std430, binding = 5) buffer Rows { vec2 rows[]; };      // sums of E_0 and defined along the row
layout(std430, binding = 6) buffer Best { vec4 best[]; };      // E_min, sum of E, count of E, plane
layout(std430, binding = 7) writeonly buffer Output { vec4 result[]; };  // two a pixel

// Cameras with their weights by filter, where these are the same for all pixels.
layout(std430, binding = 8) readonly buffer Members { Member members[]; };

uniform ivec2 size;            // of the output
uniform int member_count;
uniform bool constant_position;
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

bool split(float at, int whole, int limit, out int i, out float a) {
  float nearest = round(at);
  if (abs(at - nearest) < snap_px) at = nearest;
  if (!(abs(at) < 1e6)) return false;
  float below = floor(at);
  i = whole + int(below);
  a = at - below;
  return i >= 0 && i + (a > 0.0 ? 1 : 0) < limit;
}

bool fetch(Camera camera, ivec2 pixel, vec2 coordinate, out vec3 colour) {
  if (camera.visible == 0) return false;
  ivec2 limit = textureSize(pictures, 0).xy;
  ivec2 i;
  vec2 a;
  vec2 at = camera.fraction + camera.slope * coordinate;
  ivec2 whole = camera.whole + (parallel_view ? pixel : ivec2(0));
  if (!split(at.x, whole.x, limit.x, i.x, a.x) || !split(at.y, whole.y, limit.y, i.y, a.y)) return false;
  int dx = a.x > 0.0 ? 1 : 0, dy = a.y > 0.0 ? 1 : 0;
  vec4 p00 = texelFetch(pictures, ivec3(i, camera.layer), 0);
  vec4 p01 = texelFetch(pictures, ivec3(i + ivec2(dx, 0), camera.layer), 0);
  vec4 p10 = texelFetch(pictures, ivec3(i + ivec2(0, dy), camera.layer), 0);
  vec4 p11 = texelFetch(pictures, ivec3(i + ivec2(dx, dy), camera.layer), 0);
  if (min(min(p00.a, p01.a), min(p10.a, p11.a)) < 0.5) return false;
  colour = mix(mix(p00.rgb, p01.rgb, a.x), mix(p10.rgb, p11.rgb, a.x), a.y);
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
