// From an ellipse to the corners of the polygon that covers it.
#ifndef CORNER_GLSL
#define CORNER_GLSL
#include "projection.glsl"

uint corners_per_splat() { return OCTAGONS ? 8u : 4u; }

// Corner of the shape around the unit circle. Of an octagon's, each two come to one of a square.
vec2 shape_corner(uint corner, bool square) {
    if (OCTAGONS) {
        // Circumscribed: tan(π/8) beside 1.
        const float T = 0.41421356;
        const vec2 C[8] = vec2[8](vec2(1.0, T), vec2(T, 1.0), vec2(-T, 1.0), vec2(-1.0, T),
                                  vec2(-1.0, -T), vec2(-T, -1.0), vec2(T, -1.0), vec2(1.0, -T));
        return square ? sign(C[corner]) : C[corner];
    }
    if (SHAPE == SHAPE_DIAMOND) {
        const vec2 C[4] = vec2[4](vec2(1.0, 0.0), vec2(0.0, 1.0), vec2(-1.0, 0.0), vec2(0.0, -1.0));
        return C[corner];
    }
    const vec2 C[4] = vec2[4](vec2(1.0, 1.0), vec2(-1.0, 1.0), vec2(-1.0, -1.0), vec2(1.0, -1.0));
    return C[corner];
}

// A point of eye space in clip space. Depth is a constant half: splats only read the depth that early stop writes.
vec4 to_clip(vec3 p, vec4 t) {
    return vec4((2.0 * p.x - (t.y + t.x) * p.z) / (t.y - t.x), (2.0 * p.y - (t.w + t.z) * p.z) / (t.w - t.z),
                0.5 * p.z, p.z);
}

// The trainers' reach (Kerbl et al. 2023): every pixel of the 16 x 16 tiles that the square of ceil(3 sqrt(lambda1)) pixels
// around the mean touches; cut to the box of the ellipse beyond which nothing is left of the splat. Lower and upper
// end, in pixels from the image's corner. Their pixels have centres at whole numbers, and they cut towards zero.
vec4 tile_box(vec2 center, vec2 major, vec2 minor, float k, vec2 size) {
    vec2 box = vec2(dot(vec2(major.x, minor.x), vec2(major.x, minor.x)), dot(vec2(major.y, minor.y), vec2(major.y, minor.y)));
    float xy = major.x * major.y + minor.x * minor.y;
    float middle = 0.5 * (box.x + box.y);
    float radius = ceil(3.0 * sqrt(middle + sqrt(max(0.1, middle * middle - (box.x * box.y - xy * xy)))));
    vec2 tiles = ceil(size / 16.0);
    vec2 first = 16.0 * clamp(trunc((center - 0.5 - radius) / 16.0), vec2(0.0), tiles);
    vec2 last = 16.0 * clamp(trunc((center - 0.5 + radius + 15.0) / 16.0), vec2(0.0), tiles);
    vec2 reach = k * sqrt(box) + 1.0;
    return vec4(max(first, center - reach), min(last, center + reach));
}

// Part of the rectangle |p| <= k, |q| <= k that the frustum lets through, as (p low, p high, q low, q high): the four
// corners of the image on the plane, in the ellipse's axes. Where the plane does not reach all corners, as far as the
// frustum's side planes bound each axis by itself.
vec4 seen_rectangle(float k, Plane plane, vec4 tangents) {
    vec4 r = vec4(-k, k, -k, k);
    vec4 seen = vec4(1e38, -1e38, 1e38, -1e38);
    bool whole = true;
    for (int i = 0; i < 4; i++) {
        vec3 d = vec3((i & 1) == 0 ? tangents.x : tangents.y, i < 2 ? tangents.z : tangents.w, 1.0);
        float along = dot(plane.ahead, d);
        whole = whole && along > 1e-3;
        float p = dot(plane.along_p, d) / along;
        float q = dot(plane.along_q, d) / along;
        seen = vec4(min(seen.x, p), max(seen.y, p), min(seen.z, q), max(seen.w, q));
    }
    if (whole) return vec4(max(r.x, seen.x), min(r.y, seen.y), max(r.z, seen.z), min(r.w, seen.w));
    vec3 planes[4] = vec3[4](vec3(1.0, 0.0, -tangents.x), vec3(-1.0, 0.0, tangents.y), vec3(0.0, 1.0, -tangents.z),
                             vec3(0.0, -1.0, tangents.w));
    for (int i = 0; i < 4; i++) {
        // n·m + p n·axis1 + q n·axis2 >= 0, with the other coordinate where it helps most.
        vec3 f = vec3(dot(planes[i], plane.m), dot(planes[i], plane.axis_p), dot(planes[i], plane.axis_q));
        float p = -(f.x + max(r.z * f.z, r.w * f.z)) / f.y;
        if (f.y > 0.0) r.x = clamp(p, r.x, r.y);
        if (f.y < 0.0) r.y = clamp(p, r.x, r.y);
        float q = -(f.x + max(r.x * f.y, r.y * f.y)) / f.z;
        if (f.z > 0.0) r.z = clamp(q, r.z, r.w);
        if (f.z < 0.0) r.w = clamp(q, r.z, r.w);
    }
    return r;
}

const vec4 OUTSIDE = vec4(2.0, 2.0, 2.0, 1.0);

struct Corner {
    vec4 position;
    vec3 plane; // (p, q, 1) in standard deviations, homogeneous
};

// A point of the plane in eye space.
vec3 plane_point(Plane plane, vec2 pq) { return plane.m + pq.x * plane.axis_p + pq.y * plane.axis_q; }

// The largest offset of a sample at a point of the plane, in units of the ellipse's axes: how far the point moves with the
// ray's x at depth 1.
vec2 shift_in_axes(vec2 pq, Plane plane) {
    float depth = abs(plane_point(plane, pq).z);
    return frame.shown.z * depth * (vec2(plane.along_p.x, plane.along_q.x) - pq * plane.ahead.x);
}

// A corner of a shape in units of the axes of its ellipse, moved outward by `e`: with these the shape covers every pixel
// of which a sample up to ±e beside the centre lies in the shape.
vec2 grown(vec2 corner, vec2 unit, vec2 e) {
    e = abs(e);
    return SHAPE == SHAPE_DIAMOND ? corner + unit * (e.x + e.y) : corner + sign(unit) * e;
}

Corner splat_corner(uint corner, bool square, vec3 m, vec2 major, float ratio, float opacity, vec2 lean, vec3 quadratic,
                    ViewData view) {
    Plane plane = plane_of(m, major, ratio, lean);
    vec2 minor = ratio * vec2(-major.y, major.x);
    float k = polygon_radius(opacity);
    Corner c;
    vec2 unit = shape_corner(corner, square);
    Reach reach = reach_of(k, lean, quadratic);
    if (PROJECTION == PROJECTION_EXACT && !reach.bounded) {
        // The whole image: the corner's ray in the plane's coordinates, kept homogeneous.
        vec2 ndc = vec2(OCTAGONS ? sign(unit) : SHAPE == SHAPE_DIAMOND ? vec2(unit.x + unit.y, unit.y - unit.x) : unit);
        vec4 t = view.tangents;
        vec3 d = vec3(mix(t.xz, t.yw, 0.5 * ndc + 0.5), 1.0);
        c.plane = vec3(dot(plane.along_p, d), dot(plane.along_q, d), dot(plane.ahead, d));
        c.position = vec4(ndc, 0.5, 1.0);
        return c;
    }
    vec2 pq;
    if (PROJECTION == PROJECTION_AFFINE && RADIUS == RADIUS_TILES) {
        vec2 focal = view.image.xy;
        vec4 box = tile_box((m.xy - view.tangents.xz) * focal, major * focal, minor * focal, k, view.image.zw);
        vec2 side = SHAPE == SHAPE_DIAMOND ? vec2(unit.x + unit.y, unit.y - unit.x) : sign(unit);
        vec2 ab = mix(box.xy, max(box.xy, box.zw), 0.5 * side + 0.5) / focal + view.tangents.xz - m.xy;
        pq = vec2(dot(ab, major) / dot(major, major), dot(ab, minor) / max(dot(minor, minor), 1e-30));
    } else if (PROJECTION == PROJECTION_EXACT) {
        vec3 l = factor_of(reach);
        pq = reach.center + vec2(l.x * unit.x, l.y * unit.x + l.z * unit.y);
        if (SAMPLING != SAMPLING_CENTERS) {
            vec2 e = shift_in_axes(pq, plane);
            e = vec2(e.x, (e.y - l.y * e.x / l.x) / max(l.z, 1e-30)) / vec2(l.x, 1.0);
            unit = grown(unit, unit, e);
            pq = reach.center + vec2(l.x * unit.x, l.y * unit.x + l.z * unit.y);
        }
    } else if (k * length(major) > 16.0) {
        // A polygon far larger than the image: the rasteriser would interpolate between corners so far away that a pixel
        // falls between two floats. What the image sees of it is a rectangle along the axes.
        vec4 seen = seen_rectangle(k, plane, view.tangents);
        vec2 side = OCTAGONS ? sign(unit) : SHAPE == SHAPE_DIAMOND ? vec2(unit.x + unit.y, unit.y - unit.x) : unit;
        pq = mix(seen.xz, seen.yw, 0.5 * side + 0.5);
    } else if (SHAPE == SHAPE_AXIS_ALIGNED) {
        vec2 ab = k * unit * sqrt(vec2(major.x * major.x + minor.x * minor.x, major.y * major.y + minor.y * minor.y));
        pq = vec2(dot(ab, major) / dot(major, major), dot(ab, minor) / max(dot(minor, minor), 1e-30));
        if (SAMPLING != SAMPLING_CENTERS) {
            vec2 e = shift_in_axes(pq, plane);
            ab += sign(unit) * abs(e.x * major + e.y * minor);
            pq = vec2(dot(ab, major) / dot(major, major), dot(ab, minor) / max(dot(minor, minor), 1e-30));
        }
    } else {
        pq = k * unit;
        if (SAMPLING != SAMPLING_CENTERS) pq = grown(pq, unit, shift_in_axes(pq, plane));
    }
    c.position = to_clip(plane_point(plane, pq), view.tangents);
    c.plane = vec3(pq, 1.0);
    return c;
}

#ifdef THROUGH_LENS
// The same through a lens: the corner's place in clip space. The fragments find their points of the plane themselves, so
// the polygon has to cover the splat's image, and nothing else.
//
// The image of a polygon's straight side is bent. Where the splat is small against the bend, each half-axis is made longer
// by what a side of that length can bend; where it is not, a box around the whole cap is drawn.
vec4 lens_corner(uint corner, bool square, vec3 m, vec2 major, float ratio, float opacity, vec2 lean, vec3 quadratic, ViewData view) {
    vec3 u, v;
    tangent_basis(m, u, v);
    vec2 minor = ratio * vec2(-major.y, major.x);
    float k = polygon_radius(opacity);
    Reach reach = reach_of(k, lean, quadratic);
    vec2 unit = shape_corner(corner, square);
    vec2 side = OCTAGONS ? sign(unit) : SHAPE == SHAPE_DIAMOND ? vec2(unit.x + unit.y, unit.y - unit.x) : unit;
    vec4 shown = view.tangents;
    float radius = seen_radius(k, lean, reach, major, minor);
    float middle = lens_place_beside(m, lens_middle(shown)).x;
    float bent = lens_bent(m);
    vec2 place;
    float size = radius * max(1.0, bent);
    // Whose outline's points would lie far from even on what it looks like.
    bool leans = PROJECTION == PROJECTION_TANGENT && k * length(lean) > 0.5;
    if (!reach.bounded || leans || !(size < 0.9)) {
        LensBox box = lens_whole(shown);
        if (reach.bounded) box = lens_box(m, radius, shown);
        place = box.center + side.x * box.x + side.y * box.y;
    } else {
        float long_axis = k * length(major);
        float short_axis = long_axis * ratio;
        vec2 direction = major / length(major);
        if (PROJECTION == PROJECTION_EXACT) {
            vec3 l = factor_of(reach);
            vec2 a = l.x * major + l.y * minor;
            vec2 b = l.z * minor;
            float half_difference = 0.5 * (a.x * a.x + b.x * b.x - a.y * a.y - b.y * b.y);
            float mixed = a.x * a.y + b.x * b.y;
            float r = length(vec2(half_difference, mixed));
            float longer = 0.5 * (dot(a, a) + dot(b, b)) + r;
            float c2 = r > 0.0 ? half_difference / r : 1.0;
            direction = vec2(sqrt(max(0.0, 0.5 + 0.5 * c2)), sqrt(max(0.0, 0.5 - 0.5 * c2)));
            direction.y = mixed < 0.0 ? -direction.y : direction.y;
            long_axis = sqrt(max(longer, 1e-30));
            short_axis = abs(a.x * b.y - a.y * b.x) / long_axis;
        }
        vec3 along = direction.x * u + direction.y * v;
        vec3 across = direction.x * v - direction.y * u;
        vec3 center = m + (reach.center.x * major.x + reach.center.y * minor.x) * u
                    + (reach.center.x * major.y + reach.center.y * minor.y) * v;
        vec3 p = long_axis * along;
        vec3 q = short_axis * across;
        if (PROJECTION == PROJECTION_TANGENT) {
            p += k * lean.x * m;
            q += k * lean.y * m;
        }
        if (size > 0.15) {
            // Of some size: a box around points of the ellipse's outline, along its longer axis in the image. Between
            // two of 16 points the outline goes out by 1 - cos(π/16) of the box, and by what it bends there.
            vec2 axis = lens_place_beside(center + 0.01 * p, middle) - lens_place_beside(center - 0.01 * p, middle);
            axis = length(axis) > 0.0 ? normalize(axis) : vec2(1.0, 0.0);
            vec4 bounds = vec4(1e9, 1e9, -1e9, -1e9);
            for (int i = 0; i < 16; i++) {
                float t = float(i) * (PI / 8.0);
                vec2 at = lens_place_beside(center + cos(t) * p + sin(t) * q, middle);
                vec2 turned = vec2(dot(at, axis), axis.x * at.y - axis.y * at.x);
                bounds = vec4(min(bounds.xy, turned), max(bounds.zw, turned));
            }
            vec2 half_size = 0.5 * (bounds.zw - bounds.xy);
            // Points of what leans are farther apart where it is near.
            float seen = PROJECTION == PROJECTION_TANGENT ? 1.0 / (1.0 - k * length(lean)) : 1.0;
            half_size = (1.0 + 0.03 * seen * seen) * half_size
                      + 0.04 * lens_stretch(m) * (bent + seen * long_axis) * seen * seen * long_axis * long_axis;
            vec2 turned = 0.5 * (bounds.xy + bounds.zw) + side * half_size;
            place = vec2(axis.x * turned.x - axis.y * turned.y, axis.y * turned.x + axis.x * turned.y);
            return vec4(2.0 * (place - shown.xz) / (shown.yw - shown.xz) - 1.0, 0.5, 1.0);
        }
        float seen = PROJECTION == PROJECTION_TANGENT ? long_axis / (1.0 - k * length(lean)) : long_axis;
        float bend = seen * seen * (0.6 * bent + 0.5 * seen);
        if (PROJECTION == PROJECTION_TANGENT) bend *= 1.0 + k * length(lean);
        place = lens_place_beside(center + unit.x * (p + bend * along) + unit.y * (q + bend * across), middle);
    }
    return vec4(2.0 * (place - shown.xz) / (shown.yw - shown.xz) - 1.0, 0.5, 1.0);
}

#endif
#endif
