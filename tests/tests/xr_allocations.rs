//! In the steady state the frame loop allocates nothing on the session's thread, on a real runtime; and what it costs.
#![allow(clippy::unwrap_used, reason = "a test may")]

use motes_app::headset::{Comfort, Eye, Input};
use motes_app::opened::Opened;
use motes_renderer::gpu::Gpu;
use motes_renderer::{Packing, Precision, RenderConfig, ShPrecision, Target};
use motes_scenes::LoadOptions;
use motes_tests::monado::{Source, with_monado};
use motes_tests::sample;
use motes_xr::{
    Content, EyeImages, FrameTime, Headset, HiddenArea, Quad, Runtime, RuntimeHeadset, RuntimeOptions,
    SessionOptions, Step, Viewer, XrError,
};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;

/// Counts what each thread allocates.
struct Counting;

thread_local! {
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    // A thread that is ending has no counter any more, and is not counted.
    let _ = COUNT.try_with(|c| c.set(c.get() + 1));
}

// SAFETY: everything is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Processor time of this thread, microseconds: waiting, and other programs, do not count.
fn busy() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the structure is written by the call.
    let result = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    assert_eq!(result, 0);
    time.tv_sec as f64 * 1e6 + time.tv_nsec as f64 / 1e3
}

/// A headset that tells the runtime's calls, and drawing between taking the image and ending the frame, from all else.
struct Watched {
    headset: RuntimeHeadset,
    calls: f64,
    /// From the input to the eyes: the driver's fence, queries and command buffer, and moving the user.
    beginning: f64,
    drawing: f64,
}

impl Watched {
    fn call<T>(&mut self, call: impl FnOnce(&mut RuntimeHeadset) -> T) -> T {
        let begun = busy();
        let result = call(&mut self.headset);
        self.calls += busy() - begun;
        result
    }
}

impl Headset for Watched {
    fn gpu(&self) -> &Arc<Gpu> {
        self.headset.gpu()
    }
    fn images(&self) -> EyeImages {
        self.headset.images()
    }
    fn next(&mut self) -> Result<Step, XrError> {
        self.call(Headset::next)
    }
    fn input(&mut self, frame: &FrameTime) -> Result<Input, XrError> {
        let input = self.call(|headset| headset.input(frame));
        self.beginning -= busy();
        input
    }
    fn eyes(&mut self, frame: &FrameTime) -> Result<Option<[Eye; 2]>, XrError> {
        self.beginning += busy();
        self.call(|headset| headset.eyes(frame))
    }
    fn hidden(&mut self) -> Result<Option<HiddenArea>, XrError> {
        self.call(Headset::hidden)
    }
    fn target(&mut self) -> Result<Target, XrError> {
        let target = self.call(Headset::target);
        self.drawing -= busy();
        target
    }
    fn panel(&mut self) -> Result<Option<Target>, XrError> {
        self.call(Headset::panel)
    }
    fn image(&self) -> Option<ash::vk::Image> {
        self.headset.image()
    }
    fn end(&mut self, frame: &FrameTime, shown: Option<&[Eye; 2]>, quads: &[Quad]) -> Result<(), XrError> {
        self.drawing += busy();
        self.call(|headset| headset.end(frame, shown, quads))
    }
    fn request_exit(&mut self) -> Result<bool, XrError> {
        self.headset.request_exit()
    }
}

#[test]
fn the_steady_state_allocates_nothing() {
    with_monado("the_steady_state_allocates_nothing", Source::Simulated, || {
        let runtime = Runtime::new(&(), RuntimeOptions::default()).unwrap();
        let options = SessionOptions { resolution_scale: 0.3, ..Default::default() };
        let headset = RuntimeHeadset::new(runtime, &options).unwrap();
        let mut headset = Watched { headset, calls: 0.0, beginning: 0.0, drawing: 0.0 };
        let path = sample("static/fruit_drops_minimal.ply");
        let opened = Opened::load(&[path], &LoadOptions::default()).unwrap();
        let packing = Packing { precision: Precision::F32, sh_precision: ShPrecision::F32, sh_degree: 0 };
        let mut viewer = Viewer::new(&headset, RenderConfig::default(), Comfort::default()).unwrap();
        viewer.show(Content::new(headset.gpu(), &opened, packing).unwrap()).unwrap();
        // Until everything is made once: pipelines, framebuffers of each image, the orders that travel round.
        while viewer.frames() < 40 {
            viewer.step(&mut headset).unwrap();
        }
        let mut frames = Vec::with_capacity(60);
        let mut frames_cost = Vec::with_capacity(60);
        let mut own = Vec::with_capacity(60);
        let mut calls = Vec::with_capacity(60);
        let mut begun_drawing = Vec::with_capacity(60);
        let mut drawn = Vec::with_capacity(60);
        let mut orders = 0;
        let mut used = viewer.last_frame().unwrap().used;
        while viewer.frames() < 100 {
            (headset.calls, headset.beginning, headset.drawing) = (0.0, 0.0, 0.0);
            let (before, begun) = (COUNT.get(), busy());
            viewer.step(&mut headset).unwrap();
            frames.push(COUNT.get() - before);
            let all = busy() - begun - headset.drawing;
            frames_cost.push(all);
            own.push(all - headset.calls - headset.beginning);
            calls.push(headset.calls);
            begun_drawing.push(headset.beginning);
            drawn.push(headset.drawing);
            let now = viewer.last_frame().unwrap().used;
            orders += u32::from(now != used);
            used = now;
        }
        // Printed, not judged: times are the machine's, and tests run on any.
        let parts = [
            ("a frame without drawing", &mut frames_cost),
            ("of that within the runtime's calls", &mut calls),
            ("of that beginning a command buffer", &mut begun_drawing),
            ("the rest, the loop's own", &mut own),
            ("recording and submitting the drawing", &mut drawn),
        ];
        for (what, values) in parts {
            values.sort_by(f64::total_cmp);
            let [low, middle, high, largest] = [15, 30, 45, 59].map(|i| values[i]);
            println!(
                "{what}: median {middle:.0} µs, quartiles {low:.0} and {high:.0} µs, largest {largest:.0} µs"
            );
        }
        assert!(orders > 10, "the simulated head moves, so orders are made: {orders}");
        assert!(frames.iter().all(|count| *count == 0), "{frames:?}");
        // Control: the counter counts.
        let before = COUNT.get();
        drop(std::hint::black_box(vec![1u8; 100]));
        assert_eq!(COUNT.get() - before, 1);
        drop(viewer);
    });
}
