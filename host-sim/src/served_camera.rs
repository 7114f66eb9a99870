//! The camera of a served arm: pictures of a door for programs that connect, as PGM one after the other.

use std::error::Error;
use std::io::{self, Write as _};
use std::os::unix::net::UnixStream;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use rapier3d::na::Isometry3;
use tesaki_description::robot::RobotFolder;
use tesaki_description::{FileError, approach};
use tesaki_supervisor::port::{Address, LocalListener, SocketFile};

use crate::camera::{CameraValues, Image};
use crate::door::{KnobDoor, hand_joints, hand_pose};
use crate::plant::{Plant, PlantOptions};

/// Ticks from picture to picture: ten a second.
pub const PICTURE_TICKS: u32 = 10;
/// Who does not read for this time is left.
const PATIENCE: Duration = Duration::from_millis(200);

/// A door for an arm, and the camera in its hand.
pub struct ServedDoor {
    /// The door.
    pub door: KnobDoor,
    camera: CameraValues,
    /// Of the tip that is the hand and of the gripper's joint.
    joints: [usize; 2],
}

impl ServedDoor {
    /// The door of a seed before the arm of `plant`, whose folder has `camera.toml` and `approach.toml`.
    ///
    /// # Errors
    /// A file cannot be used.
    pub fn draw(robot: &RobotFolder, plant: &Plant, seed: u64) -> Result<Self, FileError> {
        let camera = CameraValues::load(&robot.path)?;
        let files = approach::load(&robot.path, &robot.model)?;
        let joints = hand_joints(&robot.model, &files.task, plant);
        let door = KnobDoor::draw(seed, &hand_pose(plant, joints[0], joints[1]));
        Ok(Self { door, camera, joints })
    }

    /// The arm of these options before the door, and its camera, with pictures for who connects to `address`.
    ///
    /// # Errors
    /// The plant cannot be built, or the address cannot be listened at.
    pub fn serve(
        self,
        robot: &RobotFolder,
        options: &PlantOptions,
        address: &Address,
    ) -> Result<(Plant, ServedCamera), Box<dyn Error>> {
        let plant = Plant::of(robot, &PlantOptions { fixtures: self.door.fixtures(), ..options.clone() })?;
        Ok((plant, ServedCamera::listen(address, self.camera, self.door, self.joints)?))
    }
}

/// A camera in the hand of an arm before a door. Pictures are drawn in a thread of its own.
#[derive(Debug)]
pub struct ServedCamera {
    address: Address,
    /// Of the socket, whose listener is in the thread.
    _file: SocketFile,
    exposures: SyncSender<Exposure>,
    door: Isometry3<f64>,
    /// Index of the tip that is the hand, and of the gripper's joint.
    hand: usize,
    gripper: usize,
}

/// What a picture is drawn from.
struct Exposure {
    taken: Instant,
    number: u32,
    /// The hand in the door frame.
    hand: Isometry3<f64>,
    /// Angle of the gripper [rad].
    opening: f64,
}

impl ServedCamera {
    /// A camera whose pictures are for who connects to `address`.
    fn listen(
        address: &Address,
        values: CameraValues,
        door: KnobDoor,
        [hand, gripper]: [usize; 2],
    ) -> io::Result<Self> {
        let mut listener = LocalListener::new(address)?;
        let file = listener.take_file();
        let address = listener.address().clone();
        // One waits while another one is drawn; those that find no room are not taken.
        let (exposures, waiting) = sync_channel(1);
        let pose = door.pose.inverse();
        std::thread::spawn(move || draw(&listener, &values, &door, &waiting));
        Ok(Self { address, _file: file, exposures, door: pose, hand, gripper })
    }

    /// Where it listens.
    pub const fn address(&self) -> &Address {
        &self.address
    }

    /// Takes a picture, if one is due in this tick.
    pub fn tick(&self, plant: &Plant, tick: u32) {
        if tick.is_multiple_of(PICTURE_TICKS) {
            let exposure = Exposure {
                taken: Instant::now(),
                number: tick / PICTURE_TICKS,
                hand: self.door * hand_pose(plant, self.hand, self.gripper),
                opening: plant.truth().positions.get(self.gripper).copied().unwrap_or_default(),
            };
            let _ = self.exposures.try_send(exposure);
        }
    }
}

/// Sends every picture to all who have connected.
fn draw(listener: &LocalListener, values: &CameraValues, door: &KnobDoor, exposures: &Receiver<Exposure>) {
    let mut viewers: Vec<UnixStream> = Vec::new();
    while let Ok(Exposure { taken, number, hand, opening }) = exposures.recv() {
        while let Ok(Some(viewer)) = listener.accept(Duration::ZERO) {
            if viewer.set_write_timeout(Some(PATIENCE)).is_ok() {
                viewers.push(viewer);
            }
        }
        if viewers.is_empty() {
            continue;
        }
        let picture = door.photograph(values, &hand, opening, number);
        viewers.retain(|viewer| send(viewer, &picture, taken).is_ok());
    }
}

/// Writes a PGM picture with its age, the time since it was exposed [s].
fn send(mut viewer: &UnixStream, picture: &Image, taken: Instant) -> io::Result<()> {
    let Image { width, height, pixels } = picture;
    let header = format!("P5\n# age {:.6}\n{width} {height}\n255\n", taken.elapsed().as_secs_f64());
    let mut bytes = header.into_bytes();
    bytes.extend_from_slice(pixels);
    viewer.write_all(&bytes)
}
