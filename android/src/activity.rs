//! The activity's life cycle.

use std::path::{Path, PathBuf};
use std::time::Duration;

use android_activity::{AndroidApp, MainEvent, PollEvent};
use motes_app::headset::HeadsetSettings;
use motes_renderer::{Packing, RenderConfig};
use motes_scenes::Format;
use motes_xr::bindings::Bindings;
use motes_xr::{Platform, RuntimeOptions, SceneSource, SessionOptions, ShowError, ShowOptions, Visit, show};

use crate::report;

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
    let folder = app.external_data_path();
    let settings = settings(folder.as_deref());
    let config = RenderConfig::default();
    let options = ShowOptions {
        source: SceneSource::Files(scene(folder.as_deref()).into_iter().collect()),
        packing: Packing::of_config(&config),
        comfort: settings.comfort,
        budget: settings.budget,
        pipelines: app.internal_data_path().map(|folder| folder.join("pipelines")),
        session: SessionOptions {
            resolution_scale: config.resolution_scale,
            left_handed: settings.comfort.left_handed,
            bindings: settings.bindings,
        },
        config: RenderConfig { resolution_scale: 1.0, ..config },
        runtime: RuntimeOptions::default(),
        record: None,
        frames: 0,
        patience: Duration::from_secs(60),
    };
    let mut destroyed = false;
    show(&platform, &options, &mut || {
        follow_life_cycle(app, &mut destroyed);
        destroyed
    })
}

/// The first scene of the folder that scenes are pushed to, by name; none where there is none: the sample.
fn scene(folder: Option<&Path>) -> Option<PathBuf> {
    let folder = folder?.join("scenes");
    let entries = match std::fs::read_dir(&folder) {
        Ok(entries) => entries,
        Err(error) => {
            log::info!("{}: {error}; the sample is shown", folder.display());
            return None;
        }
    };
    let mut scenes: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| Format::is_scene_name(path))
        .collect();
    scenes.sort();
    log::info!("{} scenes in {}", scenes.len(), folder.display());
    scenes.into_iter().next()
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
