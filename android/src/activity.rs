//! The activity's life cycle.

use std::ffi::CStr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use android_activity::{AndroidApp, MainEvent, PollEvent};
use motes_app::headset::HeadsetSettings;
use motes_app::loader::{SceneSource, Storage};
use motes_app::lod::Tuning;
use motes_renderer::RenderConfig;
use motes_renderer::plan::Overrides;
use motes_scenes::sample;
use motes_xr::bindings::Bindings;
use motes_xr::{Platform, RuntimeOptions, SessionOptions, ShowError, ShowOptions, Visit, scenes_in, show};

use crate::report;

/// The sample among the APK's assets.
const SAMPLE: &CStr = c"plant.spz";

/// Called by android-activity on a thread of its own once the activity is created; called again when the
/// activity is started again in the same process.
// SAFETY: no other item of the program has this name, which android-activity looks for.
#[unsafe(no_mangle)]
fn android_main(app: AndroidApp) {
    report::start(app.external_data_path());
    log::info!("Motes {} starts", env!("CARGO_PKG_VERSION"));
    match app.external_data_path() {
        Some(folder) => log::info!("files of this app: {}", folder.display()),
        None => log::warn!("this device offers no external files folder: no scenes can be pushed with adb"),
    }
    let visit = visit(&app);
    match visit {
        Ok(visit) => log::info!("{} frames were shown", visit.frames),
        Err(error) => log::error!("{error}"),
    }
    log::info!("Motes ends");
}

/// Shows the first scene of the app's folder, or the sample, until the user leaves or the system ends the activity.
fn visit(app: &AndroidApp) -> Result<Visit, ShowError> {
    // SAFETY: both pointers are the activity's own, and live as long as `app`.
    let platform = unsafe { Platform::new(app.vm_as_ptr(), app.activity_as_ptr()) };
    provide_sample(app);
    let folder = app.external_data_path();
    let scenes = folder.as_deref().map(|folder| folder.join("scenes"));
    if let Some(scenes) = &scenes {
        // So that the place to push scenes to is there from the first start on.
        if let Err(error) = std::fs::create_dir_all(scenes) {
            log::warn!("{}: {error}", scenes.display());
        }
    }
    let settings = settings(folder.as_deref());
    let config = RenderConfig::default();
    let options = ShowOptions {
        // The first by name; none stands for the sample.
        source: SceneSource::Files(
            scenes.as_deref().map(scenes_in).unwrap_or_default().into_iter().take(1).collect(),
        ),
        // What a scene calls for, and no more: memory and bandwidth are short here.
        storage: Storage::Planned(Overrides::default()),
        comfort: settings.comfort,
        budget: settings.budget,
        detail_target: Tuning::default().target,
        pipelines: app.internal_data_path().map(|folder| folder.join("pipelines")),
        session: SessionOptions {
            resolution_scale: config.resolution_scale,
            left_handed: settings.comfort.left_handed,
            bindings: settings.bindings,
            whole_images: false,
            refresh_rate: settings.refresh_rate,
        },
        config: RenderConfig { resolution_scale: 1.0, ..config },
        runtime: RuntimeOptions {
            depth_layer: settings.depth_layer,
            foveation: settings.foveation,
            ..RuntimeOptions::default()
        },
        record: None,
        frames: 0,
        patience: Duration::from_secs(60),
        folder: scenes,
        thumbnails: app.internal_data_path().map(|folder| folder.join("thumbnails")),
        measurements: folder.as_deref().map(|folder| folder.join("measurements")),
        report: folder.as_deref().map(|folder| folder.join("device.json")),
    };
    let mut destroyed = false;
    show(&platform, &options, &mut || {
        follow_life_cycle(app, &mut destroyed);
        destroyed
    })
}

/// The sample is an asset of the APK: one file that the system maps, not a part of the library.
fn provide_sample(app: &AndroidApp) {
    match app.asset_manager().open(SAMPLE).as_mut().map(|asset| asset.buffer().map(Arc::from)) {
        Some(Ok(bytes)) => sample::provide(bytes),
        Some(Err(error)) => log::error!("the sample cannot be read: {error}"),
        None => log::error!("the APK holds no sample ({})", SAMPLE.to_string_lossy()),
    }
}

/// The headset's settings beside the scenes; the defaults where they cannot be used, which the log says.
fn settings(folder: Option<&Path>) -> HeadsetSettings<Bindings> {
    let Some(folder) = folder else { return HeadsetSettings::default() };
    HeadsetSettings::load(&folder.join("headset.json")).unwrap_or_else(|error| {
        log::error!("{error}. The defaults are used");
        HeadsetSettings::default()
    })
}

/// Follows the life cycle without waiting: frames are what the thread waits for.
fn follow_life_cycle(app: &AndroidApp, destroyed: &mut bool) {
    app.poll_events(Some(Duration::ZERO), |event| {
        let PollEvent::Main(event) = event else { return };
        match event {
            MainEvent::Resume { .. } => log::info!("resumed"),
            MainEvent::Pause => log::info!("paused"),
            MainEvent::LowMemory => log::warn!("the system is short of memory"),
            MainEvent::Destroy => *destroyed = true,
            _ => {}
        }
    });
}
