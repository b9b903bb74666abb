//! Gaussian splatting `.ply`: the trainers' layout (Kerbl et al. 2023, `scene/gaussian_model.py`), and Spacetime
//! Gaussians lite (Li et al. 2023, `scene/ourslite.py`).
//!
//! One element `vertex` with a number per property: `x y z`, `rot_0..3` (w first, any length), `scale_0..2` (natural
//! logarithms), `opacity` (logit), `f_dc_0..2` and `f_rest_*` (spherical harmonics, channel by channel). Spacetime
//! Gaussians add `trbf_center`, `trbf_scale` (logarithm), `motion_0..8`, `omega_0..3`, and mean a raw colour by `f_dc`.
//! Properties may be in any order and of any type; others, lists too, are skipped, and so are other elements.

mod binary;
pub(crate) mod header;
mod layout;
mod text;
mod write;

use ply_rs_bw::ply::Encoding;

use crate::chunks::SplatsMut;
use crate::load::LoadContext;
use crate::source::Source;
use crate::{Format, SceneError, Splats};
use binary::Window;
use header::{Element, Header};
use layout::Layout;

pub(crate) use write::write;

/// See [`super`].
pub(crate) fn read(source: &Source, ctx: &LoadContext<'_>) -> Result<Splats, SceneError> {
    let header = Header::read(source)?;
    let moving = header.format(source.path())? == Format::SpacetimePly;
    let vertex = header.vertex(source.path())?;
    let layout = Layout::of(source, ctx, vertex, moving)?;

    let big_endian = match header.encoding {
        Encoding::Ascii => {
            // Every number takes a digit and a separator, but for the file's very last one.
            let least = 2 * vertex.properties.len() as u64;
            check_size(source, vertex, header.data_offset, 1, least)?;
            let mut splats = allocate(source, ctx, vertex, &layout)?;
            splats.origin = text::read(source, ctx, &header, &layout, SplatsMut::all(&mut splats))?;
            return Ok(splats);
        }
        Encoding::BinaryBigEndian => true,
        Encoding::BinaryLittleEndian => false,
    };

    let mut window = Window::new(source, big_endian, header.data_offset);
    for element in header.elements.iter().take_while(|e| e.name != vertex.name) {
        window.skip_element(ctx, element)?;
    }
    let offset = window.offset();
    check_size(source, vertex, offset, 0, vertex.min_row_bytes())?;
    let mut splats = allocate(source, ctx, vertex, &layout)?;
    let out = SplatsMut::all(&mut splats);
    if vertex.is_fixed() {
        splats.origin = binary::read_fixed(source, ctx, vertex, &layout, big_endian, offset, out)?;
        warn_of_rest(source, ctx, &header, vertex, offset);
    } else {
        binary::read_ragged(source, ctx, vertex, &layout, &mut window, out)?;
    }
    Ok(splats)
}

/// Refuses a count of vertices that the file's bytes (and `slack` more) cannot hold.
fn check_size(
    source: &Source,
    vertex: &Element,
    offset: u64,
    slack: u64,
    row_bytes: u64,
) -> Result<(), SceneError> {
    let available = source.len().saturating_sub(offset);
    if u128::from(vertex.count) * u128::from(row_bytes) <= u128::from(available) + u128::from(slack) {
        return Ok(());
    }
    Err(SceneError::malformed(
        source.path(),
        format!("byte {offset}"),
        format!(
            "the header promises {} vertices of {row_bytes} bytes at least, but {available} bytes are left in the file, \
             enough for {}",
            vertex.count,
            available / row_bytes.max(1)
        ),
        "It was cut off, or its header is wrong: copy or download it again",
    ))
}

fn allocate(
    source: &Source,
    ctx: &LoadContext<'_>,
    vertex: &Element,
    layout: &Layout,
) -> Result<Splats, SceneError> {
    let n = ctx.admit(source, vertex.count, layout.sh_degree, layout.moving)?;
    Ok(Splats::zeroed(n, layout.sh_degree, layout.moving))
}

/// Says so where bytes are missing or left over behind the vertices.
fn warn_of_rest(source: &Source, ctx: &LoadContext<'_>, header: &Header, vertex: &Element, offset: u64) {
    let mut end = offset;
    for element in header.elements.iter().skip_while(|e| e.name != vertex.name) {
        if !element.is_fixed() {
            return;
        }
        end = end.saturating_add(element.count.saturating_mul(element.min_row_bytes()));
    }
    let (path, len) = (source.path().display(), source.len());
    if len > end {
        ctx.warn(format!("{path}: {} bytes behind the last row are ignored", len - end));
    } else if len < end {
        ctx.warn(format!("{path}: the splats are complete, but the file is cut off behind them"));
    }
}
