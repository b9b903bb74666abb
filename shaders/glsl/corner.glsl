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
// corners of the image on the plane through m with the given normal, in the ellipse's axes. Where the plane does not
// reach all corners, as far as the frustum's side planes bound each axis by itself.
vec4 seen_rectangle(float k, vec3 m, vec3 normal, vec3 axis1, vec3 axis2, vec4 tangents) {
    vec4 r = vec4(-k, k, -k, k);
    vec4 seen = vec4(1e38, -1e38, 1e38, -1e38);
    bool whole = true;
    for (int i = 0; i < 4; i++) {
        vec3 d = vec3((i & 1) == 0 ? tangents.x : tangents.y, i < 2 ? tangents.z : tangents.w, 1.0);
        float along = dot(normal, d);
        whole = whole && along > 1e-3;
        vec3 offset = d / along - m;
        // Divided twice by the length: its square overflows for the largest, underflows for the smallest splats.
        float p = dot(offset, axis1 / length(axis1)) / length(axis1);
        float q = dot(offset, axis2 / length(axis2)) / length(axis2);
        seen = vec4(min(seen.x, p), max(seen.y, p), min(seen.z, q), max(seen.w, q));
    }
    if (whole) return vec4(max(r.x, seen.x), min(r.y, seen.y), max(r.z, seen.z), min(r.w, seen.w));
    vec3 planes[4] = vec3[4](vec3(1.0, 0.0, -tangents.x), vec3(-1.0, 0.0, tangents.y), vec3(0.0, 1.0, -tangents.z),
                             vec3(0.0, -1.0, tangents.w));
    for (int i = 0; i < 4; i++) {
        // n·m + p n·axis1 + q n·axis2 >= 0, with the other coordinate where it helps most.
        vec3 f = vec3(dot(planes[i], m), dot(planes[i], axis1), dot(planes[i], axis2));
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

// How far, in the plane's basis, a point of the plane moves with one unit of x in the image at depth 1.
vec2 along_x(vec3 p, vec2 ab, vec3 m, vec3 u, vec3 v) {
    return abs(p.z) * (vec2(u.x, v.x) - (PROJECTION == PROJECTION_AFFINE ? vec2(0.0) : ab * m.x));
}

// The largest offset of a sample at a point of the plane, in units of the ellipse's axes.
vec2 shift_in_axes(vec2 pq, vec3 m, vec3 u, vec3 v, vec2 major, vec2 minor) {
    vec2 ab = pq.x * major + pq.y * minor;
    vec2 e = frame.shown.z * along_x(m + ab.x * u + ab.y * v, ab, m, u, v);
    return vec2(dot(e, major) / dot(major, major), dot(e, minor) / max(dot(minor, minor), 1e-30));
}

// A corner of a shape in units of the axes of its ellipse, moved outward by `e`: with these the shape covers every pixel
// of which a sample up to ±e beside the centre lies in the shape.
vec2 grown(vec2 corner, vec2 unit, vec2 e) {
    e = abs(e);
    return SHAPE == SHAPE_DIAMOND ? corner + unit * (e.x + e.y) : corner + sign(unit) * e;
}

Corner splat_corner(uint corner, bool square, vec3 m, vec2 major, float ratio, float opacity, vec2 linear, vec3 quadratic,
                    ViewData view) {
    vec3 u = vec3(1.0, 0.0, 0.0), v = vec3(0.0, 1.0, 0.0);
    if (PROJECTION != PROJECTION_AFFINE) tangent_basis(m, u, v);
    vec2 minor = ratio * vec2(-major.y, major.x);
    float k = polygon_radius(opacity);
    Corner c;
    vec2 unit = shape_corner(corner, square);
    Reach reach = reach_of(k, linear, quadratic);
    if (PROJECTION == PROJECTION_EXACT && !reach.bounded) {
        // The whole image: the corner's ray d in the plane's coordinates is (u·d, v·d) / (m·d), kept homogeneous.
        vec2 ndc = vec2(OCTAGONS ? sign(unit) : SHAPE == SHAPE_DIAMOND ? vec2(unit.x + unit.y, unit.y - unit.x) : unit);
        vec4 t = view.tangents;
        vec3 d = vec3(mix(t.xz, t.yw, 0.5 * ndc + 0.5), 1.0);
        vec2 plane = vec2(dot(u, d), dot(v, d));
        float inverse_det = 1.0 / (major.x * minor.y - major.y * minor.x);
        c.plane = vec3((minor.y * plane.x - minor.x * plane.y) * inverse_det,
                       (major.x * plane.y - major.y * plane.x) * inverse_det, dot(m, d));
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
        // Cholesky factor of the reach: any factor turns the shape around the circle into one around the ellipse.
        float l11 = sqrt(reach.covariance.x);
        float l21 = reach.covariance.y / l11;
        float l22 = sqrt(max(0.0, reach.covariance.z - l21 * l21));
        pq = reach.center + vec2(l11 * unit.x, l21 * unit.x + l22 * unit.y);
        if (SAMPLING != SAMPLING_CENTERS) {
            vec2 e = shift_in_axes(pq, m, u, v, major, minor);
            e = vec2(e.x, (e.y - l21 * e.x / l11) / max(l22, 1e-30)) / vec2(l11, 1.0);
            unit = grown(unit, unit, e);
            pq = reach.center + vec2(l11 * unit.x, l21 * unit.x + l22 * unit.y);
        }
    } else if (k * length(major) > 16.0) {
        // A polygon far larger than the image: the rasteriser would interpolate between corners so far away that a pixel
        // falls between two floats. What the image sees of it is a rectangle along the axes.
        vec3 normal = PROJECTION == PROJECTION_AFFINE ? vec3(0.0, 0.0, 1.0) : m;
        vec4 seen = seen_rectangle(k, m, normal, major.x * u + major.y * v, minor.x * u + minor.y * v, view.tangents);
        vec2 side = OCTAGONS ? sign(unit) : SHAPE == SHAPE_DIAMOND ? vec2(unit.x + unit.y, unit.y - unit.x) : unit;
        pq = mix(seen.xz, seen.yw, 0.5 * side + 0.5);
    } else if (SHAPE == SHAPE_AXIS_ALIGNED) {
        vec2 ab = k * unit * sqrt(vec2(major.x * major.x + minor.x * minor.x, major.y * major.y + minor.y * minor.y));
        if (SAMPLING != SAMPLING_CENTERS) {
            ab += sign(unit) * abs(frame.shown.z * along_x(m + ab.x * u + ab.y * v, ab, m, u, v));
        }
        pq = vec2(dot(ab, major) / dot(major, major), dot(ab, minor) / max(dot(minor, minor), 1e-30));
    } else {
        pq = k * unit;
        if (SAMPLING != SAMPLING_CENTERS) pq = grown(pq, unit, shift_in_axes(pq, m, u, v, major, minor));
    }
    vec2 ab = pq.x * major + pq.y * minor;
    c.position = to_clip(m + ab.x * u + ab.y * v, view.tangents);
    c.plane = vec3(pq, 1.0);
    return c;
}

#ifdef THROUGH_LENS
// The same through a lens: the corner's place in clip space. The fragments find their points of the plane themselves, so
// the polygon has to cover the splat's image, and nothing else.
//
// The image of a polygon's straight side is bent. Where the splat is small against the bend, each half-axis is made longer
// by what a side of that length can bend; where it is not, a box around the whole cap is drawn.
vec4 lens_corner(uint corner, bool square, vec3 m, vec3 u, vec3 v, vec2 major, float ratio, float opacity, vec2 linear, vec3 quadratic, ViewData view) {
    vec2 minor = ratio * vec2(-major.y, major.x);
    Reach reach = reach_of(polygon_radius(opacity), linear, quadratic);
    vec2 unit = shape_corner(corner, square);
    vec2 side = OCTAGONS ? sign(unit) : SHAPE == SHAPE_DIAMOND ? vec2(unit.x + unit.y, unit.y - unit.x) : unit;
    vec4 shown = view.tangents;
    float radius = plane_radius(reach, major, minor);
    float middle = lens_place_beside(m, lens_middle(shown)).x;
    float bent = lens_bent(m);
    vec2 place;
    float size = radius * max(1.0, bent);
    if (!reach.bounded || !(size < 0.9)) {
        LensBox box = lens_whole(shown);
        if (reach.bounded) box = lens_box(m, radius, shown);
        place = box.center + side.x * box.x + side.y * box.y;
    } else {
        // Half-axes of the ellipse on the plane: those of any factor of its covariance.
        float l11 = sqrt(max(reach.covariance.x, 0.0));
        float l21 = reach.covariance.y / max(l11, 1e-30);
        vec2 a = l11 * major + l21 * minor;
        vec2 b = sqrt(max(reach.covariance.z - l21 * l21, 0.0)) * minor;
        float half_difference = 0.5 * (a.x * a.x + b.x * b.x - a.y * a.y - b.y * b.y);
        float mixed = a.x * a.y + b.x * b.y;
        float r = length(vec2(half_difference, mixed));
        float longer = 0.5 * (dot(a, a) + dot(b, b)) + r;
        float c2 = r > 0.0 ? half_difference / r : 1.0;
        vec2 direction = vec2(sqrt(max(0.0, 0.5 + 0.5 * c2)), sqrt(max(0.0, 0.5 - 0.5 * c2)));
        direction.y = mixed < 0.0 ? -direction.y : direction.y;
        float long_axis = sqrt(max(longer, 1e-30));
        float short_axis = abs(a.x * b.y - a.y * b.x) / long_axis;
        if (size > 0.15) {
            // Of some size: a box around points of the ellipse's outline, along its longer axis in the image. Between
            // two of 16 points the outline goes out by 1 - cos(π/16) of the box, and by what it bends there.
            vec3 center = m + (reach.center.x * major.x + reach.center.y * minor.x) * u
                        + (reach.center.x * major.y + reach.center.y * minor.y) * v;
            vec3 p = long_axis * (direction.x * u + direction.y * v);
            vec3 q = short_axis * (direction.x * v - direction.y * u);
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
            half_size = 1.03 * half_size + 0.04 * lens_stretch(m) * (bent + long_axis) * long_axis * long_axis;
            vec2 turned = 0.5 * (bounds.xy + bounds.zw) + side * half_size;
            place = vec2(axis.x * turned.x - axis.y * turned.y, axis.y * turned.x + axis.x * turned.y);
            return vec4(2.0 * (place - shown.xz) / (shown.yw - shown.xz) - 1.0, 0.5, 1.0);
        }
        float bend = long_axis * long_axis * (0.6 * bent + 0.5 * long_axis);
        vec2 ab = reach.center.x * major + reach.center.y * minor + unit.x * (long_axis + bend) * direction
                + unit.y * (short_axis + bend) * vec2(-direction.y, direction.x);
        place = lens_place_beside(m + ab.x * u + ab.y * v, middle);
    }
    return vec4(2.0 * (place - shown.xz) / (shown.yw - shown.xz) - 1.0, 0.5, 1.0);
}

#endif
#endif
