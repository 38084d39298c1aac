#version 450 core
// One output pixel an invocation; see FocalPlaneRenderer (render/focal_plane.h) for the equations.
// Row 0 is the top row everywhere: buffers and texelFetch have no bottom-left origin.
layout(local_size_x = 8, local_size_y = 8) in;

// u = whole_u + fraction_u + slope * coordinate, split so that float keeps its digits for the fraction.
struct Camera {
  ivec2 whole;
  vec2 fraction;
  float slope;
  int visible;
  int pad0, pad1;
};
struct Stand { int camera; float weight; };

layout(binding = 0) uniform sampler2DArray pictures;  // alpha 0: missing
layout(std430, binding = 0) readonly buffer Cameras { Camera cameras[]; };
layout(std430, binding = 1) readonly buffer Positions { vec2 positions[]; };
layout(std430, binding = 2) readonly buffer Starts { int starts[]; };  // per node, into stands
layout(std430, binding = 3) readonly buffer Stands { Stand stands[]; };
layout(std430, binding = 4) writeonly buffer Output { vec4 result[]; };

uniform ivec2 size;          // of the output
uniform bool constant_position;
uniform bool parallel_view;  // coordinate = pixel, u counted from the pixel; else coordinate = slope of the ray
uniform mat3 ray_from_pixel;
uniform ivec2 full_lattice;  // cols, rows
uniform ivec2 lattice;       // thinned
uniform float stride;
uniform float half_width;
uniform float snap_px;

bool split(float at, int whole, int limit, out int i, out float a) {
  float nearest = round(at);
  if (abs(at - nearest) < snap_px) at = nearest;
  if (!(abs(at) < 1e6)) return false;
  float below = floor(at);
  i = whole + int(below);
  a = at - below;
  return i >= 0 && i + (a > 0.0 ? 1 : 0) < limit;
}

bool fetch(Camera camera, int layer, ivec2 pixel, vec2 coordinate, out vec3 colour) {
  ivec2 limit = textureSize(pictures, 0).xy;
  ivec2 i;
  vec2 a;
  vec2 at = camera.fraction + camera.slope * coordinate;
  ivec2 whole = camera.whole + (parallel_view ? pixel : ivec2(0));
  if (!split(at.x, whole.x, limit.x, i.x, a.x) || !split(at.y, whole.y, limit.y, i.y, a.y)) return false;
  int dx = a.x > 0.0 ? 1 : 0, dy = a.y > 0.0 ? 1 : 0;
  vec4 p00 = texelFetch(pictures, ivec3(i, layer), 0);
  vec4 p01 = texelFetch(pictures, ivec3(i + ivec2(dx, 0), layer), 0);
  vec4 p10 = texelFetch(pictures, ivec3(i + ivec2(0, dy), layer), 0);
  vec4 p11 = texelFetch(pictures, ivec3(i + ivec2(dx, dy), layer), 0);
  if (min(min(p00.a, p01.a), min(p10.a, p11.a)) < 0.5) return false;
  colour = mix(mix(p00.rgb, p01.rgb, a.x), mix(p10.rgb, p11.rgb, a.x), a.y);
  return true;
}

float tent(int node, float at, int full) {
  return full == 1 ? 1.0 : max(0.0, 1.0 - abs(float(node) - at) / half_width);
}

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  if (any(greaterThanEqual(pixel, size))) return;
  int index = pixel.y * size.x + pixel.x;
  result[index] = vec4(0.0);
  vec2 coordinate = vec2(pixel);
  if (!parallel_view) {
    vec3 r = ray_from_pixel * vec3(vec2(pixel), 1.0);
    if (!(r.z > 0.0)) return;
    coordinate = r.xy / r.z;
  }
  vec2 p = clamp(positions[constant_position ? 0 : index], vec2(0.0), vec2(full_lattice - 1)) / stride;
  int reach = int(half_width);
  ivec2 first = ivec2(floor(p)) - reach + 1, last = min(first + 2 * reach - 1, lattice - 1);
  vec3 sum = vec3(0.0);
  float sampled = 0.0, total = 0.0;
  for (int row = max(first.y, 0); row <= last.y; ++row) {
    for (int col = max(first.x, 0); col <= last.x; ++col) {
      float weight = tent(row, p.y, full_lattice.y) * tent(col, p.x, full_lattice.x);
      if (weight <= 0.0) continue;
      int node = row * lattice.x + col;
      for (int k = starts[node]; k < starts[node + 1]; ++k) {
        float w = weight * stands[k].weight;
        total += w;
        vec3 colour;
        int c = stands[k].camera;
        if (cameras[c].visible == 0 || !fetch(cameras[c], c, pixel, coordinate, colour)) continue;
        sum += w * colour;
        sampled += w;
      }
    }
  }
  if (sampled > 0.0) result[index] = vec4(sum / sampled, min(sampled / total, 1.0));
}
