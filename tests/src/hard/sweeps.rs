//! Quantities swept over their whole range: how far every rung is from itself in f64, and from the truth.
//!
//! The first distance is the implementation's and has a bound that holds over the whole range. The second is the
//! approximation's (and that of the stored precision): it says where a rung stops being valid.

use glam::{DMat3, DVec3, Quat, Vec3};
use motes_renderer::{Fov, LowPass, Packing, Precision, Projection, RenderConfig, View};
use motes_scenes::{Splats, sh_coefficients};

use super::rig::{Deviation, PLAIN, Rig, apart, deviation, every_layer, truth};
use super::scene::{Gaussian, ahead, scene};

/// One way of drawing that is swept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rung {
    /// How splats are projected.
    pub projection: Projection,
    /// How they are stored.
    pub precision: Precision,
}

impl Rung {
    /// The rungs that every sweep draws: each projection in f32, and the storage forms of the default one.
    pub const ALL: [Self; 5] = [
        Self { projection: Projection::Affine, precision: Precision::F32 },
        Self { projection: Projection::Tangent, precision: Precision::F32 },
        Self { projection: Projection::Exact, precision: Precision::F32 },
        Self { projection: Projection::Tangent, precision: Precision::F16 },
        Self { projection: Projection::Tangent, precision: Precision::F16Naive },
    ];

    /// Its name, as in plots.
    pub fn name(self) -> String {
        format!("{} {}", self.projection, self.precision)
    }
}

/// What is drawn at one value.
pub struct Setting {
    /// The scene.
    pub splats: Splats,
    /// From where.
    pub views: Vec<View>,
    /// The filter.
    pub low_pass: LowPass,
}

/// One quantity, its range, and the bounds.
pub struct Sweep {
    /// Short name, as in file names.
    pub name: &'static str,
    /// What is swept, with its unit.
    pub quantity: &'static str,
    /// What is seen.
    pub about: &'static str,
    /// Whether values are spaced by ratios.
    pub logarithmic: bool,
    /// First and last value.
    pub range: [f64; 2],
    /// Largest distance of every f32 rung from its own f64 twin, 8-bit steps.
    pub bound: f64,
    /// The same for f16 storage.
    pub bound_f16: f64,
    /// Values from which on that holds for f16 storage: log-scales are stored down to e⁻²⁴.
    pub f16_from: f64,
    /// The scene and view at a value.
    pub setting: fn(f64) -> Setting,
}

/// Worst pixel beyond which a rung no longer shows the truth, 8-bit steps.
pub const VALID: f64 = 8.0;

/// What was measured at one value, for one rung.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// The swept quantity.
    pub value: f64,
    /// Distance from the same projection in f64.
    pub own: Deviation,
    /// Distance from the exact projection in f64.
    pub truth: Deviation,
    /// The approximation's own distance from the truth, both in f64.
    pub model: Deviation,
}

impl Sweep {
    /// `count` values over the range, ends included.
    pub fn values(&self, count: usize) -> Vec<f64> {
        let [first, last] = self.range;
        (0..count)
            .map(|i| {
                let t = i as f64 / (count - 1).max(1) as f64;
                if self.logarithmic { first * (last / first).powf(t) } else { first + (last - first) * t }
            })
            .collect()
    }

    /// The bound on a rung's distance from its own twin; none for the naive halves, which are there to fail.
    pub fn bound_of(&self, rung: Rung, value: f64) -> Option<f64> {
        match rung.precision {
            Precision::F32 => Some(self.bound),
            Precision::F16 => (value >= self.f16_from).then_some(self.bound_f16),
            Precision::F16Naive => None,
        }
    }

    /// Draws every rung at one value; samples in the order of [`Rung::ALL`].
    ///
    /// # Panics
    /// Where the device refuses.
    #[allow(clippy::panic, reason = "only tests call it")]
    pub fn measure(&self, rig: &mut Rig, value: f64) -> Vec<Sample> {
        let Setting { splats, views, low_pass } = (self.setting)(value);
        let config = |projection| RenderConfig { low_pass, ..every_layer(projection) };
        let exact = truth(&splats, &views, &config(Projection::Exact));
        let mut samples = Vec::new();
        for rung in Rung::ALL {
            let config = config(rung.projection);
            let own = truth(&splats, &views, &config);
            let scene = rig.upload(&splats, Packing { precision: rung.precision, ..PLAIN });
            let (pictures, _) = rig.draw(&scene, &views, &config).unwrap_or_else(|e| panic!("{value}: {e}"));
            samples.push(Sample {
                value,
                own: deviation(&pictures, &own),
                truth: deviation(&pictures, &exact),
                model: apart(&own, &exact),
            });
        }
        samples
    }
}

const SIZE: [u32; 2] = [40, 32];

fn planar(gaussians: &[Gaussian], view: View) -> Setting {
    Setting { splats: scene(gaussians), views: vec![view], low_pass: LowPass::Planar }
}

fn scaled(g: Gaussian, by: f32) -> Gaussian {
    Gaussian { mean: g.mean.map(|v| v * by), scales: g.scales.map(|v| v * by), ..g }
}

/// A splat as large as it is far.
fn depth(z: f64) -> Setting {
    let tilted = Gaussian::tilted().at([0.2, -0.14, 2.0]);
    planar(&[scaled(tilted, (z / 2.0) as f32)], ahead(SIZE, 60.0))
}

/// A splat of 5 cm, from around the eye to less than a pixel.
fn depth_of_one_size(z: f64) -> Setting {
    let z = z as f32;
    let g = Gaussian { scales: [0.05, 0.02, 0.03], ..Gaussian::tilted() };
    planar(&[g.at([0.1 * z, -0.07 * z, z])], ahead(SIZE, 60.0))
}

fn scale(s: f64) -> Setting {
    let s = s as f32;
    let g = Gaussian { scales: [s, 0.3 * s, 0.6 * s], ..Gaussian::tilted() };
    planar(&[g.at([0.13, -0.09, 2.0])], ahead(SIZE, 60.0))
}

/// Without a filter, and with a lens that keeps the splat 5 px large.
fn scale_magnified(s: f64) -> Setting {
    let g = Gaussian { scales: [1.0, 0.3, 0.6].map(|k| k * s as f32), ..Gaussian::tilted() };
    // No view is wider than tangents of 1000.
    let half = (3.0 * s / 2.0).min(1e3);
    let view = View { fov: Fov { left: -half, right: half, up: -half, down: half }, ..ahead(SIZE, 60.0) };
    Setting { low_pass: LowPass::Off, ..planar(&[g.at([0.0, 0.0, 2.0])], view) }
}

/// A needle that becomes ever thinner.
fn thinness(ratio: f64) -> Setting {
    let thin = (0.3 / ratio) as f32;
    let g = Gaussian { scales: [0.3, thin, thin], ..Gaussian::tilted() };
    planar(&[g.at([0.05, -0.02, 2.0])], ahead(SIZE, 60.0))
}

/// A needle that becomes ever longer.
fn length(ratio: f64) -> Setting {
    let g = Gaussian { scales: [0.02 * ratio as f32, 0.02, 0.02], ..Gaussian::tilted() };
    planar(&[g.at([0.05, -0.02, 2.0])], ahead(SIZE, 60.0))
}

/// Round to the side: a ball of 0.35 m at 1 m, from straight ahead to behind, in a picture 140° wide.
fn angle(degrees: f64) -> Setting {
    let a = degrees.to_radians();
    let direction = Vec3::new(a.sin() as f32, 0.0, a.cos() as f32);
    let g = Gaussian { scales: [0.35, 0.25, 0.3], ..Gaussian::tilted() };
    let fov = Fov { left: -2.747, right: 2.747, up: -1.2, down: 1.2 };
    planar(&[g.at(direction.to_array())], View { fov, ..ahead([64, 28], 60.0) })
}

fn logit(x: f64) -> Setting {
    let opacity = (1.0 / (1.0 + (-x).exp())) as f32;
    planar(&[Gaussian { opacity, ..Gaussian::tilted() }], ahead(SIZE, 60.0))
}

/// Third-degree harmonics of alternating sign, up to coefficients of 1000.
fn harmonics(size: f64) -> Setting {
    let mut setting = planar(
        &[Gaussian::tilted().at([-0.3, 0.1, 2.0]), Gaussian::tilted().at([0.35, -0.1, 2.0])],
        ahead(SIZE, 60.0),
    );
    setting.splats.set_sh_degree(3);
    for (k, c) in setting.splats.sh.iter_mut().enumerate() {
        let sign = if (k * 7 + 3) % 4 < 2 { 1.0 } else { -1.0 };
        if k % sh_coefficients(3) > 0 {
            *c = [sign * size as f32, 0.7 * sign * size as f32, -0.4 * sign * size as f32];
        }
    }
    setting
}

/// Scene and eye far from the data's origin, recentred as the loader does.
fn recentred(distance: f64) -> Setting {
    let mut setting = planar(&[Gaussian::tilted().at([0.2, -0.14, 2.0])], ahead(SIZE, 60.0));
    let origin = DVec3::new(distance, -0.7 * distance, 0.4 * distance);
    setting.splats.origin = origin.to_array();
    setting.views[0].eye = origin;
    setting
}

/// One scene so wide that the eye stands far from its origin: nothing recentres it.
fn far_walk(distance: f64) -> Setting {
    let at = DVec3::new(distance, -0.7 * distance, 0.4 * distance);
    // The means are what f32 makes of them, in the reference too; the eye is where nobody asked f32.
    let mean = (at + DVec3::new(0.2, -0.14, 2.0)).as_vec3();
    let eye = at + DVec3::new(0.0123, 0.0071, -0.0057);
    let near = mean.as_dvec3() - eye;
    let forward = near.normalize();
    let right = forward.cross(DVec3::NEG_Y).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    let view = View { eye, rotation, ..ahead(SIZE, 60.0) };
    // As large as it is far from the eye, whatever rounding did to its place.
    let size = near.length() as f32;
    let g = Gaussian { scales: [0.08, 0.025, 0.045].map(|s| s * size), ..Gaussian::tilted() };
    planar(&[g.at(mean.to_array())], view)
}

fn resolution(side: f64) -> Setting {
    let side = side.round() as u32;
    let g = Gaussian { scales: [0.4, 0.1, 0.2], ..Gaussian::tilted() };
    planar(&[g.at([0.1, 0.0, 2.0]), Gaussian::default().at([-0.4, 0.3, 2.0])], ahead([side, side], 60.0))
}

/// Pictures of one row, ever longer.
fn ribbon(side: f64) -> Setting {
    let side = side.round() as u32;
    let fov = Fov { left: -0.6, right: 0.6, up: -0.05, down: 0.05 };
    let view = View { fov, ..ahead([side, 1], 60.0) };
    planar(&[Gaussian::tilted().at([0.1, 0.0, 2.0])], view)
}

fn field_of_view(degrees: f64) -> Setting {
    let view = ahead([32, 32], degrees);
    // In the outer half of the picture, and as large as a quarter of it.
    let t = view.fov.right;
    let direction = DVec3::new(0.5 * t, -0.4 * t, 1.0).normalize().as_vec3() * 2.0;
    let s = 0.2 * (degrees.to_radians() / 2.0).sin() as f32;
    let g = Gaussian { scales: [s, 0.4 * s, 0.6 * s], ..Gaussian::tilted() };
    planar(&[g.at(direction.to_array())], view)
}

/// The left edge stays at 20°, the right one goes out.
fn asymmetry(right_degrees: f64) -> Setting {
    let fov = Fov { left: -0.364, right: right_degrees.to_radians().tan(), up: -0.9, down: 0.6 };
    let middle = 0.6 * fov.right;
    let g = Gaussian { scales: [0.2, 0.1, 0.15], ..Gaussian::tilted() };
    let direction = Vec3::new(middle as f32, 0.1, 1.0).normalize() * 2.0;
    planar(&[g.at(direction.to_array())], View { fov, ..ahead(SIZE, 60.0) })
}

/// A flat splat that is turned until it is seen edge-on.
fn edge_on(degrees: f64) -> Setting {
    let g = Gaussian {
        rotation: Quat::from_axis_angle(Vec3::new(0.6, 0.8, 0.0), degrees.to_radians() as f32),
        scales: [0.3, 0.2, 1e-9],
        ..Default::default()
    };
    planar(&[g.at([0.1, 0.05, 2.0])], ahead(SIZE, 60.0))
}

/// Every sweep of the stability report.
pub fn all() -> Vec<Sweep> {
    let log = |name, quantity, range, about, setting| Sweep {
        name,
        quantity,
        about,
        logarithmic: true,
        range,
        // A pixel on the rim where alpha is 1/255 may go either way, 0.7 of a step here, and half floats round.
        bound: 1.0,
        bound_f16: 1.5,
        f16_from: f64::NEG_INFINITY,
        setting,
    };
    let linear = |name, quantity, range, about, setting| Sweep {
        logarithmic: false,
        ..log(name, quantity, range, about, setting)
    };
    vec![
        log("depth", "depth (m)", [1e-4, 1e6], "A splat as large as it is far.", depth),
        log("depth-one-size", "depth (m)", [1e-4, 1e6], "A splat of 5 cm.", depth_of_one_size),
        log("scale", "standard deviation (m)", [1e-10, 1e4], "A splat 2 m ahead.", scale),
        Sweep {
            // The thinnest axis is 0.3 of it.
            f16_from: (-24f64).exp() / 0.3,
            ..log(
                "scale-magnified",
                "standard deviation (m)",
                [1e-10, 1e4],
                "No filter, lens to match.",
                scale_magnified,
            )
        },
        log("thinness", "length : width", [1.0, 1e8], "A needle of 30 cm that becomes thinner.", thinness),
        log("length", "length : width", [1.0, 1e8], "A needle of 2 cm that becomes longer.", length),
        linear("edge-on", "turn (°)", [0.0, 90.0], "A flat splat, turned until it is seen edge-on.", edge_on),
        linear(
            "angle",
            "angle from the axis (°)",
            [0.0, 180.0],
            "A splat of 35 cm, 1 m away, goes round.",
            angle,
        ),
        linear("opacity", "logit of opacity", [-100.0, 100.0], "From nothing to opaque.", logit),
        log(
            "harmonics",
            "coefficient",
            [1e-3, 1e3],
            "Third-degree colour; negative ones are black.",
            harmonics,
        ),
        log("position", "distance from the data's origin (m)", [1.0, 1e6], "Recentred at load.", recentred),
        log(
            "walk",
            "distance from the scene's origin (m)",
            [1.0, 1e6],
            "A viewer far out in one scene.",
            far_walk,
        ),
        log(
            "resolution",
            "side of the picture (px)",
            [1.0, 4096.0],
            "Two splats in a square picture.",
            resolution,
        ),
        log("ribbon", "width of the picture (px)", [1.0, 4096.0], "Pictures of one row.", ribbon),
        linear(
            "field-of-view",
            "vertical field of view (°)",
            [1.0, 170.0],
            "Halfway to the corner.",
            field_of_view,
        ),
        linear("asymmetry", "outer edge (°)", [20.0, 85.0], "The inner edge stays at 20°.", asymmetry),
    ]
}
