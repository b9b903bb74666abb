//! What nobody sees of an eye's image is not shaded, and what is seen stays the same bit for bit.
#![allow(clippy::unwrap_used, reason = "a test may")]

use motes_app::framing::Framing;
use motes_app::viewer::eyes;
use motes_renderer::{
    Composite, Offscreen, Packing, Precision, RenderConfig, SceneOnDevice, ShPrecision, Sorter, Stereo,
};
use motes_scenes::settings::Settings;
use motes_scenes::synthetic::Recipe;
use motes_tests::TestGpu;

const SIZE: [u32; 2] = [96, 64];
const PACKING: Packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };

/// A rectangle as two triangles.
fn rectangle([left, up]: [f32; 2], [right, down]: [f32; 2]) -> [[f32; 2]; 6] {
    [[left, up], [right, up], [right, down], [left, up], [right, down], [left, down]]
}

#[test]
fn hidden_parts_show_the_background_and_nothing_else_changes() {
    let gpu = TestGpu::new();
    let splats = Recipe { count: 4000, ..Recipe::default() }.still();
    let scene = SceneOnDevice::new(&gpu, &splats, PACKING).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let pair = eyes(&Framing::of(&splats, &Settings::default()).view(0.5, 0.3, 0.6, SIZE), 0.063);
    // Of the left eye the left half, of the right eye the upper one.
    let hidden = [rectangle([-1.0, -1.0], [0.0, 1.0]), rectangle([-1.0, -1.0], [1.0, 0.0])];
    let is_hidden = |eye: usize, i: usize| {
        let (x, y) = (i as u32 % SIZE[0], i as u32 / SIZE[0]);
        if eye == 0 { x < SIZE[0] / 2 } else { y < SIZE[1] / 2 }
    };
    let plain = RenderConfig { background: [1.0, 0.0, 1.0], ..RenderConfig::default() };
    let kinds = [
        ("early stop", Composite::EarlyStop, Sorter::Cpu, true),
        ("stochastic", Composite::FrontToBack, Sorter::Stochastic, true),
        // No depth attachment: everything is drawn.
        ("front to back", Composite::FrontToBack, Sorter::Cpu, false),
    ];
    for (kind, composite, sorter, closes) in kinds {
        let config = RenderConfig { composite, sorter, samples: 2, ..plain.clone() };
        for stereo in [Stereo::Multiview, Stereo::TwoPass] {
            offscreen.set_stereo(stereo);
            offscreen.renderer().hide([&[], &[]]).unwrap();
            let (whole, before) = offscreen.render(&scene, &pair, &config).unwrap();
            offscreen.renderer().hide([&hidden[0], &hidden[1]]).unwrap();
            let (seen, after) = offscreen.render(&scene, &pair, &config).unwrap();
            println!(
                "{kind}, {stereo:?}: {} fragments, {} with hidden parts",
                before.fragments, after.fragments
            );
            for eye in 0..2 {
                let mut drawn_there = 0;
                for (i, (a, b)) in whole[eye].pixels.iter().zip(&seen[eye].pixels).enumerate() {
                    if closes && is_hidden(eye, i) {
                        assert_eq!(*b, [255, 0, 255, 255], "{kind}, {stereo:?}, eye {eye}, pixel {i}");
                        drawn_there += usize::from(a != b);
                    } else {
                        assert_eq!(a, b, "{kind}, {stereo:?}, eye {eye}, pixel {i}");
                    }
                }
                // Control: without hidden parts the scene is seen there.
                assert!(!closes || drawn_there > 200, "{kind}, eye {eye}: {drawn_there}");
            }
            let share = after.fragments as f64 / before.fragments as f64;
            assert!(if closes { share < 0.8 } else { share == 1.0 }, "{kind}: {share}");
        }
    }
}
