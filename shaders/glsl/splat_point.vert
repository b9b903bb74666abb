#version 460
// Geometry expansion: the vertex stage only passes the splat's place in the order on.
layout(location = 0) flat out uint slot;
layout(push_constant) uniform Push { uint batch; uint view; uint first; uint last; } push;
void main() { slot = push.first + uint(gl_VertexIndex); gl_Position = vec4(0.0); }
