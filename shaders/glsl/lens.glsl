// Lenses that are not perspective: how directions become places in the image, and back. Twin: renderer/src/lens.rs.
//
// A place is in radians. Fisheye: distance from the middle is the angle from the axis. Equirectangular: longitude, latitude
// (down). The image shows the places between view.tangents' left, right, up, down.
#ifndef LENS_GLSL
#define LENS_GLSL
#include "layout.glsl"

const float PI = 3.14159265;

vec2 lens_place(vec3 d) {
    if (LENS == LENS_EQUIRECTANGULAR) return vec2(atan(d.x, d.z), atan(d.y, length(d.xz)));
    float across = length(d.xy);
    return across > 0.0 ? d.xy * (atan(across, d.z) / across) : vec2(0.0);
}

// The ray of a place, a unit vector; false beyond the sphere, where the image shows nothing.
bool lens_ray(vec2 place, out vec3 d) {
    if (LENS == LENS_EQUIRECTANGULAR) {
        d = vec3(sin(place.x) * cos(place.y), sin(place.y), cos(place.x) * cos(place.y));
        return abs(place.y) <= 0.5 * PI;
    }
    float angle = length(place);
    d = vec3(angle > 0.0 ? place * (sin(angle) / angle) : place, cos(angle));
    return angle <= PI;
}

// How the direction moves with one unit of the place's x and y.
void lens_steps(vec3 m, out vec3 x, out vec3 y) {
    if (LENS == LENS_EQUIRECTANGULAR) {
        float level = length(m.xz);
        vec2 sc = level > 0.0 ? m.xz / level : vec2(0.0, 1.0);
        x = vec3(m.z, 0.0, -m.x);
        y = vec3(-sc.x * m.y, level, -sc.y * m.y);
        return;
    }
    float across = length(m.xy);
    vec2 p = across > 0.0 ? m.xy / across : vec2(1.0, 0.0);
    float angle = atan(across, m.z);
    float squeeze = angle > 0.0 ? across / angle : 1.0;
    vec3 radial = vec3(p * m.z, -across);
    vec3 around = squeeze * vec3(-p.y, p.x, 0.0);
    x = radial * p.x - around * p.y;
    y = radial * p.y + around * p.x;
}

// How much the image of a great circle through m bends at most: its curvature, measured on the sphere. Equirectangular:
// tan of the latitude; fisheye, for circles around the axis: θ / sin² θ - cot θ.
float lens_bent(vec3 m) {
    if (LENS == LENS_EQUIRECTANGULAR) return abs(m.y) / max(length(m.xz), 1e-6);
    float across = length(m.xy);
    float theta = atan(across, m.z);
    // By its series where both terms are large and nearly equal.
    return theta < 0.1 ? theta * (2.0 / 3.0) : (theta / across - m.z) / max(across, 1e-6);
}

// The most that an angle at m is stretched in the image.
float lens_stretch(vec3 m) {
    if (LENS == LENS_EQUIRECTANGULAR) return 1.0 / max(length(m.xz), 1e-3);
    float across = length(m.xy);
    float theta = atan(across, m.z);
    return theta > 0.0 ? theta / max(across, 1e-3) : 1.0;
}

// An angle in (-π, π].
float wrapped(float angle) { return angle - 2.0 * PI * round(angle / (2.0 * PI)); }

// The place of a direction, by whichever way round comes nearest to `beside` (equirectangular: columns repeat).
vec2 lens_place_beside(vec3 d, float beside) {
    vec2 place = lens_place(d);
    if (LENS == LENS_EQUIRECTANGULAR) place.x = beside + wrapped(place.x - beside);
    return place;
}

float lens_middle(vec4 tangents) { return 0.5 * (tangents.x + tangents.y); }

// A parallelogram of places.
struct LensBox {
    vec2 center;
    vec2 x; // from the centre to the middle of two sides
    vec2 y;
};

LensBox lens_whole(vec4 tangents) {
    return LensBox(0.5 * (tangents.xz + tangents.yw), vec2(0.5 * (tangents.y - tangents.x), 0.0),
                   vec2(0.0, 0.5 * (tangents.w - tangents.z)));
}

// Places of all directions within `radius` on the plane tangent at the unit vector m (a circle around m: atan(radius)).
//
// Equirectangular: such a cap is, at most, asin(sin ρ / cos latitude) wide to each side; around a pole all longitudes.
// Fisheye: seen from the axis it is asin(sin ρ / sin θ) wide to each side, from θ - ρ to θ + ρ; around the axis a disc.
LensBox lens_box(vec3 m, float radius, vec4 tangents) {
    const float SPARE = 1e-3;
    float rho = atan(radius) + SPARE;
    vec2 place = lens_place_beside(m, lens_middle(tangents));
    if (LENS == LENS_EQUIRECTANGULAR) {
        float low = max(place.y - rho, -0.5 * PI), high = min(place.y + rho, 0.5 * PI);
        LensBox whole = lens_whole(tangents);
        whole.center.y = 0.5 * (low + high);
        whole.y.y = 0.5 * (high - low);
        if (abs(place.y) + rho >= 0.5 * PI - SPARE) return whole;
        float side = asin(min(1.0, sin(rho) / cos(place.y))) + SPARE;
        return LensBox(vec2(place.x, whole.center.y), vec2(side, 0.0), whole.y);
    }
    float theta = length(place);
    float far = theta + rho;
    if (far >= PI - SPARE) return lens_whole(tangents);
    if (theta <= rho + SPARE) return LensBox(vec2(0.0), vec2(far, 0.0), vec2(0.0, far));
    float side = asin(min(1.0, sin(rho) / sin(theta)));
    float near = (theta - rho) * cos(side);
    vec2 p = place / theta;
    return LensBox(p * 0.5 * (near + far), p * 0.5 * (far - near), vec2(-p.y, p.x) * far * sin(side));
}

// Whether the image shows any of these directions.
bool lens_sees(vec3 m, float radius, vec4 tangents) {
    if (LENS == LENS_FISHEYE) {
        vec2 corner = max(abs(tangents.xz), abs(tangents.yw));
        if (length(lens_place(m)) - atan(radius) > length(corner) + 1e-3) return false;
    }
    LensBox box = lens_box(m, radius, tangents);
    vec2 extent = abs(box.x) + abs(box.y);
    return all(greaterThan(box.center + extent, tangents.xz)) && all(lessThan(box.center - extent, tangents.yw));
}

#endif
