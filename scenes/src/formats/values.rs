//! How formats encode numbers.

use crate::SH_C0;

/// A logit as opacity. ±∞ are exactly 1 and 0; never overflows, and exact to an f32's last digits at both ends.
pub(crate) fn sigmoid(logit: f32) -> f32 {
    let e = (-logit.abs()).exp();
    let small = e / (1.0 + e);
    if logit < 0.0 { small } else { 1.0 - small }
}

/// An opacity as a finite logit for which [`sigmoid`] gives it back: exactly 0 and 1 become −110 and 20, beyond which
/// f32 tells no difference, because other programs drop splats with infinite values.
pub(crate) fn logit(opacity: f32) -> f32 {
    let p = f64::from(opacity);
    ((p / (1.0 - p)).ln()).clamp(-110.0, 20.0) as f32
}

/// A colour `0 ..= 1` as coefficient of the constant band.
pub(crate) fn dc_of_color(color: f32) -> f32 {
    (color - 0.5) / SH_C0
}

/// The colour of a constant band; may lie outside of `0 ..= 1`.
pub(crate) fn color_of_dc(dc: f32) -> f32 {
    0.5 + SH_C0 * dc
}

/// A little-endian u32; `bytes` must reach that far, here and below.
pub(crate) fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    u32::from_le_bytes(std::array::from_fn(|i| bytes[offset + i]))
}

/// A little-endian u16.
pub(crate) fn u16_at(bytes: &[u8], offset: usize) -> u16 {
    u16::from_le_bytes([bytes[offset], bytes[offset + 1]])
}

/// A little-endian f32.
pub(crate) fn f32_at(bytes: &[u8], offset: usize) -> f32 {
    f32::from_bits(u32_at(bytes, offset))
}

/// A little-endian half float.
pub(crate) fn f16_at(bytes: &[u8], offset: usize) -> f32 {
    half::f16::from_bits(u16_at(bytes, offset)).to_f32()
}
