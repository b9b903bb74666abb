//! The named experiments: sweeps that repeat what others published, with their figures beside ours and why they differ.
//!
//! `002` is Jourdain, Deltenre, Chasseray 2025, “Optimisation du 4D Gaussian Splatting pour son utilisation en VR” (a
//! report on a Quest 3 viewer); `003` is Huang, Bai, Guo, Guo 2024, “Optimal Projection for 3D Gaussian Splatting”.

use super::sweep::{Changes, Sweep};

/// A named experiment.
pub struct Experiment {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it is about.
    pub title: &'static str,
    /// What is asked, one or two sentences.
    pub question: &'static str,
    /// Where it was published; empty where it was not.
    pub source: &'static str,
    /// What is measured.
    pub sweep: Sweep,
    /// Published figures and what ours are computed from.
    pub rows: &'static [Row],
    /// Why ours differ from what was published, or what to make of them.
    pub why: &'static str,
}

/// A figure.
pub struct Row {
    /// What it is.
    pub what: &'static str,
    /// What was published; empty where nothing was.
    pub published: &'static str,
    /// What of ours is compared.
    pub quantity: Quantity,
    /// Of which configuration: changes in the experiment's base.
    pub of: Changes,
    /// Over, or against, which configuration; alone where there is none.
    pub over: Option<Changes>,
}

/// What can be read off a configuration's outcome.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Fragments per pixel of the full-size image.
    Layers,
    /// Vertex-stage invocations.
    Vertices,
    /// Device time, ms.
    DeviceTime,
    /// Frames per second of the device time.
    DeviceRate,
    /// Frames per second that are predicted for a headset.
    PredictedRate,
    /// Bytes of the scene on the device.
    SceneBytes,
    /// Splats drawn.
    Visible,
    /// Mean FLIP error against the reference; between the two pictures, where there are two.
    Flip,
    /// SSIM against the reference.
    Ssim,
    /// Difference of the worst pixel.
    Worst,
    /// Sorting on the processor, ms.
    SortTime,
}

const fn row(what: &'static str, published: &'static str, quantity: Quantity, of: Changes) -> Row {
    Row { what, published, quantity, of, over: None }
}

const fn against(
    what: &'static str,
    published: &'static str,
    quantity: Quantity,
    of: Changes,
    over: Changes,
) -> Row {
    Row { what, published, quantity, of, over: Some(over) }
}

const BASE: Changes = &[];
const DIAMOND: Changes = &[("shape", "diamond")];
const OCTAGON: Changes = &[("shape", "octagon")];
const INSTANCED: Changes = &[("expansion", "instanced")];
const PRECOMPUTED: Changes = &[("expansion", "precomputed")];
const NAIVE: Changes = &[("precision", "f16-naive"), ("sh-precision", "f16")];
const HALF: Changes = &[("precision", "f16"), ("sh-precision", "f16")];
const OPAQUE: Changes = &[("min-opacity", "0.1")];
const AFFINE: Changes = &[("projection", "affine")];
const EXACT: Changes = &[("projection", "exact")];
const FLOATS: Changes = &[("target-format", "rgba32f")];
const BILINEAR: Changes = &[("upscale", "bilinear")];
const B70: Changes = &[("upscale", "bilinear"), ("resolution-scale", "0.7")];
const B50: Changes = &[("upscale", "bilinear"), ("resolution-scale", "0.5")];
const I70: Changes = &[("upscale", "interleaved"), ("resolution-scale", "0.7")];
const I50: Changes = &[("upscale", "interleaved"), ("resolution-scale", "0.5")];

/// All of them.
pub const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "shape",
        title: "The polygon that covers a splat",
        question: "A square over a splat's ellipse is mostly empty in its corners. A diamond halves its \
                   area and cuts the rims; an octagon cuts nothing that shows.",
        source: "002, section 5.1.2",
        sweep: Sweep {
            base: "quest-report",
            axes: &[("shape", &["diamond", "octagon", "adaptive", "axis-aligned"])],
            points: &[],
        },
        rows: &[
            against("fragments, diamond / square", "0.50", Quantity::Layers, DIAMOND, BASE),
            against("fragments, octagon / square", "", Quantity::Layers, OCTAGON, BASE),
            against(
                "frame rate on a Quest 3, diamond / square (ours: predicted)",
                "13 to 21 FPS, which the report calls +55 % (21 / 13 = 1.62)",
                Quantity::PredictedRate,
                DIAMOND,
                BASE,
            ),
            against("frame rate of this device, diamond / square", "", Quantity::DeviceRate, DIAMOND, BASE),
            against(
                "FLIP between diamond and square",
                "shown as a map without figures",
                Quantity::Flip,
                DIAMOND,
                BASE,
            ),
            against("FLIP between octagon and square", "", Quantity::Flip, OCTAGON, BASE),
        ],
        why: "A diamond's fragments are half of a square's by geometry; what deviates from 0.50 is small \
               polygons, whose pixels a rasteriser counts by their centres, and polygons that the \
              image's rim cuts. How much frame rate follows depends on the share of the fragment stage: \
              75 % in the report's profile, another here, where the processor draws.",
    },
    Experiment {
        name: "expansion",
        title: "Where a splat becomes a polygon",
        question: "The report replaced its geometry stage by instanced quads, as a vendor advises, and \
                   lost speed. A compute pass that projects once and writes compact records removes both \
                    causes it names.",
        source: "002, section 5.1.1",
        sweep: Sweep {
            base: "quest-report",
            axes: &[("expansion", &["instanced", "precomputed"])],
            points: &[],
        },
        rows: &[
            against(
                "frame rate of this device, instanced / geometry",
                "less than 1 (no figure)",
                Quantity::DeviceRate,
                INSTANCED,
                BASE,
            ),
            against(
                "frame rate of this device, precomputed / geometry",
                "",
                Quantity::DeviceRate,
                PRECOMPUTED,
                BASE,
            ),
            against("vertex invocations, instanced / geometry", "4", Quantity::Vertices, INSTANCED, BASE),
            against("vertex invocations, precomputed / geometry", "", Quantity::Vertices, PRECOMPUTED, BASE),
            against("FLIP between instanced and geometry", "", Quantity::Flip, INSTANCED, BASE),
        ],
        why: "All three draw the same polygons, so pictures agree. An instanced quad projects at each of \
               its corners; the precomputed form projects once and culls before any vertex runs. On a \
              tile-based device the geometry stage also writes what it expands to memory, which a \
              processor's driver does not show.",
    },
    Experiment {
        name: "resolution",
        title: "Fewer pixels, and the way back to full size",
        question: "Drawing fewer pixels and stretching them bilinearly, against interleaved sampling, \
                   whose pixels each look at another point of the full-size grid.",
        source: "002, section 5.1.3, tables 1 and 2",
        sweep: Sweep {
            base: "default",
            axes: &[],
            points: &[
                BILINEAR,
                B70,
                B50,
                &[("upscale", "interleaved"), ("resolution-scale", "0.8")],
                I70,
                &[("upscale", "interleaved"), ("resolution-scale", "0.7071")],
                I50,
                &[("upscale", "interleaved-temporal"), ("resolution-scale", "0.7071")],
                &[("upscale", "interleaved-temporal"), ("resolution-scale", "0.5")],
            ],
        },
        rows: &[
            against(
                "frame rate of this device, bilinear at 70 % / full",
                "1.23 (desktop)",
                Quantity::DeviceRate,
                B70,
                BILINEAR,
            ),
            against(
                "frame rate of this device, interleaved at 70 % / full",
                "1.20 (desktop)",
                Quantity::DeviceRate,
                I70,
                BASE,
            ),
            against(
                "frame rate of this device, bilinear at 50 % / full",
                "1.41 (desktop)",
                Quantity::DeviceRate,
                B50,
                BILINEAR,
            ),
            against(
                "frame rate of this device, interleaved at 50 % / full",
                "1.35 (desktop)",
                Quantity::DeviceRate,
                I50,
                BASE,
            ),
            against("fragments, bilinear at 70 % / full", "", Quantity::Layers, B70, BILINEAR),
            against("FLIP between bilinear at 70 % and full", "0.065450", Quantity::Flip, B70, BILINEAR),
            against("FLIP between interleaved at 70 % and full", "0.084911", Quantity::Flip, I70, BASE),
        ],
        why: "The report's desktop was bound by more than fragments, so its gains stay below those of \
              the pixel counts (2.0 at 70 %). Its interleaved pictures were stretched bilinearly as if \
              their samples lay on a regular grid, which smears what the pattern had kept; ours are \
              reconstructed from where the samples really lie. Its pictures were of a garden at headset \
              size, with foliage everywhere: higher errors for every method.",
    },
    Experiment {
        name: "half-floats",
        title: "Half floats, and the halo",
        question: "Sixteen bits for everything, covariance too, broke the report's pictures; sixteen \
                   bits where they suffice do not.",
        source: "002, section 5.1.4, figures 15 and 16",
        sweep: Sweep {
            base: "quest-report",
            axes: &[],
            points: &[HALF, NAIVE, &[("precision", "f16"), ("sh-precision", "u8")]],
        },
        rows: &[
            against(
                "frame rate of this device, all half / f32",
                "1.3 to 1.4 on a desktop, 1.0 on a Quest 3",
                Quantity::DeviceRate,
                NAIVE,
                BASE,
            ),
            against("bytes of the scene, all half / f32", "0.5", Quantity::SceneBytes, NAIVE, BASE),
            against("bytes of the scene, half done right / f32", "", Quantity::SceneBytes, HALF, BASE),
            against(
                "FLIP between all half and f32",
                "a halo over the middle (no figure)",
                Quantity::Flip,
                NAIVE,
                BASE,
            ),
            against("FLIP between half done right and f32", "", Quantity::Flip, HALF, BASE),
            row("worst pixel of all half, 0 to 1", "", Quantity::Worst, NAIVE),
        ],
        why: "How far half floats break a picture depends on the scene: positions far from the origin \
              and covariances of small splats fall below what eleven bits tell apart. A scene of a metre \
               around its origin shows less than the report's garden. The frame rate here says little: a \
               processor converts half floats at a cost.",
    },
    Experiment {
        name: "opacity-threshold",
        title: "Leaving out faint splats",
        question: "Without its splats of less than 10 % opacity the report's garden had holes, from \
                   which it concluded that the scene was full of faint splats.",
        source: "002, section 5.2, figure 17",
        sweep: Sweep {
            base: "quest-report",
            axes: &[("min-opacity", &["0.01", "0.05", "0.1", "0.2"])],
            points: &[],
        },
        rows: &[
            against("splats drawn, at least 10 % opaque / all", "", Quantity::Layers, OPAQUE, BASE),
            row("FLIP at 10 %", "holes (figure 17, no figure)", Quantity::Flip, OPAQUE),
            row("SSIM at 10 %", "", Quantity::Ssim, OPAQUE),
            row("FLIP at 5 %", "", Quantity::Flip, &[("min-opacity", "0.05")]),
            row("FLIP at 1 %", "", Quantity::Flip, &[("min-opacity", "0.01")]),
        ],
        why: "How much a threshold costs is a property of the scene. (The first row compares fragments, \
              which is what the device is relieved of.) Scenes that were pruned after training lose \
              less.",
    },
    Experiment {
        name: "layers",
        title: "How many splats lie over a pixel",
        question: "The report found “several thousand” splats over some pixels of its garden, and far \
                   fewer in a scene that was trained to need fewer. The maps below and the table of \
                   scenes above show ours.",
        source: "002, section 5.2.1, figure 20",
        sweep: Sweep {
            base: "default",
            axes: &[
                ("composite", &["front-to-back", "early-stop"]),
                ("shape", &["square"]),
                ("radius", &["sqrt8"]),
            ],
            points: &[],
        },
        rows: &[
            row(
                "fragments per pixel, every layer",
                "115 on average, from 677 M fragments a frame (figure 5) on two eyes of 1680 × 1760",
                Quantity::Layers,
                &[("composite", "front-to-back")],
            ),
            row("fragments per pixel, with early stop", "", Quantity::Layers, BASE),
        ],
        why: "Scenes differ, and so do sizes: a black ground has no layers, and a splat of a few pixels \
              covers more of them at a headset's size. Figure 20 has no scale that can be read.",
    },
    Experiment {
        name: "early-stop",
        title: "Stopping where a pixel is opaque",
        question: "The report wanted to stop blending where nothing shows through any more, and did not \
                   build it. Here splats are drawn front to back in batches, and pixels that are opaque \
                   are closed between them.",
        source: "002, section 5.1.4; VR-Pipe (HPCA 2025)",
        sweep: Sweep {
            base: "default",
            axes: &[
                ("composite", &["front-to-back", "back-to-front"]),
                ("stop-below", &["0.02", "0.05", "0.1"]),
                ("batches", &["2", "4"]),
            ],
            points: &[],
        },
        rows: &[
            against(
                "frame rate of this device, early stop / every layer",
                "up to 2.78 in hardware (VR-Pipe)",
                Quantity::DeviceRate,
                BASE,
                &[("composite", "front-to-back")],
            ),
            against(
                "fragments, early stop / every layer",
                "",
                Quantity::Layers,
                BASE,
                &[("composite", "front-to-back")],
            ),
            against(
                "frame rate of this device, stop below 5 % / every layer",
                "",
                Quantity::DeviceRate,
                &[("stop-below", "0.05")],
                &[("composite", "front-to-back")],
            ),
            against(
                "FLIP between early stop and every layer",
                "",
                Quantity::Flip,
                BASE,
                &[("composite", "front-to-back")],
            ),
            against(
                "FLIP between stop below 5 % and every layer",
                "",
                Quantity::Flip,
                &[("stop-below", "0.05")],
                &[("composite", "front-to-back")],
            ),
        ],
        why: "The gain is what lies behind opaque pixels: much indoors and in gardens, little for one \
              object on an empty ground. Marks look at the tiles where pixels are predicted to be \
              opaque, which a small picture feels most.",
    },
    Experiment {
        name: "projection",
        title: "Projection, by angle from the middle of the view",
        question: "The classic projection linearises every splat on one plane and errs towards the rim. \
                   The optimal one takes each splat's own tangent plane; the exact one asks along every \
                   pixel's ray.",
        source: "003, equation 16, figure 2, section 5",
        sweep: Sweep {
            base: "default",
            axes: &[("projection", &["affine", "exact"])],
            points: &[&[("projection", "affine"), ("low-pass", "none")], &[("low-pass", "none")]],
        },
        rows: &[
            row("FLIP of affine", "", Quantity::Flip, AFFINE),
            row("FLIP of tangent", "", Quantity::Flip, BASE),
            row("FLIP of exact", "", Quantity::Flip, EXACT),
            against(
                "frame rate of this device, tangent / affine",
                "“real-time” kept (no figure)",
                Quantity::DeviceRate,
                BASE,
                AFFINE,
            ),
            against("frame rate of this device, exact / affine", "", Quantity::DeviceRate, EXACT, AFFINE),
        ],
        why: "003 measures against photographs with scenes trained for each projection (+0.25 dB on \
              average); ours measures against the exact projection of the same scene, which isolates the \
               projection itself. Scenes here were trained with the affine one, so they look as their \
              trainer saw them only under it.",
    },
    Experiment {
        name: "sort",
        title: "The order: key, bits, age, who sorts",
        question: "An order that is some frames old, a shorter key, or no order at all: what does it do \
                   to the picture? The head moves sideways at 0.5 m/s, at 72 frames a second.",
        source: "002, section 4 (sorts anew when the camera has moved far; no figures)",
        sweep: Sweep {
            base: "default",
            axes: &[
                ("order", &["depth"]),
                ("key-bits", &["16"]),
                ("sort-interval", &["10", "30", "60"]),
                ("sort", &["gpu", "stochastic"]),
            ],
            points: &[],
        },
        rows: &[
            row("FLIP of a new order", "", Quantity::Flip, BASE),
            against(
                "FLIP between an order of 9 frames ago and a new one",
                "",
                Quantity::Flip,
                &[("sort-interval", "10")],
                BASE,
            ),
            against(
                "FLIP between an order of 59 frames ago and a new one",
                "",
                Quantity::Flip,
                &[("sort-interval", "60")],
                BASE,
            ),
            against("FLIP between 16-bit and 32-bit keys", "", Quantity::Flip, &[("key-bits", "16")], BASE),
            against("FLIP between depth and radial order", "", Quantity::Flip, &[("order", "depth")], BASE),
            row("sorting on the processor, ms", "", Quantity::SortTime, BASE),
        ],
        why: "Nothing to compare with was published in these texts. One scene unit is taken for a metre.",
    },
    Experiment {
        name: "sh-degree",
        title: "Degree and storage of spherical harmonics",
        question: "Colours that change with the direction of view take most of a scene's memory. How \
                   much of the picture is in them?",
        source: "",
        sweep: Sweep {
            base: "default",
            axes: &[("sh-degree", &["0", "1", "2"]), ("sh-precision", &["f16", "u8"])],
            points: &[],
        },
        rows: &[
            row("FLIP at degree 0", "", Quantity::Flip, &[("sh-degree", "0")]),
            row("FLIP at degree 1", "", Quantity::Flip, &[("sh-degree", "1")]),
            row("FLIP at degree 3", "", Quantity::Flip, BASE),
            against("FLIP between 8 bits and f32", "", Quantity::Flip, &[("sh-precision", "u8")], BASE),
            against(
                "bytes of the scene, 8 bits / f32",
                "",
                Quantity::SceneBytes,
                &[("sh-precision", "u8")],
                BASE,
            ),
            against(
                "bytes of the scene, degree 0 / 3",
                "",
                Quantity::SceneBytes,
                &[("sh-degree", "0")],
                BASE,
            ),
        ],
        why: "Nothing to compare with was published in these texts. Scenes without spherical harmonics \
              show no difference.",
    },
    Experiment {
        name: "target",
        title: "Format of the image that splats are blended into",
        question: "Every layer is rounded when it is blended: to eight bits, to a half float's eleven, \
                   to a float's twenty-four.",
        source: "",
        sweep: Sweep {
            base: "default",
            axes: &[("target-format", &["rgba32f", "rgba8", "rgb10a2"])],
            points: &[],
        },
        rows: &[
            against("FLIP between 16-bit and 32-bit floats", "", Quantity::Flip, BASE, FLOATS),
            against(
                "FLIP between 8 bits and 32-bit floats",
                "",
                Quantity::Flip,
                &[("target-format", "rgba8")],
                FLOATS,
            ),
            against(
                "FLIP between 10 bits (2 of alpha) and 32-bit floats",
                "",
                Quantity::Flip,
                &[("target-format", "rgb10a2")],
                FLOATS,
            ),
            against(
                "frame rate of this device, 8 bits / 16-bit floats",
                "",
                Quantity::DeviceRate,
                &[("target-format", "rgba8")],
                BASE,
            ),
        ],
        why: "Nothing to compare with was published in these texts. On a tile-based device the format \
              decides how many tiles a frame takes, which a processor does not show.",
    },
];

#[cfg(test)]
mod tests {
    use super::super::sweep::{self, describe};
    use super::*;
    use motes_renderer::PRESETS;

    /// Every figure's configurations are measured by the experiment's own sweep.
    #[test]
    fn every_figure_is_measured() {
        for e in EXPERIMENTS {
            let measured: Vec<String> = e.sweep.expand().unwrap().into_iter().map(|p| p.name).collect();
            let base = (PRESETS.iter().find(|p| p.name == e.sweep.base).unwrap().config)();
            for row in e.rows {
                for changes in [Some(row.of), row.over].into_iter().flatten() {
                    let mut config = base.clone();
                    for (name, value) in changes {
                        sweep::change(&mut config, name, value).unwrap();
                    }
                    let name = describe(&config);
                    assert!(measured.contains(&name), "{}: {} needs {name}", e.name, row.what);
                }
            }
            assert!(!e.why.is_empty() && !e.question.is_empty() && !e.rows.is_empty());
            let publishes = e.rows.iter().any(|r| !r.published.is_empty());
            assert!(!publishes || !e.source.is_empty(), "{} states figures without their source", e.name);
        }
    }
}
