#version 460
// Puts the background behind the blended splats and converts to what the output stores.
#include "layout.glsl"
#include "output.glsl"
layout(input_attachment_index = 0, set = 3, binding = 0) uniform subpassInput accumulated;
layout(location = 0) out vec4 shown;
layout(push_constant) uniform Push { vec4 background; uint decode; } push;

void main() { shown = output_color(subpassLoad(accumulated), push.background, push.decode != 0u); }
