// From a 3-D Gaussian to the ellipse that is drawn: three rungs of one ladder. Twin: renderer/src/projection.rs.
//
// Every rung ends in a plane of eye space and an ellipse in it:
//   affine   the plane z = 1, basis (x, y);
//   tangent  the plane that touches the unit sphere at m = mean / |mean|, basis (u, v) of Duff et al. 2017, and the ellipse
//            leans back from it: its points lie where the splat is strongest on each parallel to m;
//   exact    the tangent plane itself, and five coefficients that turn the distance in it into the distance of the ray.
// The quad's corners are points of that plane; the rasteriser's perspective division carries them to the image
// (Huang et al. 2024, equation 23), and its clipping deals with what lies beside or behind the eye.
#ifndef PROJECTION_GLSL
#define PROJECTION_GLSL
#include "scene.glsl"
#include "naive.glsl"
#include "lens.glsl"

struct Ellipse {
    vec3 m;        // the plane's point at the ellipse's centre
    vec2 major;    // one standard deviation along the major axis, in the plane's basis
    float ratio;   // minor / major
    float opacity;
    vec2 lean;     // tangent, exact: how far along m the splat's strongest points lie behind the plane, per p and q
    vec3 quadratic; // exact only: D² = (p² + q²) / (1 - 2 lean·(p,q) + quadratic·(p²,pq,q²)), p and q in the upright plane
    float area;    // of the shape, pixels, clipped to the image
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
    return RADIUS == RADIUS_OPACITY_AWARE ? min(full, 2.8284271) : full;
}

// Whether polygons have eight corners. Adaptive ones that are small have the square's four.
const bool OCTAGONS = SHAPE == SHAPE_OCTAGON || SHAPE == SHAPE_ADAPTIVE;

float shape_area() {
    return OCTAGONS ? 3.3137085 : SHAPE == SHAPE_DIAMOND ? 2.0 : 4.0;
}

bool squared(float octagon_area) { return SHAPE == SHAPE_ADAPTIVE && octagon_area < SMALL_POLYGON; }

// Pixels of the polygon that is drawn, from those of the shape.
float drawn_area(float shape_area) { return squared(shape_area) ? shape_area * (4.0 / 3.3137085) : shape_area; }

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

Reach reach_of(float k, vec2 lean, vec3 quadratic) {
    Reach r;
    float k2 = k * k;
    r.center = vec2(0.0);
    r.covariance = vec3(k2, 0.0, k2);
    r.bounded = true;
    if (PROJECTION == PROJECTION_EXACT) {
        // p² + q² <= k² (1 - 2 lean·(p,q) + quadratic·(p²,pq,q²)) as (x - c)' N (x - c) <= k² - k² lean·c.
        vec3 n = vec3(1.0 - k2 * quadratic.x, -0.5 * k2 * quadratic.y, 1.0 - k2 * quadratic.z);
        float det = n.x * n.z - n.y * n.y;
        // 1e-3: an outline more than ~30 times as far as the tangent ellipse is drawn as the whole image.
        r.bounded = n.x > 1e-3 && n.z > 1e-3 && det > 1e-3;
        vec3 inverse_n = vec3(n.z, -n.y, n.x) / det;
        vec2 half_linear = -k2 * lean;
        r.center = vec2(inverse_n.x * half_linear.x + inverse_n.y * half_linear.y,
                        inverse_n.y * half_linear.x + inverse_n.z * half_linear.y);
        r.covariance = inverse_n * (k2 + dot(half_linear, r.center));
    }
    return r;
}

// The plane that the ellipse lies in, and how to find a ray's point of it.
struct Plane {
    vec3 m;       // P = m + p axis_p + q axis_q
    vec3 axis_p;
    vec3 axis_q;
    vec3 along_p; // a ray d: (p, q, 1) is proportional to (d·along_p, d·along_q, d·ahead)
    vec3 along_q;
    vec3 ahead;
};

Plane plane_of(vec3 m, vec2 major, float ratio, vec2 lean) {
    Plane plane;
    plane.m = m;
    // Divided by the length step by step: its square underflows for the smallest splats.
    float size = length(major);
    float thin = max(size * ratio, 1e-30);
    vec2 direction = major / size;
    if (PROJECTION == PROJECTION_AFFINE) {
        vec3 p = vec3(direction, 0.0);
        vec3 q = vec3(-direction.y, direction.x, 0.0);
        plane.axis_p = size * p;
        plane.axis_q = size * ratio * q;
        plane.along_p = vec3(direction, -dot(direction, m.xy)) / size;
        plane.along_q = vec3(q.xy, -dot(q.xy, m.xy)) / thin;
        plane.ahead = vec3(0.0, 0.0, 1.0);
        return plane;
    }
    vec3 u, v;
    tangent_basis(m, u, v);
    vec3 p = direction.x * u + direction.y * v;
    vec3 q = direction.x * v - direction.y * u;
    plane.axis_p = size * p;
    plane.axis_q = size * ratio * q;
    plane.along_p = p / size;
    plane.along_q = q / thin;
    plane.ahead = m;
    if (PROJECTION == PROJECTION_TANGENT) {
        plane.axis_p += lean.x * m;
        plane.axis_q += lean.y * m;
        plane.ahead -= lean.x * plane.along_p + lean.y * plane.along_q;
    }
    return plane;
}

// Cholesky factor of the reach (l11, l21, l22): its half-axes are those of any factor of its covariance, and any factor turns a
// shape around the circle into one around the ellipse.
vec3 factor_of(Reach reach) {
    float l11 = sqrt(max(reach.covariance.x, 0.0));
    float l21 = reach.covariance.y / max(l11, 1e-30);
    return vec3(l11, l21, sqrt(max(reach.covariance.z - l21 * l21, 0.0)));
}

// How far that part of an upright plane is from the plane's point m at most (a bound: the sum of both half-axes' squares).
float plane_radius(Reach reach, vec2 major, vec2 minor) {
    vec2 center = reach.center.x * major + reach.center.y * minor;
    float square = reach.covariance.x * dot(major, major) + reach.covariance.z * dot(minor, minor);
    return length(center) + sqrt(max(square, 0.0));
}

// The same of what the eye sees of it: what leans towards the eye looks larger.
float seen_radius(float k, vec2 lean, Reach reach, vec2 major, vec2 minor) {
    float radius = plane_radius(reach, major, minor);
    return PROJECTION == PROJECTION_TANGENT ? radius / (1.0 - k * length(lean)) : radius;
}

// Whether that part of the plane enters the frustum: the four side planes and the plane of the eye, each with
// the support function of the ellipse.
bool in_frustum(Plane plane, Reach reach, vec4 tangents) {
    if (!reach.bounded) return true;
    vec3 center = plane.m + reach.center.x * plane.axis_p + reach.center.y * plane.axis_q;
    vec3 planes[5] = vec3[5](vec3(1.0, 0.0, -tangents.x), vec3(-1.0, 0.0, tangents.y), vec3(0.0, 1.0, -tangents.z),
                             vec3(0.0, -1.0, tangents.w), vec3(0.0, 0.0, 1.0));
    for (int i = 0; i < 5; i++) {
        vec2 n = vec2(dot(planes[i], plane.axis_p), dot(planes[i], plane.axis_q));
        float reach2 = reach.covariance.x * n.x * n.x + 2.0 * reach.covariance.y * n.x * n.y + reach.covariance.z * n.y * n.y;
        // center + √reach2 > 0, without the root.
        float inside = dot(planes[i], center);
        if (!(inside > 0.0 || reach2 > inside * inside)) return false;
    }
    return true;
}

// Whether a splat may enter the frustum at all: a ball around it, in the planes' own measure. What it leaves out in_frustum
// would leave out too, but after all of the projection. In every projection the part of the plane that is drawn lies within
// the splat's ellipsoid (affine: as it looks where the image is flat), widened by the filter; so the support function of none
// of them exceeds the ball's. Twin: renderer/src/frustum.rs.
bool ball_in_frustum(vec3 mean, vec3 scale, ViewData view) {
    const float SURE = 1.001; // beyond what rounding can add
    float k = RADIUS == RADIUS_FULL ? sqrt(-2.0 * log(MIN_ALPHA)) : 2.8284271;
    float depth = PROJECTION == PROJECTION_AFFINE ? mean.z : length(mean);
    vec2 pixel = depth / view.image.xy;
    float longest = max(max(scale.x, scale.y), scale.z);
    // Both low-pass filters at once: each is at most that.
    float ball = SURE * k * sqrt(longest * longest + 2.0 * frame.filters.x * dot(pixel, pixel));
    vec4 tangents = view.tangents;
    vec4 slopes = PROJECTION == PROJECTION_AFFINE ? 1.3 * tangents : tangents;
    vec4 beyond = vec4(tangents.x * mean.z - mean.x, mean.x - tangents.y * mean.z, tangents.z * mean.z - mean.y, mean.y - tangents.w * mean.z);
    return all(lessThanEqual(beyond, ball * sqrt(1.0 + slopes * slopes))) && mean.z > -ball;
}

// The 2 x 2 minors of two rows of the matrix [splat axes | filter along x | filter along y].
struct Minors {
    vec3 splat;
    vec3 along_x;
    vec3 along_y;
    float filters;
};

Minors minors(vec3 a, vec2 filter_a, vec3 b, vec2 filter_b) {
    return Minors(cross(a, b), a * filter_b.x - b * filter_a.x, a * filter_b.y - b * filter_a.y,
                  filter_a.x * filter_b.y - filter_a.y * filter_b.x);
}

float dot_minors(Minors a, Minors b) {
    return dot(a.splat, b.splat) + dot(a.along_x, b.along_x) + dot(a.along_y, b.along_y) + a.filters * b.filters;
}

Ellipse project_splat(Splat s, ViewData view) {
    Ellipse e;
    e.visible = false;
    e.opacity = s.opacity;
    e.lean = vec2(0.0);
    e.quadratic = vec3(0.0);
    e.area = 0.0;
    if (!(s.opacity >= max(frame.cull.z, MIN_ALPHA))) return e;

    mat3 eye = eye_rotation(view);
    // The eye in two parts: one f32 holds a place 100 km from the scene's origin to 8 mm only. Near the eye, where it
    // matters, the first difference is exact.
    vec3 eye_rest = vec3(view.rotation[0].w, view.rotation[1].w, view.rotation[2].w);
    vec3 mean = eye * ((s.mean - view.eye.xyz) - eye_rest);
    bool affine = PROJECTION == PROJECTION_AFFINE;
    bool perspective = LENS == LENS_PERSPECTIVE;
    float depth = affine ? mean.z : length(mean);
    if (!(depth > frame.cull.x)) return e;
    if (perspective && PRECISION != PRECISION_F16_NAIVE && RADIUS != RADIUS_TILES && !ball_in_frustum(mean, s.scale, view)) return e;
    if (frame.cull.y > 0.0) e.opacity *= clamp((depth - frame.cull.x) / frame.cull.y, 0.0, 1.0);

    // The low-pass filter in three dimensions widens the scales by the pixel's size at the splat.
    vec2 pixel = 1.0 / view.image.xy;
    float sigma = sqrt(frame.filters.x);
    vec3 sharp_scale = s.scale;
    // With a lens: how the direction moves over the image, and how much of the sphere a unit of image is.
    vec3 step_x = vec3(0.0), step_y = vec3(0.0);
    float of_sphere = 1.0;
    if (!perspective) {
        lens_steps(mean / depth, step_x, step_y);
        of_sphere = max(length(cross(step_x, step_y)), 1e-4);
    }
    if (LOW_PASS == LOW_PASS_VOLUMETRIC || LOW_PASS == LOW_PASS_VOLUMETRIC_COMPENSATED) {
        float w = (perspective ? max(mean.z, 0.0) : depth * sqrt(of_sphere)) * sigma * sqrt(pixel.x * pixel.y);
        s.scale = sqrt(s.scale * s.scale + w * w);
    }
    // Rows of M = W R S: the splat's axes in eye space, scaled.
    mat3 axes = eye * rotation_matrix(s.rotation);
    mat3 rows = transpose(mat3(axes[0] * s.scale.x, axes[1] * s.scale.y, axes[2] * s.scale.z));

    vec3 u, v, a1, a2, a3;
    vec3 kx, ky; // the planar filter's standard deviation along the image's x and y, in the basis (u, v, m)
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
        kx = vec3(sigma * pixel.x, 0.0, 0.0);
        ky = vec3(0.0, sigma * pixel.y, 0.0);
        scale_to_image = 1.0;
    } else {
        e.m = mean / depth;
        tangent_basis(e.m, u, v);
        a1 = (u.x * rows[0] + u.y * rows[1] + u.z * rows[2]) / depth;
        a2 = (v.x * rows[0] + v.y * rows[1] + v.z * rows[2]) / depth;
        a3 = (e.m.x * rows[0] + e.m.y * rows[1] + e.m.z * rows[2]) / depth;
        // An image displacement of one pixel moves the plane's point by m.z times the basis' components.
        float mz = max(e.m.z, 0.0);
        kx = sigma * pixel.x * mz * vec3(u.x, v.x, e.m.x);
        ky = sigma * pixel.y * mz * vec3(u.y, v.y, e.m.y);
        scale_to_image = 1.0 / max(mz * mz * mz, 1e-6);
        if (!perspective) {
            kx = sigma * pixel.x * vec3(dot(step_x, u), dot(step_x, v), 0.0);
            ky = sigma * pixel.y * vec3(dot(step_y, u), dot(step_y, v), 0.0);
            scale_to_image = 1.0 / of_sphere;
        }
    }

    if (LOW_PASS != LOW_PASS_PLANAR && LOW_PASS != LOW_PASS_PLANAR_COMPENSATED) {
        kx = vec3(0.0);
        ky = vec3(0.0);
    }
    // Everything in units of the largest entry: neither the determinant of a tiny splat underflows, nor a huge one's
    // overflows. Ratios of minors do not change.
    vec3 most = max(max(abs(a1), abs(a2)), vec3(max(abs(kx.x), abs(kx.y)), max(abs(ky.x), abs(ky.y)), 0.0));
    float unit = max(max(most.x, most.y), most.z);
    if (!(unit > 0.0)) return e;
    float inverse_unit = 1.0 / unit;
    a1 *= inverse_unit;
    a2 *= inverse_unit;
    a3 *= inverse_unit;
    kx *= inverse_unit;
    ky *= inverse_unit;
    // Covariance in the plane; its determinant as a sum of squared 2 x 2 minors (Cauchy-Binet), without a difference.
    vec3 covariance = vec3(dot(a1, a1), dot(a1, a2), dot(a2, a2));
    covariance += vec3(kx.x * kx.x + ky.x * ky.x, kx.x * kx.y + ky.x * ky.y, kx.y * kx.y + ky.y * ky.y);
    Minors c3 = minors(a1, vec2(kx.x, ky.x), a2, vec2(kx.y, ky.y));
    float det = dot_minors(c3, c3);
    if (LOW_PASS == LOW_PASS_PLANAR_COMPENSATED) {
        e.opacity *= clamp(sqrt(dot(c3.splat, c3.splat) / det), 0.005, 1.0);
    } else if (LOW_PASS == LOW_PASS_VOLUMETRIC_COMPENSATED) {
        vec3 ratio = sharp_scale / s.scale;
        vec3 sharp = cross(a1 * ratio, a2 * ratio);
        e.opacity *= clamp(sqrt(dot(sharp, sharp) / det), 0.005, 1.0);
    }
    if (!(e.opacity >= MIN_ALPHA)) return e;

    vec2 direction;
    float sigma1, sigma2;
    if (PRECISION == PRECISION_F16_NAIVE && affine) {
        vec4 axes = naive_axes(s, mean, eye, view);
        if (!(axes.z > 0.0)) return e;
        direction = axes.xy;
        sigma1 = axes.z;
        sigma2 = axes.w;
    } else {
        // Axes by the half angle: never 0/0, not even for a round splat.
        float half_difference = 0.5 * (covariance.x - covariance.z);
        float r = length(vec2(half_difference, covariance.y));
        float lambda1 = 0.5 * (covariance.x + covariance.z) + r;
        if (!(lambda1 > 0.0)) return e;
        float c2 = r > 0.0 ? half_difference / r : 1.0;
        direction = vec2(sqrt(max(0.0, 0.5 + 0.5 * c2)), sqrt(max(0.0, 0.5 - 0.5 * c2)));
        direction.y = covariance.y < 0.0 ? -direction.y : direction.y;
        sigma1 = sqrt(lambda1);
        sigma2 = unit * min(sqrt(det) / sigma1, sigma1);
        sigma1 *= unit;
    }
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
    if (!affine) {
        // With d = (a, b, 1) the ray in the basis (u, v, m) and c1 … c3 the vectors of the minors of the rows (2,3), (3,1),
        // (1,2), D² = (numerator of the tangent ellipse) / |a c1 + b c2 + c3|², here over |c3|² and with (a, b) written
        // in the ellipse's own axes (p, q).
        Minors c1 = minors(a2, vec2(kx.y, ky.y), a3, vec2(kx.z, ky.z));
        Minors c2 = minors(a3, vec2(kx.z, ky.z), a1, vec2(kx.x, ky.x));
        float scale = 1.0 / det;
        vec2 mixed = scale * vec2(dot_minors(c1, c3), dot_minors(c2, c3));
        vec2 j = e.major;
        e.lean = -vec2(dot(j, mixed), dot(minor, mixed));
        // Clear of the eye within any reach. (A length that overflows leaves no lean.)
        if (PROJECTION == PROJECTION_TANGENT) e.lean *= min(1.0, MAX_LEAN / max(length(e.lean), 1e-30));
        if (PROJECTION == PROJECTION_EXACT) {
            vec3 products = scale * vec3(dot_minors(c1, c1), dot_minors(c1, c2), dot_minors(c2, c2));
            e.quadratic = vec3(products.x * j.x * j.x + 2.0 * products.y * j.x * j.y + products.z * j.y * j.y,
                               2.0 * (products.x * j.x * minor.x + products.y * (j.x * minor.y + j.y * minor.x) + products.z * j.y * minor.y),
                               products.x * minor.x * minor.x + 2.0 * products.y * minor.x * minor.y + products.z * minor.y * minor.y);
        }
    }
    Reach reach = reach_of(k, e.lean, e.quadratic);
    if (perspective) {
        e.visible = in_frustum(plane_of(e.m, e.major, e.ratio, e.lean), reach, view.tangents);
    } else {
        e.visible = !reach.bounded || lens_sees(e.m, seen_radius(k, e.lean, reach, e.major, minor), view.tangents);
    }
    float image_area = view.image.z * view.image.w;
    e.area = frame.shown.w * (reach.bounded ? min(shape_area() * k * k * sigma1 * sigma2 * to_pixels * to_pixels, image_area) : image_area);
    return e;
}

#endif
