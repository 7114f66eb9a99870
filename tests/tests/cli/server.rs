//! The program under test, and a simulated board for it to talk to.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tesaki_description::robot::RobotFolder;
use tesaki_sim::plant::{Plant, PlantOptions};
use tesaki_sim::scenario::scene::around_object;
use tesaki_sim::serve::{home_command, serve};
use tesaki_sim::served_camera::ServedDoor;
use tesaki_sim::virtual_board::VirtualBoard;
use tesaki_supervisor::hub::Hub;
use tesaki_supervisor::port::Address;

pub fn hand3() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3")
}

pub fn arm7() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/arm7")
}

/// What `host-sim serve` runs, in a thread.
pub struct Server {
    pub address: Address,
    pub terminal: PathBuf,
    pub home: Vec<String>,
    trouble: Sender<String>,
    pub stop: Arc<AtomicBool>,
    pub thread: Option<JoinHandle<Plant>>,
    pub folder: tempfile::TempDir,
}

impl Server {
    pub fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self::start_at(folder)
    }

    pub fn start_at(folder: tempfile::TempDir) -> Self {
        Self::start_with(folder, &PlantOptions::mismatched(1))
    }

    /// Homed, tared, and with the fingers open around where a box is to be grasped.
    pub fn ready_to_grasp(with_box: bool) -> Self {
        let robot = RobotFolder::load(&hand3()).unwrap();
        let [grasp, object] = ["grasps/box.toml", "objects/box.toml"].map(|file| hand3().join(file));
        let object = with_box.then_some(&*object);
        let options = around_object(PlantOptions::mismatched(1), &robot.model, &grasp, object).unwrap();
        let server = Self::start_with(tempfile::tempdir().unwrap(), &options);
        server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
        server.home();
        server
    }

    fn start_with(folder: tempfile::TempDir, options: &PlantOptions) -> Self {
        Self::start_robot(&hand3(), folder, options)
    }

    /// An arm on the board, with a longer command timeout.
    pub fn ready_arm() -> Self {
        let options = PlantOptions::mismatched(1);
        let server = Self::start_robot(&arm7(), tempfile::tempdir().unwrap(), &options);
        server.succeeds(&["model", "push", arm7().to_str().unwrap()]);
        server.succeeds(&["set", "safety.command_timeout", "1"]);
        server
    }

    /// An arm before a door, with a longer command timeout; the pictures of its camera are at `camera` in the
    /// folder.
    pub fn before_door(seed: u64) -> Self {
        let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/knob-arm");
        let options = PlantOptions::mismatched(1);
        let server = Self::serve(&robot, tempfile::tempdir().unwrap(), &options, Some(seed));
        server.succeeds(&["model", "push", robot.to_str().unwrap()]);
        server.succeeds(&["set", "safety.command_timeout", "1"]);
        server
    }

    /// Of any robot folder; not homed, without a model.
    pub fn start_robot(folder_of_robot: &Path, folder: tempfile::TempDir, options: &PlantOptions) -> Self {
        Self::serve(folder_of_robot, folder, options, None)
    }

    fn serve(
        folder_of_robot: &Path,
        folder: tempfile::TempDir,
        options: &PlantOptions,
        door: Option<u64>,
    ) -> Self {
        let robot = RobotFolder::load(folder_of_robot).unwrap();
        let mut plant = Plant::of(&robot, options).unwrap();
        let camera = door.map(|seed| {
            let door = ServedDoor::draw(&robot, &plant, seed).unwrap();
            let address = Address::Unix(folder.path().join("camera"));
            let (before_door, camera) = door.serve(&robot, options, &address).unwrap();
            plant = before_door;
            camera
        });
        let mut hub = Hub::listen(&Address::Unix(folder.path().join("board")), None).unwrap();
        let address = hub.address().clone();
        let terminal = hub.add_pty().unwrap();
        let home = home_command(&plant, &robot.model).unwrap_or_default();
        let home = home.split(' ').skip(1).map(str::to_owned).collect();
        let stop = Arc::new(AtomicBool::new(false));
        let (trouble, lines) = channel();
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let mut board = VirtualBoard::default();
            let stop = || flag.load(Ordering::Relaxed);
            serve(&mut hub, &mut board, &mut plant, &robot.model, camera.as_ref(), &lines, &stop).unwrap();
            plant
        });
        Self { address, terminal, home, trouble, stop, thread: Some(thread), folder }
    }

    /// With a model on the board, and homed.
    pub fn ready() -> Self {
        let server = Self::start();
        server.succeeds(&["model", "push", hand3().to_str().unwrap()]);
        server.home();
        server
    }

    /// Homes, and allows a busy machine more than the 100 ms between two commands that a real one has to
    /// keep.
    pub fn home(&self) {
        // Absolute encoders need no homing.
        if !self.home.is_empty() {
            self.succeeds(&self.home.iter().map(String::as_str).collect::<Vec<_>>());
        }
        self.succeeds(&["set", "safety.command_timeout", "1"]);
    }

    /// Stops the board. Returns the machine as it was then.
    pub fn stop(mut self) -> Plant {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap()
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = tesaki_tests::tesaki();
        command.env("TESAKI_PORT", self.address.to_string()).args(arguments).stdin(Stdio::null());
        command
    }

    pub fn run(&self, arguments: &[&str]) -> (i32, String) {
        said(&finish(self.start_command(arguments)))
    }

    #[track_caller]
    pub fn succeeds(&self, arguments: &[&str]) -> String {
        let (code, text) = self.run(arguments);
        assert_eq!(code, 0, "{arguments:?}: {text}");
        text
    }

    /// Waits until what fell without power has come to rest: no board enables what swings.
    #[track_caller]
    pub fn wait_for_rest(&self) {
        let deadline = Instant::now() + Duration::from_secs(60);
        // What begins to fall, or turns back, is slow too.
        let mut resting = 0;
        while resting < 5 {
            let state = self.json(&["read"]);
            let mut joints = state["joints"].as_array().unwrap().iter();
            let rests = joints.all(|joint| joint["velocity"].as_f64().unwrap().abs() < 0.1);
            resting = if rests { resting + 1 } else { 0 };
            assert!(Instant::now() < deadline, "never at rest: {state}");
            std::thread::sleep(Duration::from_millis(100));
        }
    }

    /// Fails with this exit code and says this.
    #[track_caller]
    pub fn fails(&self, arguments: &[&str], code: i32, words: &[&str]) {
        let (got, text) = self.run(arguments);
        assert_eq!(got, code, "{arguments:?}: {text}");
        for word in words {
            assert!(text.contains(word), "{arguments:?}: no {word:?} in: {text}");
        }
    }

    pub fn start_command(&self, arguments: &[&str]) -> Child {
        let mut command = self.command(arguments);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    pub fn make_trouble(&self, line: &str) {
        self.trouble.send(line.to_owned()).unwrap();
        std::thread::sleep(Duration::from_millis(60));
    }

    pub fn json(&self, arguments: &[&str]) -> serde_json::Value {
        let mut all = vec!["--json"];
        all.extend(arguments);
        serde_json::from_str(&self.succeeds(&all)).unwrap()
    }

    /// The same, if the command succeeds: before a task was enabled there is no status.
    pub fn status(&self, task: &str) -> Option<serde_json::Value> {
        let (code, text) = self.run(&["--json", task, "status"]);
        assert!(code == 0 || (code == 7 && text.contains("no task was enabled")), "{text}");
        if code == 0 { Some(serde_json::from_str(&text).unwrap()) } else { None }
    }

    /// Waits until the board is in this mode. The time is for a busy machine.
    #[track_caller]
    pub fn wait_for(&self, mode: &str) {
        let deadline = Instant::now() + Duration::from_secs(60);
        while Instant::now() < deadline {
            if self.succeeds(&["info"]).contains(&format!("mode           {mode}")) {
                return;
            }
            std::thread::sleep(Duration::from_millis(30));
        }
        panic!("never {mode}");
    }

    /// Waits until the board has had so many faults.
    #[track_caller]
    pub fn wait_for_faults(&self, number: u64) {
        let deadline = Instant::now() + Duration::from_secs(60);
        while self.json(&["faults"])["total"].as_u64().unwrap() < number {
            assert!(Instant::now() < deadline, "never {number} faults");
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Waits until the board is in this mode, while the command goes on. Returns the command.
    #[track_caller]
    pub fn wait_with(&self, mut child: Child, mode: &str) -> Child {
        while !self.succeeds(&["info"]).contains(&format!("mode           {mode}")) {
            if child.try_wait().unwrap().is_some() {
                panic!("never {mode}: {:?}", said(&finish(child)));
            }
            std::thread::sleep(Duration::from_millis(30));
        }
        child
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the command said. One that does not end is a failure, and says so too.
pub fn finish(child: Child) -> Output {
    let pid = nix::unistd::Pid::from_raw(i32::try_from(child.id()).unwrap());
    let (done, waiting) = channel::<()>();
    let watchdog = std::thread::spawn(move || {
        if waiting
            .recv_timeout(Duration::from_secs(120))
            .is_err_and(|error| error == RecvTimeoutError::Timeout)
        {
            let _ = nix::sys::signal::kill(pid, nix::sys::signal::Signal::SIGKILL);
        }
    });
    let output = child.wait_with_output().unwrap();
    drop(done);
    watchdog.join().unwrap();
    output
}

/// What a command said on standard error when nobody reads its output any more.
pub fn unread(mut child: Child) -> (i32, String) {
    drop(child.stdout.take());
    said(&finish(child))
}

pub fn said(output: &Output) -> (i32, String) {
    let text = [&output.stdout[..], &output.stderr[..]].concat();
    (output.status.code().unwrap_or(-1), String::from_utf8(text).unwrap())
}

pub fn signal(child: &Child, signal: nix::sys::signal::Signal) {
    let pid = nix::unistd::Pid::from_raw(i32::try_from(child.id()).unwrap());
    nix::sys::signal::kill(pid, signal).unwrap();
}
