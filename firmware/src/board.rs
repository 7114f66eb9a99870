//! Interface of the control task to sensors and drives. Drivers for encoders and amplifiers implement
//! [`Board`].

use embedded_hal::digital::InputPin;
use tesaki::protocol::{ActuatorFrame, SensorFrame};

/// Sensors and drives.
pub trait Board {
    /// Whether the board controls power stages. Such a board never uses the plant link, where torques are for
    /// a simulation.
    const OWNS_GATE_DRIVERS: bool;

    /// Reads all sensors in period `sequence`; `None` while they are not ready.
    fn read(&mut self, sequence: u32) -> Option<SensorFrame>;

    /// Sets the torques of the drives. Current: torque divided by `motor.torque_constant` of the model.
    fn write(&mut self, actuators: &ActuatorFrame);

    /// Switches the power stages off. Called from any context, also after a panic or a CPU fault.
    fn outputs_off();
}

/// The microcontroller alone, without drives and without sensors, so its node cannot be enabled.
pub struct BareBoard;

impl Board for BareBoard {
    const OWNS_GATE_DRIVERS: bool = false;

    fn read(&mut self, _sequence: u32) -> Option<SensorFrame> {
        None
    }

    fn write(&mut self, _actuators: &ActuatorFrame) {}

    fn outputs_off() {}
}

/// The board of this image.
pub type ThisBoard = BareBoard;

/// Whether sensors and drives are on the plant link: the strap is grounded at boot, and the board has no
/// power stages.
pub fn uses_plant_link<B: Board>(strap: &mut impl InputPin) -> bool {
    !B::OWNS_GATE_DRIVERS && strap.is_low().unwrap_or(false)
}
