//! The activity's life cycle.

use android_activity::{AndroidApp, MainEvent, PollEvent};

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
    log::warn!("this version shows nothing: the session in the headset is not connected yet");
    until_destroyed(&app);
    log::info!("Motes ends");
}

/// Follows the life cycle until the system ends the activity. Sleeps between events.
fn until_destroyed(app: &AndroidApp) {
    let mut destroyed = false;
    while !destroyed {
        app.poll_events(None, |event| {
            let PollEvent::Main(event) = event else { return };
            match event {
                MainEvent::Resume { .. } => log::info!("resumed"),
                MainEvent::Pause => log::info!("paused"),
                MainEvent::LowMemory => log::warn!("the system is short of memory"),
                MainEvent::Destroy => destroyed = true,
                _ => {}
            }
        });
    }
}
