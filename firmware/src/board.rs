//! The [`Board`] trait: what differs between boards, namely crystal, pins, sensors and drives.
//!
//! Every pin belongs to the [`Board`], including those of the UARTs and the strap, because a pin that is a
//! serial line on one board switches a power stage on another.

use core::f32::consts::TAU;

use stm32f4xx_hal::pac;
use tesaki::model::{Field, ModelError, Problem, RobotModel};
use tesaki::protocol::{ActuatorFrame, SensorFrame};

pub use crate::boards::ThisBoard;
use crate::clock::Clocks;

/// The UART of the supervisor's line. The plant link is always USART2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SupervisorLine {
    /// USART1.
    Usart1,
    /// UART4, for boards that use the pins of USART1 otherwise.
    Uart4,
}

/// A controller board. It is made once, by [`Board::start`], and lives as long as the firmware.
pub trait Board: Sized {
    /// Frequency of the crystal [Hz]; whole megahertz.
    const CRYSTAL: u32;
    /// Whether the board switches power stages. Such a board never uses the plant link, whose torques are
    /// meant for a simulation.
    const HAS_POWER_STAGES: bool;

    /// The UART of the supervisor's line.
    const SUPERVISOR: SupervisorLine;

    /// The part that the timer's interrupt calls.
    type Latch: Latch;
    /// The part that the ADC interrupt calls.
    type CurrentControl: CurrentControl;

    /// Takes all pins. The power stages are off when it returns. The line of the supervisor
    /// ([`Board::SUPERVISOR`]) is connected, with a pull-up on its input; that of the plant link is not.
    fn start(peripherals: Peripherals) -> (Self, Self::Latch, Self::CurrentControl);

    /// Returns whether the strap requests the plant link. A board without a strap keeps the defaults of this
    /// function and of [`Board::connect_plant_link`].
    fn is_strapped(&mut self) -> bool {
        false
    }

    /// Connects the line of the plant link (USART2), with a pull-up on its input: an open input would receive
    /// noise.
    fn connect_plant_link(&mut self) {}

    /// Prepares the board for a robot. Called while the outputs are off.
    ///
    /// # Errors
    /// What the board lacks for this robot, by joint and field. Nothing is changed then.
    fn configure(&mut self, model: &RobotModel) -> Result<(), ModelError>;

    /// Returns the sensor values at the instant of `sample`, in period `period`, or `None` if they could not
    /// be read, which is a fault that switches the outputs off.
    fn read(&mut self, period: u32, sample: &<Self::Latch as Latch>::Sample) -> Option<SensorFrame>;

    /// Sets the torques of the drives, or switches the power stages off when the frame is not enabled. The
    /// current of a drive is its torque divided by the model's `motor.torque_constant`.
    fn write(&mut self, actuators: &ActuatorFrame);

    /// Switches the power stages off. Called from any context, also after a panic or a CPU fault, and before
    /// [`Board::start`].
    fn off();

    /// Handles an edge on a line of EXTI2 or EXTI4. Only code with all interrupts off can delay it. Latch and
    /// current control can follow at once, and all three together must take less than a byte of the UARTs,
    /// 10.8 µs.
    ///
    /// A board whose trip lines reach no timer's break input switches the power stages off here and clears
    /// the edge. A board with a converter that signals new data clears the edge and pends EXTI3. Without such
    /// lines it is never called.
    fn on_edge() {}

    /// Handles EXTI3, which [`Board::on_edge`] has pended. It runs between control periods, never within one,
    /// and delays them by at most 70 µs.
    fn on_data(&mut self) {}
}

/// Samples what must be read at the instant at which a control period begins.
///
/// Only [`Board::on_edge`] has a higher priority; it can delay the instant by a few instructions. The UARTs
/// wait meanwhile, as they do for [`CurrentControl`], which may follow at once: together they must take less
/// than a byte, 10.8 µs. Latching should take at most 1.5 µs of that.
pub trait Latch {
    /// Raw values. [`Board::read`] turns them into a frame later.
    type Sample: Copy + Send;

    /// Reads the raw values.
    fn latch(&mut self) -> Self::Sample;
}

/// Controls the currents, once per sample of the converters.
///
/// It preempts everything but the latch and [`Board::on_edge`]. The UARTs wait meanwhile and lose a byte
/// after 10.8 µs. Those two must fit into that time as well, so current control may take at most 8 µs.
pub trait CurrentControl {
    /// Called when a sample is complete.
    fn on_sample(&mut self);

    /// Returns where the converters are in their period, if they run: they and the control period have the
    /// same clock, and the boot chooses how one lies in the other.
    fn phase(&self) -> Option<Phase> {
        None
    }
}

/// Where the converters are in their period.
#[derive(Clone, Copy, Debug)]
pub struct Phase {
    /// Time since the last trigger [counts of 168 MHz].
    pub since: u32,
    /// Time from one trigger to the next [counts of 168 MHz].
    pub period: u32,
}

/// For a board that controls no currents; its converters never interrupt.
pub struct NoCurrents;

impl CurrentControl for NoCurrents {
    fn on_sample(&mut self) {}
}

/// The peripherals that the common code leaves to the boards.
#[allow(missing_docs, reason = "the names are those of the chip")]
pub struct Peripherals<'a> {
    /// Enables and resets peripherals. Lent, so that no board makes the HAL's `Rcc` of it: that one's
    /// frequencies are those after a reset, and drivers that compute their rates from it would be too fast.
    pub rcc: &'a mut pac::RCC,
    /// The frequencies.
    pub clocks: Clocks,
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

/// Returns whether sensors and drives are on the plant link: the strap requests it, and the board has no
/// power stages.
pub fn uses_plant_link<B: Board>(board: &mut B) -> bool {
    !B::HAS_POWER_STAGES && board.is_strapped()
}

/// The equipment of a board. Its check makes most of the refusals of [`Board::configure`].
#[derive(Clone, Copy, Debug)]
pub struct Equipment {
    /// Number of motors with an encoder and a current sensor each.
    pub motors: u8,
    /// Whether the encoders are absolute, that is, know their angle after power-on.
    pub absolute_encoders: bool,
    /// Largest rate of an encoder's counts [1/s]; the inputs lose counts of a faster one.
    pub count_rate: f32,
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
    /// The first field of the model that the board does not support.
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
            let counts = self.count_rate * TAU / joint.limits.velocity;
            if joint.encoder.counts_per_turn > counts {
                return refuse(Some(index), Field::CountsPerTurn, joint.encoder.counts_per_turn, counts);
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
                // The board has no other source of wrenches.
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
