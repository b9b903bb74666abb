#version 460
// Early stop: keeps the fragment, and with it the near depth, where hardly any light comes through any more.
#include "layout.glsl"
layout(input_attachment_index = 0, set = 3, binding = 0) uniform subpassInput accumulated;
void main() {
    if (!(1.0 - subpassLoad(accumulated).a < frame.filters.z)) discard;
}
