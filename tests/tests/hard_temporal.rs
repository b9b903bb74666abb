//! From picture to picture: no shimmer beyond a bound, and orders that are some frames old.

use motes_renderer::{LowPass, OrderKey, Projection, View};
use motes_tests::hard::rig::{PLAIN, Rig, every_layer};
use motes_tests::hard::temporal::{Movement, crowd, shimmer, stale};

#[test]
fn thin_and_distant_splats_do_not_shimmer() {
    let mut rig = Rig::new();
    for projection in [Projection::Affine, Projection::Tangent, Projection::Exact] {
        let found = shimmer(&mut rig, projection, LowPass::Planar, 17);
        println!("{projection}: {found:?}");
        assert!(found.energy < 0.02, "{projection}: energy varies by {}", found.energy);
        assert!(found.pixel < 1.5, "{projection}: a pixel changes by {} more than it should", found.pixel);
    }
    // Control: without a filter wires and specks come and go.
    let bare = shimmer(&mut rig, Projection::Tangent, LowPass::Off, 17);
    println!("no filter: {bare:?}");
    assert!(bare.energy > 0.1, "{bare:?}");
}

#[test]
fn turning_the_head_changes_no_radial_order() {
    let rig = Rig::new();
    let on_device = rig.upload(&crowd(), PLAIN);
    let mut config = every_layer(Projection::Tangent);
    let order = |view: View, config: &_| rig.order(&on_device, &[view], config).indices;
    let ahead = order(Movement::Turn.view(0), &config);
    for frames in 1..50 {
        assert_eq!(order(Movement::Turn.view(frames), &config), ahead);
    }
    assert_ne!(order(Movement::Walk.view(8), &config), ahead);
    config.order = OrderKey::Depth;
    assert_ne!(order(Movement::Turn.view(0), &config), order(Movement::Turn.view(8), &config));
}

#[test]
fn stale_orders_stay_bounded() {
    let mut rig = Rig::new();
    let ages: Vec<u32> = (0..=8).collect();
    for (movement, key, mean_bound) in [
        (Movement::Walk, OrderKey::Radial, 7.0),
        (Movement::Turn, OrderKey::Radial, 0.3),
        (Movement::Both, OrderKey::Radial, 7.0),
    ] {
        let found = stale(&mut rig, movement, key, &ages);
        let means: Vec<f64> = found.iter().map(|d| d.mean).collect();
        println!("{movement:?}, {key}: {means:.3?}");
        assert!(means.iter().all(|m| *m <= mean_bound), "{movement:?}, {key}: {means:?}");
        assert!(found[0].worst < 2.0, "the newest order is right: {:?}", found[0]);
    }
    // Control: by depth, turning alone changes the picture; and an order from far away is plainly wrong.
    let depth = stale(&mut rig, Movement::Turn, OrderKey::Depth, &[8]);
    let far = stale(&mut rig, Movement::Walk, OrderKey::Radial, &[200]);
    println!("by depth {:.3?}, from 3 s ago {:.3?}", depth[0], far[0]);
    assert!(far[0].mean > 7.0, "{far:?}");
    assert!(depth[0].worst > stale(&mut rig, Movement::Turn, OrderKey::Radial, &[8])[0].worst + 1.0);
}
