//! The identification of a hand's joints, as its user would do it.

use tesaki::protocol::{Request, Stream};
use tesaki::task::grasping::GraspTelemetry;
use tesaki_supervisor::Board;
use tesaki_supervisor::hand::FingerBoard;
use tesaki_supervisor::identify::{Identification, Machine, Sense, Settings, identified, identify};

use super::T;
use super::rig::{GraspRig, GraspedObject};
use super::trial::REST;
use crate::controller::{Controller, Watched};
use crate::motion::Motion;
use crate::plant::Plant;
use crate::scenario::common::{introduce, stopped};
use crate::scenario::{ScenarioError, Setting};

/// A board with a simulated machine.
struct Simulated<'a, 'b> {
    controller: &'a mut Watched<'b>,
    plant: Plant,
    motion: &'a mut Motion,
    progress: &'a dyn Fn(f64),
    duration: f64,
}

impl Simulated<'_, '_> {
    fn advance(&mut self) -> Result<(), ScenarioError> {
        let sequence = self.motion.tick(&self.plant.truth());
        let actuators = self.controller.tick(&self.plant.sensors(sequence))?;
        (self.progress)((f64::from(sequence) * T / self.duration).min(1.0));
        Ok(self.plant.apply(&actuators)?)
    }
}

impl Machine for Simulated<'_, '_> {
    type Error = ScenarioError;

    fn ask(&mut self, action: &'static str, request: Request) -> Result<(), ScenarioError> {
        Ok(self.controller.ask(action, request)?)
    }

    fn read_grasp(&mut self) -> Result<GraspTelemetry, ScenarioError> {
        Ok(self.controller.read_grasp()?)
    }

    fn tick(&mut self, request: Request) -> Result<Sense, ScenarioError> {
        self.controller.post(request)?;
        loop {
            self.advance()?;
            // Lost frames only make it wait.
            let news = self.controller.listen()?;
            if let (Some(telemetry), Some(tips)) = (news.telemetry, news.tips) {
                return Ok(Sense { telemetry, tips });
            }
        }
    }

    fn progress(&mut self, text: &str) {
        self.motion.note(text);
    }
}

/// Identifies the joints of the machine that `held` is in front of, and has the bench's controller use what
/// was found from now on. Returns it.
pub fn calibrate(
    setting: &mut Setting<'_, '_>,
    rig: &mut GraspRig,
    held: &GraspedObject<'_>,
) -> Result<Identification, ScenarioError> {
    let (plan, plant) = rig.set_up(held)?;
    let model = rig.robot.model.clone();
    introduce(setting.controller, &model)?;
    let mut machine = Simulated {
        controller: &mut *setting.controller,
        plant,
        motion: &mut rig.motion,
        progress: setting.progress,
        duration: setting.duration,
    };
    machine.motion.note(held.label);
    machine.advance()?;
    let homed: Vec<f32> = machine.plant.homed_positions().iter().map(|&angle| angle as f32).collect();
    machine.controller.home(&homed)?;
    for _ in 0..(REST / T).round() as usize {
        machine.advance()?;
    }
    machine.controller.tare()?;
    for stream in [Stream::Telemetry, Stream::Tips] {
        machine.controller.set_rate(stream, 1)?;
    }
    let found = identify(&mut machine, &model, &plan, &Settings::default());
    for stream in [Stream::Telemetry, Stream::Tips] {
        machine.controller.set_rate(stream, 0)?;
    }
    let found = match found {
        Err(ScenarioError::Identify(error)) => {
            let time = f64::from(rig.motion.ticks()) * T;
            let why = stopped(setting.controller, &model, held.label, time);
            return Err(
                if let ScenarioError::Fault { fault, .. } = &why
                    && !fault.is_empty()
                {
                    why
                } else {
                    error.into()
                },
            );
        }
        found => found?,
    };
    identified(&model, &found.fits).apply(&mut rig.robot.model)?;
    setting.controller.disable()?;
    Ok(found)
}
