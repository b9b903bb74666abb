// What travels from a corner to the fragments.
#ifndef VARYINGS_GLSL
#define VARYINGS_GLSL
#ifdef FRAGMENT
#define VARYING in
#else
#define VARYING out
#endif
layout(location = 0) VARYING vec3 plane;       // p, q in standard deviations, and the homogeneous coordinate
layout(location = 1) flat VARYING vec4 color;  // colour, opacity
#ifdef EXACT
layout(location = 2) flat VARYING vec2 linear;
layout(location = 3) flat VARYING vec3 quadratic;
#endif
#ifdef STOCHASTIC
layout(location = 4) flat VARYING uint splat;  // its number in the scene
#endif
#endif
