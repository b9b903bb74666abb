//! Which properties of a PLY's vertices make a splat, and how a row becomes one.

use ply_rs_bw::ply::PropertyType;

use super::header::Element;
use crate::chunks::SplatsMut;
use crate::formats::values::{dc_of_color, sigmoid};
use crate::load::LoadContext;
use crate::source::Source;
use crate::{SceneError, sh_coefficients};

// A splat's columns, in the order in which a layout lists them.
const X: usize = 0;
const ROTATION: usize = 3;
const SCALE: usize = 7;
const OPACITY: usize = 10;
const DC: usize = 11;
/// `f_rest_*`, channel-major, in a still scene; the columns of motion in a moving one.
const TAIL: usize = 14;
const CENTER: usize = TAIL;
const WIDTH: usize = TAIL + 1;
const MOTION: usize = TAIL + 2;
const OMEGA: usize = TAIL + 11;

/// Time widths above this are "always there" (`trbf_scale` ≥ 69); scene time runs from 0 to 1.
const ENDLESS: f32 = 1e30;

/// The columns that make a splat.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    /// Index into the element's properties per column.
    pub(crate) columns: Vec<usize>,
    /// Degree of the spherical harmonics that are read.
    pub(crate) sh_degree: u8,
    /// Whether these are Spacetime Gaussians.
    pub(crate) moving: bool,
}

/// One row, whatever its encoding; `column` counts as [`Layout::columns`] does.
pub(crate) trait Row {
    fn f32(&self, column: usize) -> f32;
    fn f64(&self, column: usize) -> f64;
}

impl Layout {
    /// Finds the columns; `moving` says which kind of scene they must make.
    pub(crate) fn of(
        source: &Source,
        ctx: &LoadContext<'_>,
        vertex: &Element,
        moving: bool,
    ) -> Result<Self, SceneError> {
        let path = source.path();
        if vertex.has("f_t_0") || (moving && vertex.has("f_dc_3")) {
            return Err(SceneError::unsupported(
                path,
                "this is a full-model Spacetime Gaussians scene (features f_t_*): its colours come out of a neural \
                 network that is kept in another file and needs its trainer to run",
                "Train or export the lite model, whose PLY has f_dc_0 .. f_dc_2 only",
            ));
        }
        let mut names: Vec<String> = ["x", "y", "z"].map(str::to_owned).into();
        names.extend((0..4).map(|i| format!("rot_{i}")));
        names.extend((0..3).map(|i| format!("scale_{i}")));
        names.push("opacity".to_owned());
        names.extend((0..3).map(|i| format!("f_dc_{i}")));
        let mut sh_degree = 0;
        if moving {
            names.extend(["trbf_center".to_owned(), "trbf_scale".to_owned()]);
            names.extend((0..9).map(|i| format!("motion_{i}")));
            names.extend((0..4).map(|i| format!("omega_{i}")));
        } else {
            let stored = rest_per_channel(source, vertex)?;
            let degree = degree_of(stored);
            if degree > 3 {
                ctx.warn(format!("{}: spherical harmonics of degree {degree} are cut to 3", path.display()));
            }
            sh_degree = degree.min(3);
            let kept = sh_coefficients(sh_degree) - 1;
            names.extend((0..3).flat_map(|c| (0..kept).map(move |k| format!("f_rest_{}", c * stored + k))));
        }

        let mut columns = Vec::with_capacity(names.len());
        let mut missing = Vec::new();
        for name in &names {
            match vertex.properties.iter().position(|p| p.name == *name) {
                Some(i) if matches!(vertex.properties[i].kind, PropertyType::Scalar(_)) => columns.push(i),
                Some(_) => {
                    return Err(SceneError::malformed(
                        path,
                        format!("property '{name}'"),
                        "it is a list, but should be one number",
                        "Export the scene again",
                    ));
                }
                None => missing.push(name.as_str()),
            }
        }
        if missing.is_empty() {
            return Ok(Self { columns, sh_degree, moving });
        }
        let remedy = if missing == ["scale_2"] {
            "This looks like a 2D Gaussian (surfel) scene, which Motes does not show"
        } else if missing.len() > 3 {
            "This PLY may be a point cloud or a mesh; name a trained Gaussian splatting scene"
        } else {
            "Export the scene again with these properties"
        };
        Err(SceneError::malformed(
            path,
            "element 'vertex'",
            format!("missing properties: {}", missing.join(", ")),
            remedy,
        ))
    }

    /// Writes a row to splat `i` of `out`; `origin` is subtracted from the mean before it is rounded to f32.
    #[inline]
    pub(crate) fn store(&self, row: &impl Row, origin: [f64; 3], out: &mut SplatsMut<'_>, i: usize) {
        out.means[i] = if origin == [0.0; 3] {
            std::array::from_fn(|k| row.f32(X + k))
        } else {
            std::array::from_fn(|k| (row.f64(X + k) - origin[k]) as f32)
        };
        // Files have w first.
        let quaternion =
            |first: usize| [row.f32(first + 1), row.f32(first + 2), row.f32(first + 3), row.f32(first)];
        out.rotations[i] = quaternion(ROTATION);
        out.log_scales[i] = std::array::from_fn(|k| row.f32(SCALE + k));
        out.opacities[i] = sigmoid(row.f32(OPACITY));
        let sh = &mut out.sh[i * out.coefficients..(i + 1) * out.coefficients];
        if let Some(motion) = &mut out.motion {
            // Raw colour, not a coefficient.
            sh[0] = std::array::from_fn(|c| dc_of_color(row.f32(DC + c)));
            motion.centers[i] = row.f32(CENTER);
            let width = row.f32(WIDTH).exp();
            motion.widths[i] = if width > ENDLESS { f32::MAX } else { width };
            motion.polynomials[i] =
                std::array::from_fn(|power| std::array::from_fn(|k| row.f32(MOTION + 3 * power + k)));
            motion.omegas[i] = quaternion(OMEGA);
        } else {
            sh[0] = std::array::from_fn(|c| row.f32(DC + c));
            let rest = sh.len() - 1;
            for (k, value) in sh[1..].iter_mut().enumerate() {
                *value = std::array::from_fn(|c| row.f32(TAIL + c * rest + k));
            }
        }
    }

    /// The mean of a row in f64.
    pub(crate) fn mean(row: &impl Row) -> [f64; 3] {
        std::array::from_fn(|k| row.f64(X + k))
    }
}

/// Number of `f_rest_*` per channel.
fn rest_per_channel(source: &Source, vertex: &Element) -> Result<usize, SceneError> {
    let n = vertex
        .properties
        .iter()
        .filter(|p| p.name.strip_prefix("f_rest_").is_some_and(|i| i.parse::<u32>().is_ok()))
        .count();
    if n % 3 == 0 && sh_coefficients(degree_of(n / 3)) == n / 3 + 1 {
        return Ok(n / 3);
    }
    Err(SceneError::malformed(
        source.path(),
        "properties 'f_rest_*'",
        format!("there are {n}, but spherical harmonics of degree 0, 1, 2, 3 have 0, 9, 24, 45"),
        "Export the scene again",
    ))
}

/// The degree whose bands above the constant one have `rest` coefficients, rounded down.
fn degree_of(rest: usize) -> u8 {
    ((rest + 1).isqrt() - 1).min(usize::from(u8::MAX)) as u8
}
