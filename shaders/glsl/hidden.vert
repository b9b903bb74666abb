#version 460
// What nobody sees of an eye's image, at the depth that stops every splat.
#ifdef MULTIVIEW
#extension GL_EXT_multiview : require
#endif
layout(location = 0) in vec3 corner; // on the image, −1 … 1, and of which eye
layout(push_constant) uniform Push { uint view; float depth; } push;

void main() {
#ifdef MULTIVIEW
    uint view = uint(gl_ViewIndex);
#else
    uint view = push.view;
#endif
    // Triangles of the other eye shrink to a point outside.
    vec2 place = uint(corner.z) == view ? corner.xy : vec2(2.0);
    gl_Position = vec4(place, push.depth, 1.0);
}
