//! Half floats with subnormals flushed to zero, and layers added up in every target format.

use motes_renderer::{Composite, Packing, Precision, Projection, RenderConfig, TargetFormat};
use motes_tests::hard::colour::layer_error;
use motes_tests::hard::precision::{half, naive, naive_alpha, quantities};
use motes_tests::hard::rig::{PLAIN, Rig, deviation, every_layer, truth};
use motes_tests::hard::scene::{Gaussian, ahead, scene};

#[test]
fn halves_stay_within_their_bounds() {
    let mut wrong = Vec::new();
    for q in quantities() {
        println!("{}: {:.5} of {:.5} {}", q.name, q.worst, q.bound, q.unit);
        // A bound far too wide says nothing.
        if !(q.worst <= q.bound && q.worst >= q.bound / 20.0) {
            wrong.push(format!("{}: {} of {} {}", q.name, q.worst, q.bound, q.unit));
        }
    }
    // Controls: what is not kept in halves would break the same bounds.
    for q in naive() {
        println!("naive: {}: {:.4} of {:.4} {}", q.name, q.worst, q.bound, q.unit);
        if !(q.worst > q.bound) {
            wrong.push(format!("naive {}: {} within {} {}", q.name, q.worst, q.bound, q.unit));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert_eq!(half(6.0e-5), 0.0, "the model flushes");
    assert!(half(6.2e-5) > 0.0);
}

/// The Quest report's halo: with every step in half floats a splat of more than 16 px has a determinant beyond 65504, its
/// conic is zero, and the whole quad is as opaque as the centre: near splats become white squares. More than 256 px
/// beside the centre the square of the distance overflows too, the result is no number, and the splat ends: the border.
#[test]
fn the_halo_is_the_determinant() {
    let exact = |v: f64| v;
    let at = |sigma: f64, in_sigmas: f64, round: &dyn Fn(f64) -> f64| {
        naive_alpha([sigma, sigma], [in_sigmas * sigma, 0.0], 0.8, round)
    };
    for sigma in [2.0, 8.0, 15.0] {
        let (got, wanted) = (at(sigma, 2.0, &half).unwrap(), at(sigma, 2.0, &exact).unwrap());
        assert!((got - wanted).abs() < 0.01, "{sigma} px: {got} {wanted}");
    }
    for sigma in [17.0, 40.0, 100.0] {
        let (got, wanted) = (at(sigma, 2.0, &half).unwrap(), at(sigma, 2.0, &exact).unwrap());
        assert!(wanted < 0.12 && got > 0.79, "{sigma} px: {got} {wanted}");
    }
    assert_eq!(at(200.0, 2.0, &half), None);
}

/// Done right, stored halves and arithmetic in f32, there is none: a splat of 2 to 400 px.
#[test]
fn halves_done_right_have_no_halo() {
    let mut rig = Rig::new();
    let views = [ahead([64, 48], 90.0)];
    let mut config = every_layer(Projection::Tangent);
    for &projection in &[Projection::Affine, Projection::Tangent] {
        config.projection = projection;
        for size in [0.1f32, 0.8, 3.0, 30.0] {
            let g = Gaussian { scales: [size, 0.8 * size, 0.6 * size], ..Gaussian::tilted() };
            let splats = scene(&[g.at([0.3, 0.1, 2.0])]);
            let on_device = rig.upload(&splats, Packing { precision: Precision::F16, ..PLAIN });
            let (pictures, _) = rig.draw(&on_device, &views, &config).unwrap();
            let found = deviation(&pictures, &truth(&splats, &views, &config)).worst;
            assert!(found < 1.5, "{projection}, {size} m: {found}");
        }
    }
}

/// 1 to 10 000 layers in one pixel, each target format in the direction in which it can be used.
#[test]
fn layers_add_up_within_their_bounds() {
    let mut rig = Rig::new();
    let config = |composite| RenderConfig { composite, ..every_layer(Projection::Tangent) };
    let stacks = [(1, 0.5), (10, 0.3), (100, 0.05), (1000, 0.2), (1000, 0.008), (10_000, 0.0045)];
    for (target, composite, bound) in [
        (TargetFormat::Rgba16F, Composite::EarlyStop, 12.0),
        (TargetFormat::Rgba16F, Composite::BackToFront, 12.0),
        (TargetFormat::Rgb10A2, Composite::BackToFront, 90.0),
        (TargetFormat::Rgba8, Composite::BackToFront, 90.0),
    ] {
        let mut worst = 0.0f64;
        for (count, opacity) in stacks {
            let found = layer_error(&mut rig, count, opacity, target, &config(composite));
            println!("{target}, {composite}, {count} of {opacity}: {found:.2}");
            worst = worst.max(found);
        }
        assert!(worst <= bound, "{target}, {composite}: {worst}");
    }
    // Control: every layer front to back, without a stop, drifts in half floats too.
    let drift = layer_error(&mut rig, 1000, 0.2, TargetFormat::Rgba16F, &config(Composite::FrontToBack));
    assert!(drift > 12.0, "front to back: {drift}");
}
