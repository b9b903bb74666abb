//! Monado, a real OpenXR runtime, for tests: its service, and test bodies that run with it in a process of their own.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// How long anything may take that takes well below a second on an idle machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// Tells a test process that it is the one in which the body runs.
const INSIDE: &str = "MOTES_TEST_INSIDE";

/// What moves the head and the hands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Monado's simulated headset and two simple controllers.
    Simulated,
    /// Whoever connects to this port of the machine.
    Remote(u16),
}

/// Where what the eyes see is shown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Compositor {
    /// Nowhere.
    Nothing,
    /// In a window on the X display of this name, both eyes side by side.
    Window(String),
}

/// The service, with a folder of its own.
pub struct Monado {
    service: Child,
    folder: PathBuf,
    source: Source,
    compositor: Compositor,
}

impl Monado {
    /// Starts the service, with a compositor that shows nothing.
    ///
    /// # Panics
    /// Where it does not start: such a machine cannot test the headset, and must not seem to.
    pub fn start(source: Source) -> Self {
        Self::start_with(source, Compositor::Nothing)
    }

    /// Starts the service with a compositor of this kind.
    ///
    /// # Panics
    /// As [`Monado::start`].
    #[allow(clippy::expect_used, reason = "only tests call it")]
    pub fn start_with(source: Source, compositor: Compositor) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let unique = format!("motes-xr-{}-{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let folder = std::env::temp_dir().join(unique);
        std::fs::create_dir_all(folder.join("config/monado")).expect("a folder for the service");
        let private = std::fs::Permissions::from_mode(0o700);
        std::fs::set_permissions(&folder, private).expect("a private folder for the service");
        if let Source::Remote(port) = source {
            let remote = format!(r#"{{"version": 0, "port": {port}, "view_count": 2}}"#);
            let text = format!(r#"{{"active": "remote", "remote": {remote}}}"#);
            std::fs::write(folder.join("config/monado/config_v0.json"), text)
                .expect("the service's settings");
        }
        let service = serve(&folder, source, &compositor);
        Self { service, folder, source, compositor }
    }

    /// Kills the service as a crash would.
    #[allow(clippy::expect_used, reason = "only tests call it")]
    pub fn kill(&mut self) {
        self.service.kill().expect("the service can be killed");
        let _ = self.service.wait();
    }

    /// Starts the service again, after it was killed, for the same clients.
    pub fn restart(&mut self) {
        // A killed service leaves its socket.
        let _ = std::fs::remove_file(self.folder.join("monado_comp_ipc"));
        self.service = serve(&self.folder, self.source, &self.compositor);
    }

    /// What a client's process needs to know.
    pub fn environment(&self) -> Vec<(&'static str, OsString)> {
        let mut variables = vec![("XDG_RUNTIME_DIR", self.folder.clone().into())];
        if let Source::Remote(port) = self.source {
            variables.push(("MOTES_TEST_PORT", port.to_string().into()));
        }
        variables
    }

    /// Ends the service as its user would, and says how it ended.
    ///
    /// # Panics
    /// Where it does not end.
    #[allow(clippy::expect_used, reason = "only tests call it")]
    pub fn stop(&mut self) -> ExitStatus {
        if let Some(mut input) = self.service.stdin.take() {
            let _ = input.write_all(b"\n");
        }
        let begun = Instant::now();
        loop {
            if let Some(status) = self.service.try_wait().expect("the service can be waited for") {
                return status;
            }
            assert!(begun.elapsed() < PATIENCE, "the service does not end");
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for Monado {
    fn drop(&mut self) {
        let _ = self.service.kill();
        let _ = self.service.wait();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// A program through the runner of the pinned driver, where there is one.
fn through_runner(program: OsString) -> Command {
    match std::env::var_os("MOTES_RUNNER") {
        Some(runner) => {
            let mut command = Command::new(runner);
            command.arg(program);
            command
        }
        None => Command::new(program),
    }
}

#[allow(clippy::expect_used, clippy::panic, reason = "only tests call it")]
fn serve(folder: &Path, source: Source, compositor: &Compositor) -> Child {
    let Some(program) = std::env::var_os("MOTES_MONADO_SERVICE") else {
        panic!("MOTES_MONADO_SERVICE is not set: run the tests by `cargo xtask test`");
    };
    let mut command = through_runner(program);
    command
        .env("XDG_RUNTIME_DIR", folder)
        .env("XDG_CONFIG_HOME", folder.join("config"))
        .env("HOME", folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    match source {
        Source::Simulated => {
            command
                .env("SIMULATED_ENABLE", "1")
                .env("SIMULATED_LEFT", "simple")
                .env("SIMULATED_RIGHT", "simple");
        }
        Source::Remote(_) => {
            command.env("P_OVERRIDE_ACTIVE_CONFIG", "remote");
        }
    }
    match compositor {
        Compositor::Nothing => command.env("XRT_COMPOSITOR_NULL", "1"),
        Compositor::Window(display) => command.env("XRT_COMPOSITOR_FORCE_XCB", "1").env("DISPLAY", display),
    };
    let mut service = command.spawn().expect("the service starts");
    let errors = service.stderr.take().expect("the service's messages");
    let (heard, said) = channel();
    std::thread::spawn(move || {
        // Read to the end: a full pipe would stop the service.
        for line in BufReader::new(errors).lines().map_while(Result::ok) {
            let _ = heard.send(line);
        }
    });
    let mut before = String::new();
    loop {
        match said.recv_timeout(PATIENCE) {
            Ok(line) if line.contains("service has started") => return service,
            Ok(line) => before += &(line + "\n"),
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {
                let _ = service.kill();
                panic!("Monado's service did not start:\n{before}");
            }
        }
    }
}

/// A free port of this machine.
///
/// # Panics
/// Where there is none.
#[allow(clippy::expect_used, reason = "only tests call it")]
pub fn free_port() -> u16 {
    let listener = std::net::TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
    listener.local_addr().expect("the port's number").port()
}

/// Whether this process is the one in which a test's body runs.
pub fn inside() -> bool {
    std::env::var_os(INSIDE).is_some()
}

/// The running test once more, in a process of its own where [`inside`] holds: a runtime's client reads the environment
/// and keeps threads and sockets for as long as its process lives.
pub struct Inside {
    process: Child,
    lines: Receiver<String>,
    said: String,
}

impl Inside {
    /// Starts it.
    ///
    /// # Panics
    /// Where no process can be had.
    #[allow(clippy::expect_used, reason = "only tests call it")]
    pub fn start(test: &str, environment: &[(&'static str, OsString)]) -> Self {
        // Not `current_exe`: through the runner that would be the dynamic loader.
        let program = std::env::args_os().next().expect("the test program's name");
        let mut process = through_runner(program)
            .args([test, "--exact", "--nocapture", "--test-threads=1"])
            .env(INSIDE, "1")
            .envs(environment.iter().map(|(name, value)| (name, value)))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the test's own process starts");
        let (heard, lines) = channel();
        let outputs: [Box<dyn Read + Send>; 2] = [
            Box::new(process.stdout.take().expect("the process's output")),
            Box::new(process.stderr.take().expect("the process's messages")),
        ];
        for output in outputs {
            let heard = heard.clone();
            std::thread::spawn(move || {
                for line in BufReader::new(output).lines().map_while(Result::ok) {
                    let _ = heard.send(line);
                }
            });
        }
        Self { process, lines, said: String::new() }
    }

    /// Waits until it says something.
    ///
    /// # Panics
    /// Where it never does, with all that it said.
    #[allow(clippy::panic, reason = "only tests call it")]
    pub fn wait_for(&mut self, text: &str) {
        loop {
            match self.lines.recv_timeout(PATIENCE) {
                Ok(line) => {
                    self.said += &(line.clone() + "\n");
                    if line.contains(text) {
                        return;
                    }
                }
                Err(_) => panic!("it never said '{text}':\n{}", self.said),
            }
        }
    }

    /// Waits for its end, which must be a success; returns what it said.
    ///
    /// # Panics
    /// Where it failed, with all that it said.
    #[allow(clippy::expect_used, reason = "only tests call it")]
    pub fn finish(mut self) -> String {
        while let Ok(line) = self.lines.recv_timeout(PATIENCE) {
            self.said += &(line + "\n");
        }
        let status = self.process.wait().expect("the process can be waited for");
        let said = std::mem::take(&mut self.said);
        assert!(status.success(), "{status}\n{said}");
        // A misspelt name would run no test, and succeed.
        assert!(said.contains("1 passed"), "the test did not run inside:\n{said}");
        println!("{said}");
        said
    }
}

impl Drop for Inside {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Sends the log where [`Inside`] hears it.
pub fn log_to_stderr() {
    let _ = env_logger::Builder::new().filter_level(log::LevelFilter::Info).try_init();
}

/// Runs a test's body in a process of its own, with a service.
///
/// # Panics
/// Where the body fails, or the service does not end cleanly.
pub fn with_monado(test: &str, source: Source, body: impl FnOnce()) {
    if inside() {
        log_to_stderr();
        return body();
    }
    let mut monado = Monado::start(source);
    Inside::start(test, &monado.environment()).finish();
    let status = monado.stop();
    assert!(status.success(), "the service ended with {status}");
}
