#version 450 core
// As many texel fetches as can be: quads of four, as the sweep's bilinear samples, moving on from picture to picture.
layout(local_size_x = 32, local_size_y = 4) in;
layout(std430, binding = 0) writeonly buffer Output { uint result[]; };
layout(std430, binding = 1) readonly buffer Pictures { uint pictures[]; };

void main() {
  ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
  uint sum = 0u;
  for (int layer = 0; layer < 16; ++layer) {
    int at = (layer * 529 + pixel.y + layer) * 529 + pixel.x + layer;
    sum += pictures[at] + pictures[at + 1] + pictures[at + 529] + pictures[at + 530];
  }
  result[pixel.y * 512 + pixel.x] = sum;
}
