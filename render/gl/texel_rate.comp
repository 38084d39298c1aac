#version 450 core
// As many texel fetches as can be: quads of four, as the sweep's bilinear samples, moving on from layer to layer.
layout(local_size_x = 8, local_size_y = 8) in;
layout(binding = 0) uniform sampler2DArray pictures;
layout(std430, binding = 0) writeonly buffer Output { vec4 result[]; };

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  vec4 sum = vec4(0.0);
  for (int layer = 0; layer < 16; ++layer) {
    ivec3 at = ivec3(pixel + layer, layer);
    sum += texelFetch(pictures, at, 0) + texelFetch(pictures, at + ivec3(1, 0, 0), 0) +
           texelFetch(pictures, at + ivec3(0, 1, 0), 0) + texelFetch(pictures, at + ivec3(1, 1, 0), 0);
  }
  result[pixel.y * 512 + pixel.x] = sum;
}
