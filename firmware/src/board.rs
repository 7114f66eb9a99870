//! What differs from board to board: crystal, pins, sensors, drives.
//!
//! Every pin belongs to the [`Board`], also those of the UARTs and of the strap: on one board a pin is a
//! serial line, on another it switches a power stage.

use stm32f4xx_hal::pac;
use stm32f4xx_hal::rcc::Rcc;
use tesaki::model::{Field, ModelError, Problem, RobotModel};
use tesaki::protocol::{ActuatorFrame, SensorFrame};

pub use crate::boards::ThisBoard;

/// The UART of the supervisor's line. The plant link is always USART2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SupervisorLine {
    /// USART1.
    Usart1,
    /// UART4, for boards where the pins of USART1 are others.
    Uart4,
}

/// A controller board. It is made once, by [`Board::start`], and lives as long as the firmware.
pub trait Board: Sized {
    /// Frequency of the crystal [Hz]; whole megahertz.
    const CRYSTAL: u32;
    /// Whether the board switches power stages. Such a board never uses the plant link, where torques are for
    /// a simulation.
    const HAS_POWER_STAGES: bool;

    /// Which UART the supervisor's line is.
    const SUPERVISOR: SupervisorLine;

    /// The part that the timer's interrupt calls.
    type Latch: Latch;
    /// The part that the interrupt of the converters calls.
    type CurrentControl: CurrentControl;

    /// Takes all pins. The power stages are off when it returns. The line of the supervisor
    /// ([`Board::SUPERVISOR`]) is connected, with a pull-up on its input; that of the plant link is not.
    fn start(peripherals: Peripherals) -> (Self, Self::Latch, Self::CurrentControl);

    /// Whether the strap asks for the plant link. A board without a strap leaves this and the next one as
    /// they are.
    fn is_strapped(&mut self) -> bool {
        false
    }

    /// Connects the line of the plant link (USART2), with a pull-up on its input: an open one would receive
    /// noise.
    fn connect_plant_link(&mut self) {}

    /// Prepares for a robot. It is called while the outputs are off.
    ///
    /// # Errors
    /// What the board lacks for it, by joint and field. Nothing is changed then.
    fn configure(&mut self, model: &RobotModel) -> Result<(), ModelError>;

    /// The sensors at the instant of `sample`, in period `period`; `None` when they could not be read, which
    /// is a fault that switches the outputs off.
    fn read(&mut self, period: u32, sample: &<Self::Latch as Latch>::Sample) -> Option<SensorFrame>;

    /// Sets the torques of the drives, or switches the power stages off when the frame is not enabled.
    /// Current: torque divided by `motor.torque_constant` of the model.
    fn write(&mut self, actuators: &ActuatorFrame);

    /// Switches the power stages off. Called from any context, also after a panic or a CPU fault, and before
    /// [`Board::start`].
    fn off();

    /// An edge at a line of the interrupts EXTI2 and EXTI4, which nothing delays but code with all interrupts
    /// off. With latch and current control, which can follow it at once, it must take less than a byte of the
    /// UARTs, 10.8 µs.
    ///
    /// For a board that cannot lead what trips its power stages to a timer's break input: it switches
    /// them off and takes the edge back. Or for one with a converter that tells when it has data: it takes
    /// the edge back and pends EXTI3. Without such lines it is never called.
    fn on_edge() {}

    /// EXTI3, which [`Board::on_edge`] has pended; it runs between control periods, never in one, and delays
    /// them by 70 µs at most.
    fn on_data(&mut self) {}
}

/// Reads what must be read at the instant at which the control period begins.
///
/// Only [`Board::on_edge`] has a higher priority and can delay the instant, by some instructions. The UARTs
/// wait meanwhile, as in [`CurrentControl`], which may follow at once: together they must take less than a
/// byte, 10.8 µs. 1.5 µs is a good share of it.
pub trait Latch {
    /// Raw values. [`Board::read`] turns them into a frame later.
    type Sample: Copy + Send;

    /// Reads them.
    fn latch(&mut self) -> Self::Sample;
}

/// Controls the currents, as often as the converters have sampled them.
///
/// It runs above everything but the latch and [`Board::on_edge`]. The UARTs wait meanwhile, and lose a byte
/// after 10.8 µs, in which those two must have room as well: 8 µs at most.
pub trait CurrentControl {
    /// A sample is complete.
    fn on_sample(&mut self);
}

/// Of a board that controls no currents; its converters never interrupt.
pub struct NoCurrents;

impl CurrentControl for NoCurrents {
    fn on_sample(&mut self) {}
}

/// What the boards have in common leaves these peripherals to them.
#[allow(missing_docs, reason = "the names are those of the chip")]
pub struct Peripherals {
    /// Enables and resets peripherals. Its frequencies are not those of the chip: [`crate::clock`] sets them.
    pub rcc: Rcc,
    pub exti: pac::EXTI,
    pub syscfg: pac::SYSCFG,
    pub syst: cortex_m::peripheral::SYST,
    pub gpioa: pac::GPIOA,
    pub gpiob: pac::GPIOB,
    pub gpioc: pac::GPIOC,
    pub gpiod: pac::GPIOD,
    pub tim1: pac::TIM1,
    pub tim3: pac::TIM3,
    pub tim4: pac::TIM4,
    pub tim5: pac::TIM5,
    pub tim8: pac::TIM8,
    pub adc1: pac::ADC1,
    pub adc2: pac::ADC2,
    pub adc3: pac::ADC3,
    pub adc_common: pac::ADC_COMMON,
    pub spi1: pac::SPI1,
    pub spi2: pac::SPI2,
    pub spi3: pac::SPI3,
}

/// Whether sensors and drives are on the plant link: the strap asks for it, and the board has no power
/// stages.
pub fn uses_plant_link<B: Board>(board: &mut B) -> bool {
    !B::HAS_POWER_STAGES && board.is_strapped()
}

/// What a board has for the joints of a robot; most refusals of [`Board::configure`].
#[derive(Clone, Copy, Debug)]
pub struct Equipment {
    /// Number of motors with an encoder and a current sensor each.
    pub motors: u8,
    /// Whether its encoders know their angle after power-on.
    pub absolute_encoders: bool,
    /// Number of converters for the six gauges of a force sensor.
    pub force_sensors: u8,
    /// Largest current of a motor [A].
    pub current: f32,
    /// Largest supply voltage [V].
    pub supply: f32,
}

impl Equipment {
    /// Checks that the board has what the robot needs.
    ///
    /// # Errors
    /// The first field that it lacks.
    pub fn check(&self, model: &RobotModel) -> Result<(), ModelError> {
        let refuse = |joint, field, value, limit: f32| {
            Err(ModelError { joint, field, value, problem: Problem::BoardLimit(limit) })
        };
        let joints = model.joints.len() as f32;
        for (index, joint) in (0_u8..).zip(&model.joints) {
            if index >= self.motors {
                return refuse(Some(index), Field::Joints, joints, self.motors.into());
            }
            if !joint.encoder.relative && !self.absolute_encoders {
                let (field, problem) = (Field::EncoderRelative, Problem::NotSupported);
                return Err(ModelError { joint: Some(index), field, value: 0.0, problem });
            }
            if joint.motor.current_limit > self.current {
                return refuse(Some(index), Field::CurrentLimit, joint.motor.current_limit, self.current);
            }
        }
        let mut force_sensors = 0;
        for (index, (chain, joints)) in model.chains.iter().zip(model.chain_ranges()).enumerate() {
            if chain.force_sensor.is_none() {
                continue;
            }
            force_sensors += 1;
            let last = Some(joints.end.saturating_sub(1) as u8);
            let gauges =
                |problem| Err(ModelError { joint: last, field: Field::Gauges, value: index as f32, problem });
            match model.gauges_of(index) {
                Some(_) if self.force_sensors == 0 => return gauges(Problem::NotSupported),
                _ if force_sensors > self.force_sensors => {
                    let (value, limit) = (force_sensors.into(), self.force_sensors.into());
                    return refuse(last, Field::ForceResolution, value, limit);
                }
                // Nothing of the board delivers wrenches.
                None => return gauges(Problem::Missing),
                Some(_) => {}
            }
        }
        if model.safety.supply_max > self.supply {
            return refuse(None, Field::SupplyMax, model.safety.supply_max, self.supply);
        }
        Ok(())
    }
}
