//! The microcontroller alone, without drives and without sensors: its node can be enabled only on the plant
//! link.
//!
//! | pin | use |
//! |---|---|
//! | PA9, PA10 | USART1 TX, RX: supervisor |
//! | PA2, PA3 | USART2 TX, RX: plant link; untouched unless the strap asks for it |
//! | PB12 | strap: to ground at boot for the plant link; open (pulled up) otherwise |

use stm32f4xx_hal::gpio::{Input, PA2, PA3, PB12, Pull};
use stm32f4xx_hal::prelude::*;
use tesaki::model::{ModelError, RobotModel};
use tesaki::protocol::{ActuatorFrame, SensorFrame};

use crate::board::{Board, Latch, NoCurrents, Peripherals, SupervisorLine};

/// See the module.
pub struct Bare {
    strap: PB12<Input>,
    plant_link: Option<(PA2, PA3)>,
}

impl Board for Bare {
    const CRYSTAL: u32 = 8_000_000;
    const HAS_POWER_STAGES: bool = false;
    const SUPERVISOR: SupervisorLine = SupervisorLine::Usart1;

    type Latch = NoSensors;
    type CurrentControl = NoCurrents;

    fn start(peripherals: Peripherals<'_>) -> (Self, NoSensors, NoCurrents) {
        let gpio_a = peripherals.gpioa.split(peripherals.rcc);
        let gpio_b = peripherals.gpiob.split(peripherals.rcc);
        gpio_a.pa9.into_alternate::<7>();
        gpio_a.pa10.into_alternate::<7>().internal_resistor(Pull::Up);
        let strap = gpio_b.pb12.into_pull_up_input();
        cortex_m::asm::delay(1000); // settling time of the pull-up
        (Self { strap, plant_link: Some((gpio_a.pa2, gpio_a.pa3)) }, NoSensors, NoCurrents)
    }

    fn is_strapped(&mut self) -> bool {
        self.strap.is_low()
    }

    fn connect_plant_link(&mut self) {
        if let Some((transmit, receive)) = self.plant_link.take() {
            transmit.into_alternate::<7>();
            receive.into_alternate::<7>().internal_resistor(Pull::Up);
        }
    }

    /// Accepts any robot: the plant link has sensors and drives for all.
    fn configure(&mut self, _model: &RobotModel) -> Result<(), ModelError> {
        Ok(())
    }

    fn read(&mut self, _period: u32, (): &()) -> Option<SensorFrame> {
        None
    }

    fn write(&mut self, _actuators: &ActuatorFrame) {}

    fn off() {}
}

/// The latch of a board without sensors.
pub struct NoSensors;

impl Latch for NoSensors {
    type Sample = ();

    fn latch(&mut self) {}
}
