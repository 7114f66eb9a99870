//! What a board must offer to the control task. Drivers for real encoders and amplifiers implement [`Board`].

use embedded_hal::digital::InputPin;
use tesaki::protocol::{ActuatorFrame, SensorFrame};

/// Sensors and drives.
pub trait Board {
    /// Whether the board switches the supply of its power stages. Such a board never takes part in the plant link,
    /// where torques come from a simulation.
    const OWNS_GATE_DRIVERS: bool;

    /// Reads all sensors at the instant numbered `sequence`; `None` while they do not work.
    fn read(&mut self, sequence: u32) -> Option<SensorFrame>;

    /// Passes the torques on to the drives: as currents, torque over `motor.torque_constant` of the model.
    fn write(&mut self, actuators: &ActuatorFrame);

    /// Puts the power stages off, from any context: panic and CPU faults end here.
    fn outputs_off();
}

/// The microcontroller alone: no sensors, so that its node is never armed, and no drives.
pub struct BareBoard;

impl Board for BareBoard {
    const OWNS_GATE_DRIVERS: bool = false;

    fn read(&mut self, _sequence: u32) -> Option<SensorFrame> {
        None
    }

    fn write(&mut self, _actuators: &ActuatorFrame) {}

    fn outputs_off() {}
}

/// The board that this image is for.
pub type ThisBoard = BareBoard;

/// Whether sensors and drives are on the plant link: the strap is tied to ground at boot, and the board has no power
/// stages of its own.
pub fn wants_plant_link<B: Board>(strap: &mut impl InputPin) -> bool {
    !B::OWNS_GATE_DRIVERS && strap.is_low().unwrap_or(false)
}
