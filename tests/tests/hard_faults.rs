//! What can go wrong around a frame: devices that offer less, scenes that are too large, memory that ends, files that go,
//! no Vulkan at all; and scenes that would take seconds a frame.
#![allow(clippy::unwrap_used, reason = "a test may")]

use std::ffi::CString;
use std::process::Command;
use std::sync::{Arc, Mutex};

use motes_renderer::gpu::{Bootstrap, Buffer, Capabilities, Gpu, GpuError, GpuOptions, Plain};
use motes_renderer::{
    CostSample, Expansion, Offscreen, Projection, RenderConfig, SceneOnDevice, Stereo, View,
};
use motes_scenes::synthetic::Recipe;
use motes_scenes::{LoadOptions, Splats};
use motes_tests::TestGpu;
use motes_tests::hard::rig::{PLAIN, every_layer};
use motes_tests::hard::scene::{Gaussian, ahead, eyes, scene};

/// The device of the environment with less on offer.
struct Lesser(Plain, fn(&mut Capabilities));

impl Bootstrap for Lesser {
    fn instance_extensions(&self) -> Vec<CString> {
        self.0.instance_extensions()
    }
    fn device_extensions(&self) -> Vec<CString> {
        self.0.device_extensions()
    }
    fn create_instance(
        &self,
        entry: &ash::Entry,
        info: &ash::vk::InstanceCreateInfo<'_>,
    ) -> Result<ash::Instance, GpuError> {
        self.0.create_instance(entry, info)
    }
    fn choose(
        &self,
        entry: &ash::Entry,
        instance: &ash::Instance,
    ) -> Result<(ash::vk::PhysicalDevice, u32), GpuError> {
        self.0.choose(entry, instance)
    }
    fn create_device(
        &self,
        instance: &ash::Instance,
        physical: ash::vk::PhysicalDevice,
        info: &ash::vk::DeviceCreateInfo<'_>,
    ) -> Result<ash::Device, GpuError> {
        self.0.create_device(instance, physical, info)
    }
    fn restrict(&self, capabilities: &mut Capabilities) {
        self.1(capabilities);
    }
}

/// A lesser device with validation; its messages are checked by [`quiet`].
fn lesser(restrict: fn(&mut Capabilities)) -> Arc<Gpu> {
    Gpu::new(&Lesser(Plain::default(), restrict), &GpuOptions { validation: true }).unwrap()
}

fn quiet(gpu: &Gpu) {
    assert!(gpu.messages().is_empty(), "the validation layer complains:\n{}", gpu.messages().join("\n"));
}

fn crowd(count: usize) -> Splats {
    Recipe { count, sh_degree: 1, seed: 4, log_scales: [-4.6, -3.5], ..Default::default() }.still()
}

fn back(views: &[View]) -> Vec<View> {
    views.iter().map(|v| View { eye: v.eye - 2.5 * glam::DVec3::Z, ..*v }).collect()
}

#[test]
fn streams_are_split_at_the_limit() {
    let splats = crowd(3000);
    let views = back(&[ahead([32, 24], 60.0)]);
    let config = every_layer(Projection::Tangent);
    let gpu = TestGpu::new();
    let whole = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    assert_eq!(whole.geometry.buffers.len(), 1);
    let (wanted, _) = Offscreen::new(&gpu).unwrap().render(&whole, &views, &config).unwrap();
    drop(whole);
    // 56 bytes of geometry and 36 of harmonics a splat; a record takes 32.
    let small = lesser(|c| c.max_storage_range = 100 << 10);
    let split = SceneOnDevice::new(&small, &splats, PLAIN).unwrap();
    assert!(split.geometry.buffers.len() > 1 && split.harmonics.buffers.len() > 1);
    let (got, _) = Offscreen::new(&small).unwrap().render(&split, &views, &config).unwrap();
    assert_eq!(got, wanted, "bit for bit");
    quiet(&small);
    // Control: without the second binding's splats it is another picture.
    let fewer = SceneOnDevice::new(&gpu, &crowd(1024), PLAIN).unwrap();
    assert_ne!(Offscreen::new(&gpu).unwrap().render(&fewer, &views, &config).unwrap().0, wanted);
}

#[test]
fn scenes_beyond_every_binding_are_refused() {
    let gpu = lesser(|c| c.max_storage_range = 64 << 10);
    let error = SceneOnDevice::new(&gpu, &crowd(9000), PLAIN).err().unwrap().to_string();
    for word in ["9000 splats", "splat geometry", "504000 bytes", "262144", "At most 4096 splats fit"] {
        assert!(error.contains(word), "“{word}” is missing in: {error}");
    }
    // What fits where it is stored, but not where it is projected: at the frame.
    let views = back(&[ahead([16, 12], 60.0)]);
    let scene = SceneOnDevice::new(&gpu, &crowd(3000), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let error =
        offscreen.render(&scene, &views, &every_layer(Projection::Tangent)).err().unwrap().to_string();
    assert!(error.contains("records") && error.contains("At most 2048 splats fit"), "{error}");
    // And the renderer goes on with what does fit.
    let less = SceneOnDevice::new(&gpu, &crowd(1000), PLAIN).unwrap();
    assert!(offscreen.render(&less, &views, &every_layer(Projection::Tangent)).is_ok());
    quiet(&gpu);
}

#[test]
fn a_device_that_offers_little_draws_the_same() {
    let splats = crowd(300);
    let views = back(&eyes([24, 20]));
    let mut config = every_layer(Projection::Tangent);
    let gpu = TestGpu::new();
    let scene = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let (wanted, report) = Offscreen::new(&gpu).unwrap().render(&scene, &views, &config).unwrap();
    assert!(report.fragments > 0 && report.device_ns() > 0.0);
    drop(scene);
    let little = lesser(|c| {
        c.multiview = false;
        c.geometry_shader = false;
        c.pipeline_statistics = false;
        c.timestamp_period = 0.0;
        c.shader_float16 = false;
        c.storage_16bit = false;
    });
    let told = little.capabilities.fallbacks().join("\n");
    for word in ["multiview", "geometry", "statistics", "timestamps"] {
        assert!(told.contains(word), "“{word}” is missing in: {told}");
    }
    let scene = SceneOnDevice::new(&little, &splats, PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&little).unwrap();
    let (got, report) = offscreen.render(&scene, &views, &config).unwrap();
    assert_eq!(got, wanted, "two passes and no extras, bit for bit");
    assert_eq!((report.fragments, report.device_ns()), (0, 0.0));
    // What it lacks is refused by name, not replaced.
    offscreen.set_stereo(Stereo::Multiview);
    let error = offscreen.render(&scene, &views, &config).err().unwrap().to_string();
    assert!(error.contains("multiview") && error.contains("two passes"), "{error}");
    config.expansion = Expansion::Geometry;
    let error = offscreen.render(&scene, &views[..1], &config).err().unwrap().to_string();
    assert!(error.contains("no geometry stage") && error.contains("instanced"), "{error}");
    quiet(&little);
}

#[test]
fn impossible_sizes_are_refused_and_the_next_frame_is_drawn() {
    let gpu = TestGpu::new();
    let scene = SceneOnDevice::new(&gpu, &crowd(50), PLAIN).unwrap();
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    let config = every_layer(Projection::Tangent);
    for size in [[0, 0], [0, 10], [10, 0], [1 << 20, 4]] {
        let view = View { size, ..back(&[ahead([8, 8], 60.0)])[0] };
        let error = offscreen.render(&scene, &[view], &config).err().unwrap().to_string();
        assert!(error.contains(&format!("{} x {}", size[0], size[1])), "{error}");
    }
    let none = offscreen.render(&scene, &[], &config).err().unwrap().to_string();
    assert!(none.contains("one view or two"), "{none}");
    let one = back(&[ahead([1, 1], 60.0)]);
    assert_eq!(offscreen.render(&scene, &one, &config).unwrap().0[0].pixels.len(), 1);
}

#[test]
fn memory_that_ends_is_an_error_with_its_purpose() {
    // No validation: the layer would rightly say that so large a buffer cannot be.
    let gpu = Gpu::offscreen(&GpuOptions { validation: false }).unwrap();
    let wish = 1u64 << 46;
    let usage = ash::vk::BufferUsageFlags::STORAGE_BUFFER;
    let location = gpu_allocator::MemoryLocation::GpuOnly;
    let error = Buffer::new(&gpu, "a wish", wish, usage, location).err().unwrap();
    let text = error.to_string();
    assert!(matches!(error, GpuError::Memory { .. } | GpuError::Call { .. }), "{text}");
    assert!(text.contains("a wish") || text.contains("MEMORY") || text.contains("memory"), "{text}");
    // The device is as usable as before.
    assert!(Buffer::new(&gpu, "a need", 1 << 10, usage, location).is_ok());
}

#[test]
fn lost_devices_and_ends_of_memory_say_what_to_do() {
    let text = |result| GpuError::Call { call: "vkQueueSubmit", result }.to_string();
    let lost = text(ash::vk::Result::ERROR_DEVICE_LOST);
    assert!(lost.contains("vkQueueSubmit") && lost.contains("restart"), "{lost}");
    let full = text(ash::vk::Result::ERROR_OUT_OF_DEVICE_MEMORY);
    assert!(full.contains("smaller scene"), "{full}");
    assert!(!text(ash::vk::Result::NOT_READY).contains("restart"));
}

/// In a process of its own, because a process loads Vulkan once.
#[test]
fn no_driver_is_an_error_with_a_remedy() {
    if std::env::var_os("MOTES_WITHOUT_DRIVER").is_some() {
        match Gpu::offscreen(&GpuOptions::default()) {
            Ok(_) => println!("there is a driver"),
            Err(e) => println!("refused: {e}"),
        }
        return;
    }
    // Not the current executable: that is the dynamic loader where tests run through one.
    let this = std::env::args_os().next().unwrap();
    let run = |drivers: Option<&str>| {
        let mut command = match std::env::var_os("MOTES_RUNNER") {
            Some(runner) => {
                let mut command = Command::new(runner);
                command.arg(&this);
                command
            }
            None => Command::new(&this),
        };
        command.args(["--exact", "no_driver_is_an_error_with_a_remedy", "--nocapture"]);
        command.env("MOTES_WITHOUT_DRIVER", "1");
        if let Some(drivers) = drivers {
            // The loader's names for its list of drivers, old and new.
            command.env("VK_ICD_FILENAMES", drivers).env("VK_DRIVER_FILES", drivers);
        }
        let output = command.output().unwrap();
        assert!(output.status.success());
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let without = run(Some("/nowhere/no-driver.json"));
    assert!(without.contains("refused:") && without.contains("mesa-vulkan-drivers"), "{without}");
    assert!(run(None).contains("there is a driver"));
}

#[test]
fn a_file_that_vanishes_while_it_is_loaded() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("gone.ply");
    let splats = crowd(20_000);
    motes_scenes::save(&path, &splats).unwrap();
    let gone = Arc::new(Mutex::new(Some(path.clone())));
    let remove = gone.clone();
    let options = LoadOptions {
        progress: Some(Arc::new(move |_| {
            if let Some(path) = remove.lock().unwrap().take() {
                std::fs::remove_file(path).unwrap();
            }
        })),
        ..Default::default()
    };
    // An open file stays whole where the system keeps it (Unix); elsewhere it is an error that names it.
    match motes_scenes::load(&path, &options) {
        Ok(scene) => assert_eq!(scene.splats.len(), 20_000),
        Err(e) => assert!(e.to_string().contains("gone.ply"), "{e}"),
    }
    assert!(gone.lock().unwrap().is_none() && !path.exists());
    let error = motes_scenes::load(&path, &LoadOptions::default()).err().unwrap().to_string();
    assert!(error.contains("gone.ply"), "{error}");
}

/// Splats that each fill the screen: 10⁵ of them would take lavapipe minutes a frame.
fn flood(count: usize) -> Splats {
    let one = |i: usize| Gaussian {
        mean: [0.3 * (i as f32).sin(), 0.2 * (i as f32 * 0.7).cos(), 2.0 + i as f32 * 1e-5],
        scales: [1.2, 0.9, 0.5],
        opacity: 0.03,
        ..Gaussian::tilted()
    };
    scene(&(0..count).map(one).collect::<Vec<_>>())
}

#[test]
fn a_flood_is_predicted_before_it_is_drawn() {
    let gpu = TestGpu::new();
    let config = RenderConfig { near: 0.05, ..every_layer(Projection::Tangent) };
    let mut offscreen = Offscreen::new(&gpu).unwrap();
    // Where it can be counted, the prediction is right within a third: a flood, and an ordinary scene.
    let views = [ahead([64, 48], 60.0)];
    for splats in [flood(200), crowd(3000)] {
        let views = if splats.len() == 200 { views.to_vec() } else { back(&views) };
        let scene = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
        let (_, report) = offscreen.render(&scene, &views, &config).unwrap();
        let predicted = CostSample::of(&splats).predict(&views, &config).fragments;
        let ratio = predicted / report.fragments as f64;
        println!("{} splats: {predicted:.0} predicted, {} counted", splats.len(), report.fragments);
        assert!((0.67..1.5).contains(&ratio), "{predicted} predicted, {} counted", report.fragments);
    }
    // The whole flood, at a headset's size: known to be hopeless without drawing it, and drawn in a form that is not.
    let splats = flood(100_000);
    let sample = CostSample::of(&splats);
    let headset = [ahead([1680, 1760], 90.0), ahead([1680, 1760], 90.0)];
    let predicted = sample.predict(&headset, &config);
    assert!(predicted.fragments > 1e11 && predicted.layers > 2e4, "{predicted:?}");
    let budget = 40.0 * 64.0 * 48.0;
    let budgeted = sample.budgeted(&views, &config, budget).expect("a form that fits");
    assert!(budgeted.max_radius < 0.5);
    let scene = SceneOnDevice::new(&gpu, &splats, PLAIN).unwrap();
    let (_, report) = offscreen.render(&scene, &views, &budgeted).unwrap();
    println!("budget {budget}, drawn {} (max-radius {})", report.fragments, budgeted.max_radius);
    assert!((report.fragments as f64) < 1.5 * budget, "{} of {budget}", report.fragments);
    // Control: an ordinary scene is left as it is.
    let plain = CostSample::of(&crowd(3000)).budgeted(&back(&views), &config, 1e9).unwrap();
    assert_eq!(plain, config);
}
