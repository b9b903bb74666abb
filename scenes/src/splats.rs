//! The one in-memory form of a scene, a structure of arrays.

/// The constant band of the real spherical harmonics, `1 / (2 √π)`: colour = ½ + `SH_C0` · dc.
pub const SH_C0: f32 = 0.282_094_79;

/// Number of spherical-harmonics coefficients per colour channel for a degree: `(degree + 1)²`.
pub const fn sh_coefficients(degree: u8) -> usize {
    let n = degree as usize + 1;
    n * n
}

/// A scene's splats, all arrays of equal length [`Splats::len`].
///
/// Conventions, whatever the file said:
/// * **Axes** are the file's own. Which way is up, and how long a unit is, belong to the scene's settings
///   and are applied to the view, never to the data. World scale 1 means one unit is one metre.
/// * **Every value is finite**: readers drop splats that are not, and count them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Splats {
    /// Added to every mean, in f64: zero, or the centre of a scene far from its origin (georeferenced
    /// scenes lie 10⁶ m out, where an f32 resolves only 6 cm).
    pub origin: [f64; 3],
    /// Means relative to `origin`, metres, scene axes.
    pub means: Vec<[f32; 3]>,
    /// Unit quaternions `(x, y, z, w)` that rotate splat axes to scene axes.
    pub rotations: Vec<[f32; 4]>,
    /// Natural logarithm of the standard deviations along the splat's axes, metres.
    pub log_scales: Vec<[f32; 3]>,
    /// Opacity at the centre, `0 ..= 1` (not a logit: files that say exactly 0 or 1 mean it).
    pub opacities: Vec<f32>,
    /// Degree of the spherical harmonics, `0 ..= 3`.
    pub sh_degree: u8,
    /// `[r, g, b]` coefficients, [`sh_coefficients`]`(sh_degree)` per splat, constant band first:
    /// colour (sRGB-encoded, as trained) = `max(0, ½ + Σ sh[k] · Y_k(direction from eye to splat))`.
    pub sh: Vec<[f32; 3]>,
    /// Motion over time; absent in a static scene.
    pub motion: Option<Motion>,
    /// A class per splat, 0 = unlabelled; absent where nobody labelled the scene.
    pub labels: Option<Vec<u16>>,
}

/// Motion of every splat (Spacetime Gaussians, lite model; Li et al. 2023), with `dt = t − centers[i]`, `t ∈ [0, 1]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Motion {
    /// Time at which the splat is most opaque.
    pub centers: Vec<f32>,
    /// Width of the temporal falloff: opacity is multiplied by `exp(−(dt / widths)²)`. Positive; `f32::MAX` means always there.
    pub widths: Vec<f32>,
    /// Polynomial coefficients of the position: mean + `p[0] dt + p[1] dt² + p[2] dt³`, metres.
    pub polynomials: Vec<[[f32; 3]; 3]>,
    /// Change of the (unit) quaternion per unit of time, `(x, y, z, w)`: `normalize(rotation + dt · omega)`.
    pub omegas: Vec<[f32; 4]>,
}

impl Splats {
    /// Number of splats.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Whether there is no splat at all.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// The spherical-harmonics coefficients of splat `i`, constant band first.
    pub fn sh_of(&self, i: usize) -> &[[f32; 3]] {
        let n = sh_coefficients(self.sh_degree);
        &self.sh[i * n..(i + 1) * n]
    }
}

impl Splats {
    /// `n` splats, all zero (not yet valid: readers fill them in). Pages are only touched when written to.
    pub fn zeroed(n: usize, sh_degree: u8, moving: bool) -> Self {
        Self {
            origin: [0.0; 3],
            means: vec![[0.0; 3]; n],
            rotations: vec![[0.0; 4]; n],
            log_scales: vec![[0.0; 3]; n],
            opacities: vec![0.0; n],
            sh_degree,
            sh: vec![[0.0; 3]; n * sh_coefficients(sh_degree)],
            motion: moving.then(|| Motion::zeroed(n)),
            labels: None,
        }
    }

    /// Bytes that a splat takes here, without labels.
    pub const fn bytes_per_splat(sh_degree: u8, moving: bool) -> usize {
        let motion = if moving { 4 + 4 + 36 + 16 } else { 0 };
        12 + 16 + 12 + 4 + 12 * sh_coefficients(sh_degree) + motion
    }

    /// Mean of splat `i` in scene axes, `origin` included, metres.
    pub fn mean_of(&self, i: usize) -> [f64; 3] {
        std::array::from_fn(|k| self.origin[k] + f64::from(self.means[i][k]))
    }

    /// Keeps the splats for which `keep` says so (called once each, in order), in their order and in place.
    pub fn retain(&mut self, keep: impl Fn(usize) -> bool) {
        fn each<T>(values: &mut Vec<T>, keep: &impl Fn(usize) -> bool) {
            let mut i = 0;
            values.retain(|_| {
                i += 1;
                keep(i - 1)
            });
        }
        let coefficients = sh_coefficients(self.sh_degree);
        each(&mut self.means, &keep);
        each(&mut self.rotations, &keep);
        each(&mut self.log_scales, &keep);
        each(&mut self.opacities, &keep);
        each(&mut self.sh, &|k| keep(k / coefficients));
        if let Some(motion) = &mut self.motion {
            each(&mut motion.centers, &keep);
            each(&mut motion.widths, &keep);
            each(&mut motion.polynomials, &keep);
            each(&mut motion.omegas, &keep);
        }
        if let Some(labels) = &mut self.labels {
            each(labels, &keep);
        }
    }

    /// A copy of some of the splats, in the order of their indices here.
    ///
    /// # Panics
    /// Where an index is not below [`Splats::len`].
    pub fn selected(&self, indices: &[u32]) -> Self {
        fn pick<T: Copy>(values: &[T], indices: &[u32]) -> Vec<T> {
            indices.iter().map(|&i| values[i as usize]).collect()
        }
        Self {
            origin: self.origin,
            means: pick(&self.means, indices),
            rotations: pick(&self.rotations, indices),
            log_scales: pick(&self.log_scales, indices),
            opacities: pick(&self.opacities, indices),
            sh_degree: self.sh_degree,
            sh: indices.iter().flat_map(|&i| self.sh_of(i as usize)).copied().collect(),
            motion: self.motion.as_ref().map(|m| Motion {
                centers: pick(&m.centers, indices),
                widths: pick(&m.widths, indices),
                polynomials: pick(&m.polynomials, indices),
                omegas: pick(&m.omegas, indices),
            }),
            labels: self.labels.as_ref().map(|l| pick(l, indices)),
        }
    }

    /// Raises the spherical harmonics to a higher degree by appending zeros, or cuts them to a lower one.
    pub fn set_sh_degree(&mut self, degree: u8) {
        let (old, new, n) = (sh_coefficients(self.sh_degree), sh_coefficients(degree), self.len());
        self.sh_degree = degree;
        if new > old {
            // In place, from the back, so that the array never exists twice.
            self.sh.reserve_exact(n * (new - old));
            self.sh.resize(n * new, [0.0; 3]);
            for i in (0..n).rev() {
                self.sh.copy_within(i * old..(i + 1) * old, i * new);
                self.sh[i * new + old..(i + 1) * new].fill([0.0; 3]);
            }
        } else if new < old {
            for i in 0..n {
                self.sh.copy_within(i * old..i * old + new, i * new);
            }
            self.sh.truncate(n * new);
            self.sh.shrink_to_fit();
        }
    }
}

impl Motion {
    /// Motion of `n` splats, all zero, always there.
    pub fn zeroed(n: usize) -> Self {
        Self {
            centers: vec![0.0; n],
            widths: vec![f32::MAX; n],
            polynomials: vec![[[0.0; 3]; 3]; n],
            omegas: vec![[0.0; 4]; n],
        }
    }
}
