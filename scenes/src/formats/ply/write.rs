//! Writing a PLY: the trainers' layout, or Spacetime Gaussians lite.

use std::io::Write;

use crate::formats::values::{color_of_dc, logit};
use crate::{Splats, sh_coefficients};

/// `trbf_scale` of a splat that is always there: its exponential still fits an f32.
const ENDLESS: f32 = 88.0;

/// Binary little-endian; a still scene in the layout of Kerbl et al. (62 floats at degree 3), a moving one in that of
/// Spacetime Gaussians lite (32 floats; spherical harmonics above the constant band are lost). Means are f64 where
/// the scene has an origin.
pub(crate) fn write(splats: &Splats, out: &mut impl Write) -> std::io::Result<()> {
    let far = splats.origin != [0.0; 3];
    let rest = if splats.motion.is_some() { 0 } else { sh_coefficients(splats.sh_degree) - 1 };
    header(splats, far, rest, out)?;
    let mut row: Vec<u8> = Vec::with_capacity(300);
    for i in 0..splats.len() {
        row.clear();
        if far {
            row.extend(splats.mean_of(i).iter().flat_map(|v| v.to_le_bytes()));
        } else {
            push(&mut row, &splats.means[i]);
        }
        let sh = splats.sh_of(i);
        let wxyz = |q: &[f32; 4]| [q[3], q[0], q[1], q[2]];
        match &splats.motion {
            None => {
                push(&mut row, &[0.0; 3]);
                push(&mut row, &sh[0]);
                for c in 0..3 {
                    row.extend(sh[1..=rest].iter().flat_map(|v| v[c].to_le_bytes()));
                }
            }
            Some(motion) => {
                let width = motion.widths[i];
                push(&mut row, &[motion.centers[i], if width == f32::MAX { ENDLESS } else { width.ln() }]);
                push(&mut row, &[0.0; 3]);
                push(&mut row, motion.polynomials[i].as_flattened());
                push(&mut row, &sh[0].map(color_of_dc));
            }
        }
        push(&mut row, &[logit(splats.opacities[i])]);
        push(&mut row, &splats.log_scales[i]);
        push(&mut row, &wxyz(&splats.rotations[i]));
        if let Some(motion) = &splats.motion {
            push(&mut row, &wxyz(&motion.omegas[i]));
        }
        out.write_all(&row)?;
    }
    Ok(())
}

fn push(row: &mut Vec<u8>, values: &[f32]) {
    for v in values {
        row.extend(v.to_le_bytes());
    }
}

fn header(splats: &Splats, far: bool, rest: usize, out: &mut impl Write) -> std::io::Result<()> {
    writeln!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {}", splats.len())?;
    let numbered = |stem: &str, n: usize| (0..n).map(|i| format!("{stem}_{i}")).collect::<Vec<_>>();
    let list = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
    for name in ["x", "y", "z"] {
        writeln!(out, "property {} {name}", if far { "double" } else { "float" })?;
    }
    let names = if splats.motion.is_some() {
        [
            list(&["trbf_center", "trbf_scale", "nx", "ny", "nz"]),
            numbered("motion", 9),
            numbered("f_dc", 3),
            list(&["opacity"]),
            numbered("scale", 3),
            numbered("rot", 4),
            numbered("omega", 4),
        ]
    } else {
        [
            list(&["nx", "ny", "nz"]),
            numbered("f_dc", 3),
            numbered("f_rest", 3 * rest),
            list(&["opacity"]),
            numbered("scale", 3),
            numbered("rot", 4),
            Vec::new(),
        ]
    };
    for name in names.concat() {
        writeln!(out, "property float {name}")?;
    }
    writeln!(out, "end_header")
}
