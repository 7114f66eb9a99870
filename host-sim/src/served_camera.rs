//! The camera of a served arm: sends pictures of a door to programs that connect, as a sequence of PGM
//! images.

use std::io::{self, Write as _};
use std::os::unix::net::UnixStream;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use rapier3d::na::Isometry3;
use tesaki_supervisor::port::{Address, LocalListener, SocketFile};

use crate::camera::{CameraValues, Image};
use crate::door::{KnobDoor, hand_pose};
use crate::plant::Plant;

/// Period of the pictures: ten per second [ticks].
pub const PICTURE_TICKS: u32 = 10;
/// A client that does not read for this time is disconnected.
const PATIENCE: Duration = Duration::from_millis(200);

/// A camera in the hand of an arm in front of a door. Pictures are drawn in a separate thread.
#[derive(Debug)]
pub struct ServedCamera {
    address: Address,
    /// The socket's file; its listener is in the thread.
    _file: SocketFile,
    exposures: SyncSender<Exposure>,
    door: Isometry3<f64>,
    /// Index of the tip that is the hand, and of the gripper's joint.
    hand: usize,
    gripper: usize,
}

/// Inputs for drawing a picture.
struct Exposure {
    taken: Instant,
    number: u32,
    /// Pose of the hand in the door frame.
    hand: Isometry3<f64>,
    /// Angle of the gripper [rad].
    opening: f64,
}

impl ServedCamera {
    /// Creates a camera that sends its pictures to the clients of `address`.
    ///
    /// # Errors
    /// It cannot listen at the address.
    pub fn listen(
        address: &Address,
        values: CameraValues,
        door: KnobDoor,
        [hand, gripper]: [usize; 2],
    ) -> io::Result<Self> {
        let mut listener = LocalListener::new(address)?;
        let file = listener.take_file();
        let address = listener.address().clone();
        // One exposure waits while another is drawn; further ones are skipped.
        let (exposures, waiting) = sync_channel(1);
        let pose = door.pose.inverse();
        std::thread::spawn(move || draw(&listener, &values, &door, &waiting));
        Ok(Self { address, _file: file, exposures, door: pose, hand, gripper })
    }

    /// The address at which it listens.
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

/// Sends every picture to all connected clients.
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

/// Writes a PGM picture with its age, the time since its exposure [s].
fn send(mut viewer: &UnixStream, picture: &Image, taken: Instant) -> io::Result<()> {
    let Image { width, height, pixels } = picture;
    let header = format!("P5\n# age {:.6}\n{width} {height}\n255\n", taken.elapsed().as_secs_f64());
    let mut bytes = header.into_bytes();
    bytes.extend_from_slice(pixels);
    viewer.write_all(&bytes)
}
