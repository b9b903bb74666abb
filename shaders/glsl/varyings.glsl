// What travels from a corner to the fragments.
#ifndef VARYINGS_GLSL
#define VARYINGS_GLSL
#ifdef FRAGMENT
#define VARYING in
#else
#define VARYING out
#endif
#ifdef THROUGH_LENS
// Each pixel finds its own point of the plane: its direction, and the ellipse's axes over their squared lengths.
layout(location = 0) flat VARYING vec3 middle;
layout(location = 5) flat VARYING vec3 along_p;
layout(location = 6) flat VARYING vec3 along_q;
#else
layout(location = 0) VARYING vec3 plane;       // p, q in standard deviations, and the homogeneous coordinate
#endif
layout(location = 1) flat VARYING vec4 color;  // colour, opacity
#ifdef EXACT
layout(location = 2) flat VARYING vec2 lean;
layout(location = 3) flat VARYING vec3 quadratic;
#endif
#ifdef STOCHASTIC
layout(location = 4) flat VARYING uint splat;  // its number in the scene
#endif
#endif
