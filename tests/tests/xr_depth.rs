//! Depth for the compositor, on a real runtime with both validation layers on.
#![allow(clippy::unwrap_used, reason = "a test may")]

use motes_app::governor::Foveation;
use motes_app::headset::{Comfort, Eye, Input};
use motes_app::opened::Opened;
use motes_renderer::gpu::Gpu;
use motes_renderer::{Composite, DepthTarget, Packing, Precision, RenderConfig, ShPrecision, Target};
use motes_scenes::LoadOptions;
use motes_tests::monado::{Source, with_monado};
use motes_tests::sample;
use motes_xr::{
    Content, EyeImages, FrameTime, Headset, Quad, Runtime, RuntimeHeadset, RuntimeOptions, SessionOptions,
    Step, Viewer, XrError,
};
use std::sync::Arc;

/// A headset that says how often depth went to the compositor.
struct Watched {
    headset: RuntimeHeadset,
    /// Frames with eyes that were ended, and depth images that were given out.
    shown: u32,
    depths: u32,
}

impl Headset for Watched {
    fn gpu(&self) -> &Arc<Gpu> {
        self.headset.gpu()
    }
    fn images(&self) -> EyeImages {
        self.headset.images()
    }
    fn next(&mut self) -> Result<Step, XrError> {
        self.headset.next()
    }
    fn input(&mut self, frame: &FrameTime) -> Result<Input, XrError> {
        self.headset.input(frame)
    }
    fn eyes(&mut self, frame: &FrameTime) -> Result<Option<[Eye; 2]>, XrError> {
        self.headset.eyes(frame)
    }
    fn target(&mut self) -> Result<Target, XrError> {
        self.headset.target()
    }
    fn takes_depth(&self) -> bool {
        self.headset.takes_depth()
    }
    fn depth(&mut self, near: f32) -> Result<Option<DepthTarget>, XrError> {
        assert_eq!(near, RenderConfig::default().near);
        let depth = self.headset.depth(near)?;
        if let Some(depth) = &depth {
            assert_eq!(depth.size, self.headset.images().size);
            self.depths += 1;
        }
        Ok(depth)
    }
    fn panel(&mut self) -> Result<Option<Target>, XrError> {
        self.headset.panel()
    }
    fn image(&self) -> Option<ash::vk::Image> {
        self.headset.image()
    }
    fn foveation(&self) -> Option<Foveation> {
        self.headset.foveation()
    }
    fn end(&mut self, frame: &FrameTime, shown: Option<&[Eye; 2]>, quads: &[Quad]) -> Result<(), XrError> {
        self.shown += u32::from(shown.is_some());
        self.headset.end(frame, shown, quads)
    }
    fn request_exit(&mut self) -> Result<bool, XrError> {
        self.headset.request_exit()
    }
}

fn session(options: RuntimeOptions, depth_wanted: bool) {
    let runtime = Runtime::new(&(), options).unwrap();
    assert!(runtime.optional().depth_layer, "Monado offers XR_KHR_composition_layer_depth");
    assert!(!runtime.optional().foveation, "Monado offers no foveation");
    let absent = runtime.optional().fallbacks();
    assert!(absent.iter().any(|line| line.contains("XR_FB_foveation")), "{absent:?}");
    // Any rate: the nearest that Monado offers is asked for.
    let options = SessionOptions { resolution_scale: 0.3, refresh_rate: Some(90.0), ..Default::default() };
    let headset = RuntimeHeadset::new(runtime, &options).unwrap();
    let mut headset = Watched { headset, shown: 0, depths: 0 };
    assert_eq!((headset.takes_depth(), headset.foveation()), (depth_wanted, None));
    let opened = Opened::load(&[sample("static/fruit_drops_minimal.ply")], &LoadOptions::default()).unwrap();
    let packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };
    let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
    viewer.show(Content::new(headset.gpu(), &opened, packing).unwrap()).unwrap();
    let until = |viewer: &mut Viewer, headset: &mut Watched, frames: u64| {
        while viewer.frames() < frames {
            assert_eq!(viewer.step(headset).unwrap(), None);
        }
    };
    until(&mut viewer, &mut headset, 20);
    let expected = if depth_wanted { 20 } else { 0 };
    assert_eq!((headset.shown, headset.depths), (20, expected));
    // What does not know its depth is shown without, and back again.
    viewer.config.composite = Composite::BackToFront;
    until(&mut viewer, &mut headset, 25);
    assert_eq!((headset.shown, headset.depths), (25, expected));
    viewer.config.composite = Composite::EarlyStop;
    until(&mut viewer, &mut headset, 30);
    assert_eq!((headset.shown, headset.depths), (30, if depth_wanted { 25 } else { 0 }));
    headset.request_exit().unwrap();
    while viewer.step(&mut headset).unwrap().is_none() {}
    drop(viewer);
    let said = headset.headset.runtime().messages();
    assert!(said.is_empty(), "OpenXR's core validation complains: {said:#?}");
    let said = headset.gpu().messages();
    assert!(said.is_empty(), "Vulkan's validation complains: {said:#?}");
}

#[test]
fn the_compositor_is_given_depth_where_it_was_asked_for() {
    with_monado("the_compositor_is_given_depth_where_it_was_asked_for", Source::Simulated, || {
        let validated = RuntimeOptions { validation: true, ..Default::default() };
        session(RuntimeOptions { depth_layer: true, foveation: true, ..validated }, true);
        session(validated, false);
    });
}
