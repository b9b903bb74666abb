// From a 3-D Gaussian to the ellipse that is drawn: three rungs of one ladder. Twin: renderer/src/projection.rs.
//
// Every rung ends in a plane of eye space and an ellipse in it:
//   affine   the plane z = 1, basis (x, y);
//   tangent  the plane that touches the unit sphere at m = mean / |mean|, basis (u, v) of Duff et al. 2017;
//   exact    as tangent, and five coefficients that turn the distance in the plane into the distance of the ray.
// The quad's corners are points of that plane; the rasteriser's perspective division carries them to the image
// (Huang et al. 2024, equation 23), and its clipping deals with what lies beside or behind the eye.
#ifndef PROJECTION_GLSL
#define PROJECTION_GLSL
#include "scene.glsl"

struct Ellipse {
    vec3 m;        // the plane's point at the ellipse's centre
    vec2 major;    // one standard deviation along the major axis, in the plane's basis
    float ratio;   // minor / major
    float opacity;
    vec2 linear;   // exact only: D² = (p² + q²) / (1 + linear·(p,q) + quadratic·(p²,pq,q²))
    vec3 quadratic;
    float area;    // of the drawn polygon, pixels, clipped to the image
    bool visible;
};

// Orthonormal basis of the plane perpendicular to the unit vector m (Duff et al. 2017).
void tangent_basis(vec3 m, out vec3 u, out vec3 v) {
    float s = m.z >= 0.0 ? 1.0 : -1.0;
    float a = -1.0 / (s + m.z);
    float b = m.x * m.y * a;
    u = vec3(1.0 + s * m.x * m.x * a, s * b, -s * m.x);
    v = vec3(b, s + m.y * m.y * a, -m.y);
}

mat3 rotation_matrix(vec4 q) {
    vec3 d = q.xyz + q.xyz;
    vec3 xx = q.xyz * d;
    float xy = q.x * d.y, xz = q.x * d.z, yz = q.y * d.z;
    vec3 w = q.w * d;
    return mat3(1.0 - xx.y - xx.z, xy + w.z, xz - w.y,
                xy - w.z, 1.0 - xx.x - xx.z, yz + w.x,
                xz + w.y, yz - w.x, 1.0 - xx.x - xx.y);
}

// Reach of the polygon in standard deviations: where the splat's own opacity falls below MIN_ALPHA.
float polygon_radius(float opacity) {
    if (RADIUS == RADIUS_SQRT8) return 2.8284271;
    float full = sqrt(max(0.0, 2.0 * log(opacity / MIN_ALPHA)));
    return RADIUS == RADIUS_FULL ? full : min(full, 2.8284271);
}

float shape_area() {
    return SHAPE == SHAPE_OCTAGON ? 3.3137085 : SHAPE == SHAPE_DIAMOND ? 2.0 : 4.0;
}

mat3 eye_rotation(ViewData view) {
    return transpose(mat3(view.rotation[0].xyz, view.rotation[1].xyz, view.rotation[2].xyz));
}

// The part of the plane that a splat reaches, an ellipse in units of its axes (p, q): centre and covariance.
// `bounded` is false where an exact splat reaches round the eye and its outline is no ellipse.
struct Reach {
    vec2 center;
    vec3 covariance; // pp, pq, qq
    bool bounded;
};

Reach reach_of(float k, vec2 linear, vec3 quadratic) {
    Reach r;
    float k2 = k * k;
    r.center = vec2(0.0);
    r.covariance = vec3(k2, 0.0, k2);
    r.bounded = true;
    if (PROJECTION == PROJECTION_EXACT) {
        // p² + q² <= k² (1 + linear·(p,q) + quadratic·(p²,pq,q²)) as (x - c)' N (x - c) <= k² + ½ k² linear·c.
        vec3 n = vec3(1.0 - k2 * quadratic.x, -0.5 * k2 * quadratic.y, 1.0 - k2 * quadratic.z);
        float det = n.x * n.z - n.y * n.y;
        // 1e-3: an outline more than ~30 times as far as the tangent ellipse is drawn as the whole image.
        r.bounded = n.x > 1e-3 && n.z > 1e-3 && det > 1e-3;
        vec3 inverse_n = vec3(n.z, -n.y, n.x) / det;
        vec2 half_linear = 0.5 * k2 * linear;
        r.center = vec2(inverse_n.x * half_linear.x + inverse_n.y * half_linear.y,
                        inverse_n.y * half_linear.x + inverse_n.z * half_linear.y);
        r.covariance = inverse_n * (k2 + dot(half_linear, r.center));
    }
    return r;
}

// Whether that part of the plane enters the frustum: the four side planes and the plane of the eye, each with
// the support function of the ellipse (P = m + p axis1 + q axis2).
bool in_frustum(vec3 m, vec3 axis1, vec3 axis2, Reach reach, vec4 tangents) {
    if (!reach.bounded) return true;
    vec3 center = m + reach.center.x * axis1 + reach.center.y * axis2;
    vec3 planes[5] = vec3[5](vec3(1.0, 0.0, -tangents.x), vec3(-1.0, 0.0, tangents.y), vec3(0.0, 1.0, -tangents.z),
                             vec3(0.0, -1.0, tangents.w), vec3(0.0, 0.0, 1.0));
    for (int i = 0; i < 5; i++) {
        vec2 n = vec2(dot(planes[i], axis1), dot(planes[i], axis2));
        float reach2 = reach.covariance.x * n.x * n.x + 2.0 * reach.covariance.y * n.x * n.y + reach.covariance.z * n.y * n.y;
        if (!(dot(planes[i], center) + sqrt(max(reach2, 0.0)) > 0.0)) return false;
    }
    return true;
}

Ellipse project_splat(Splat s, ViewData view) {
    Ellipse e;
    e.visible = false;
    e.opacity = s.opacity;
    e.linear = vec2(0.0);
    e.quadratic = vec3(0.0);
    e.area = 0.0;
    if (!(s.opacity >= max(frame.cull.z, MIN_ALPHA))) return e;

    mat3 eye = eye_rotation(view);
    vec3 mean = eye * (s.mean - view.eye.xyz);
    bool affine = PROJECTION == PROJECTION_AFFINE;
    float depth = affine ? mean.z : length(mean);
    if (!(depth > frame.cull.x)) return e;
    if (frame.cull.y > 0.0) e.opacity *= clamp((depth - frame.cull.x) / frame.cull.y, 0.0, 1.0);

    // The low-pass filter in three dimensions widens the scales by the pixel's size at the splat.
    vec2 pixel = 1.0 / view.image.xy;
    float filter_variance = frame.filters.x;
    if (LOW_PASS == LOW_PASS_VOLUMETRIC || LOW_PASS == LOW_PASS_VOLUMETRIC_COMPENSATED) {
        float w = depth * sqrt(filter_variance * pixel.x * pixel.y);
        vec3 widened = sqrt(s.scale * s.scale + w * w);
        if (LOW_PASS == LOW_PASS_VOLUMETRIC_COMPENSATED) {
            vec3 r = s.scale / widened;
            e.opacity *= sqrt(max(r.x * r.y * r.z, 5e-6));
        }
        s.scale = widened;
    }
    // Rows of M = W R S: the splat's axes in eye space, scaled.
    mat3 axes = eye * rotation_matrix(s.rotation);
    mat3 rows = transpose(mat3(axes[0] * s.scale.x, axes[1] * s.scale.y, axes[2] * s.scale.z));

    vec3 u, v, a1, a2, a3;
    vec2 kx, ky; // the filter's standard deviation along the image's x and y, in the plane's basis
    float sigma = sqrt(filter_variance);
    float scale_to_image; // of an area of the plane to one of the image at z = 1
    if (affine) {
        vec2 t = mean.xy / mean.z;
        vec2 clamped = clamp(t, 1.3 * view.tangents.xz, 1.3 * view.tangents.yw);
        e.m = vec3(t, 1.0);
        u = vec3(1.0, 0.0, 0.0);
        v = vec3(0.0, 1.0, 0.0);
        a1 = (rows[0] - clamped.x * rows[2]) / mean.z;
        a2 = (rows[1] - clamped.y * rows[2]) / mean.z;
        a3 = vec3(0.0);
        kx = vec2(sigma * pixel.x, 0.0);
        ky = vec2(0.0, sigma * pixel.y);
        scale_to_image = 1.0;
    } else {
        e.m = mean / depth;
        tangent_basis(e.m, u, v);
        a1 = (u.x * rows[0] + u.y * rows[1] + u.z * rows[2]) / depth;
        a2 = (v.x * rows[0] + v.y * rows[1] + v.z * rows[2]) / depth;
        a3 = (e.m.x * rows[0] + e.m.y * rows[1] + e.m.z * rows[2]) / depth;
        // An image displacement of one pixel moves the plane's point by m.z times the basis' components.
        float mz = max(e.m.z, 0.0);
        kx = sigma * pixel.x * mz * vec2(u.x, v.x);
        ky = sigma * pixel.y * mz * vec2(u.y, v.y);
        scale_to_image = 1.0 / max(mz * mz * mz, 1e-6);
    }

    // Covariance in the plane; its determinant as a sum of squares (Cauchy-Binet), without a difference.
    vec3 normal = cross(a1, a2);
    float det_sharp = dot(normal, normal);
    vec3 covariance = vec3(dot(a1, a1), dot(a1, a2), dot(a2, a2));
    float det = det_sharp;
    if (LOW_PASS == LOW_PASS_PLANAR || LOW_PASS == LOW_PASS_PLANAR_COMPENSATED) {
        covariance += vec3(kx.x * kx.x + ky.x * ky.x, kx.x * kx.y + ky.x * ky.y, kx.y * kx.y + ky.y * ky.y);
        vec3 mx = a1 * kx.y - a2 * kx.x;
        vec3 my = a1 * ky.y - a2 * ky.x;
        float mxy = kx.x * ky.y - kx.y * ky.x;
        det += dot(mx, mx) + dot(my, my) + mxy * mxy;
        if (LOW_PASS == LOW_PASS_PLANAR_COMPENSATED) e.opacity *= sqrt(max(det_sharp / det, 0.000025));
    }
    if (!(e.opacity >= MIN_ALPHA)) return e;

    // Axes by the half angle: never 0/0, not even for a round splat.
    float half_difference = 0.5 * (covariance.x - covariance.z);
    float r = length(vec2(half_difference, covariance.y));
    float lambda1 = 0.5 * (covariance.x + covariance.z) + r;
    if (!(lambda1 > 0.0)) return e;
    float c2 = r > 0.0 ? half_difference / r : 1.0;
    vec2 direction = vec2(sqrt(max(0.0, 0.5 + 0.5 * c2)), sqrt(max(0.0, 0.5 - 0.5 * c2)));
    direction.y = covariance.y < 0.0 ? -direction.y : direction.y;
    float sigma1 = sqrt(lambda1);
    float sigma2 = min(sqrt(det) / sigma1, sigma1);
    float k = polygon_radius(e.opacity);

    float focal = sqrt(view.image.x * view.image.y);
    float to_pixels = focal * sqrt(scale_to_image);
    float contribution = e.opacity * 6.2831853 * sigma1 * sigma2 * to_pixels * to_pixels;
    if (!(contribution >= frame.cull.w)) return e;
    // The radius is capped together with the covariance: a smaller splat, never a cut one.
    float cap = frame.filters.y / (max(k, 1e-3) * to_pixels);
    if (sigma1 > cap) {
        sigma1 = cap;
        sigma2 = min(sigma2, cap);
    }

    e.major = sigma1 * direction;
    e.ratio = sigma2 / sigma1;
    vec2 minor = e.ratio * vec2(-e.major.y, e.major.x);
    if (PROJECTION == PROJECTION_EXACT) {
        // D² = (p² + q²) / (|a c1 + b c2 + c3|² / |c3|²) with the cofactors c1 = a2×a3, c2 = a3×a1, c3 = a1×a2,
        // the plane's (a, b) written in the ellipse's own axes (p, q).
        vec3 c1 = cross(a2, a3), c2v = cross(a3, a1);
        vec3 p = (e.major.x * c1 + e.major.y * c2v) / det_sharp;
        vec3 q = (minor.x * c1 + minor.y * c2v) / det_sharp;
        e.linear = 2.0 * vec2(dot(p, normal), dot(q, normal));
        p *= sqrt(det_sharp);
        q *= sqrt(det_sharp);
        e.quadratic = vec3(dot(p, p), 2.0 * dot(p, q), dot(q, q));
    }
    Reach reach = reach_of(k, e.linear, e.quadratic);
    e.visible = in_frustum(e.m, e.major.x * u + e.major.y * v, minor.x * u + minor.y * v, reach, view.tangents);
    float image_area = view.image.z * view.image.w;
    e.area = reach.bounded ? min(shape_area() * k * k * sigma1 * sigma2 * to_pixels * to_pixels, image_area) : image_area;
    return e;
}

#endif
