//! The structures and constants that host and shaders share, in Rust and as SPIR-V reflection sees them.

use motes_shaders::layout::{Draw, FrameData, MarkDraw, Plan, Specialization, ViewData, WORKGROUP};
use motes_shaders::modules;
use motes_tests::spirv::Specialized;
use std::collections::BTreeMap;
use std::mem::offset_of;

macro_rules! offsets {
    ($type:ty: $($field:ident),+) => {
        [$((stringify!($field).to_owned(), offset_of!($type, $field) as u32)),+].into_iter().collect::<BTreeMap<_, _>>()
    };
}

#[test]
fn structures_have_the_offsets_that_reflection_sees() {
    let project = Specialized::new(modules::PROJECT_COMP, &[]);
    let plan = Specialized::new(modules::PLAN_COMP, &[]);
    let frame = offsets!(FrameData: views, sort_center, cull, filters, counts, sampling, shown, reprojection);
    assert_eq!(project.offsets("Frame"), frame);
    assert_eq!(project.offsets("ViewData"), offsets!(ViewData: rotation, eye, tangents, image));
    let draws = offsets!(Draw: index_count, instance_count, first_index, vertex_offset, first_instance);
    assert_eq!(plan.offsets("Draw"), draws);
    let marks = offsets!(MarkDraw: vertex_count, instance_count, first_vertex, first_instance);
    assert_eq!(plan.offsets("MarkDraw"), marks);
    let mut plans = offsets!(Plan: draws, marks, starts, visible, area, unhidden, marked, blended, bin_ends);
    assert_eq!(plan.offsets("Plan"), plans);
    // Control: an offset that is off by a word is seen.
    plans.insert("area".to_owned(), offset_of!(Plan, area) as u32 + 4);
    assert_ne!(plan.offsets("Plan"), plans);
    assert_eq!(project.local_size(), Some(WORKGROUP));
}

#[test]
fn specialisation_constants_come_in_the_order_of_their_ids() {
    let fields = offsets!(Specialization: projection, low_pass, shape, radius, precision, sh_degree, sh_stored,
        sh_precision, geometry_slots, sh_slots, motion, views, composite, geometry_shift, sh_shift, sampling, lens, parts);
    assert_eq!(fields.len(), size_of::<Specialization>() / 4, "a field is missing from this list");
    let mut seen = BTreeMap::new();
    for words in [
        modules::PROJECT_COMP,
        modules::PLAN_COMP,
        modules::EMIT_COMP,
        modules::SPLAT_VERT,
        modules::INSTANCED_VERT,
        modules::SPLAT_GEOM,
        modules::SPLAT_FRAG,
    ] {
        for (constant, _, name) in Specialized::new(words, &[]).spec_ids() {
            let name = name.to_lowercase();
            assert_eq!(fields.get(&name), Some(&(4 * constant)), "{name}");
            seen.insert(name, constant);
        }
    }
    assert_eq!(seen.len(), fields.len(), "{seen:?}");
}
