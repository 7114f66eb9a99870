//! A control period of a board with sensors and drives.

use tesaki::node::Node;
use tesaki::protocol::{ActuatorFrame, Mode, SensorFrame};

use crate::board::{Board, Latch};

/// The control periods so far.
#[derive(Debug, Default)]
pub struct Periods {
    last: u32,
    /// Whether the outputs were on in the last period with sensors, and the node was not disabled since.
    drove: bool,
}

impl Periods {
    /// Creates the state before the first period.
    pub const fn new() -> Self {
        Self { last: 0, drove: false }
    }

    /// Runs control period `period`: from the sample through `tick` to the drives. A period without sensors
    /// is a tick as well: it is a fault of the node, and the outputs are off.
    ///
    /// Returns whether the watchdog may be fed: the period came in time, and its sensors could be read, or
    /// the outputs were off when they last could. So a board whose sensors fall silent while its outputs are
    /// on is reset, and then waits, disabled, for the supervisor; an idle board keeps its model.
    pub fn run<B: Board>(
        &mut self,
        board: &mut B,
        node: &mut Node,
        period: u32,
        sample: &<B::Latch as Latch>::Sample,
        tick: impl FnOnce(&mut Node, SensorFrame) -> ActuatorFrame,
    ) -> bool {
        let in_time = period == self.last.wrapping_add(1);
        self.last = period;
        let sensors = board.read(period, sample);
        let silent = sensors.is_none();
        if silent {
            B::off();
        }
        // The sequence number reveals a missed period; the node raises a fault.
        let actuators = tick(node, sensors.unwrap_or_else(|| SensorFrame::silent(period)));
        board.write(&actuators);
        if !silent || node.mode() == Mode::Disabled {
            self.drove = actuators.enabled;
        }
        in_time && (!silent || !self.drove)
    }
}
