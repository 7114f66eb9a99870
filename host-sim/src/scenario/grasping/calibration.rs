//! Identification of the joints of a simulated hand, as `tesaki identify` does it.

use tesaki::protocol::{Request, Stream};
use tesaki::task::grasping::GraspTelemetry;
use tesaki_supervisor::Board;
use tesaki_supervisor::hand::FingerBoard;
use tesaki_supervisor::identify::{Identification, Machine, Sense, Settings, identified, identify};

use super::rig::{GraspRig, GraspedObject};
use super::trial::REST;
use crate::controller::Watched;
use crate::motion::Motion;
use crate::plant::Plant;
use crate::scenario::common::{T, fault_error, home, introduce, tick};
use crate::scenario::{ScenarioError, Setting};

/// A controller with a simulated machine.
pub struct SimulatedMachine<'a, 'b> {
    pub controller: &'a mut Watched<'b>,
    pub plant: Plant,
    pub motion: &'a mut Motion,
    pub progress: &'a dyn Fn(f64),
    /// Simulated time of the scenario [s].
    pub duration: f64,
}

impl SimulatedMachine<'_, '_> {
    /// One control period.
    pub fn advance(&mut self) -> Result<(), ScenarioError> {
        let sequence = tick(self.controller, &mut self.plant, self.motion)?;
        (self.progress)((f64::from(sequence) * T / self.duration).min(1.0));
        Ok(())
    }
}

impl Machine for SimulatedMachine<'_, '_> {
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
            // A lost frame only costs another tick.
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

/// Identifies the joints of the machine that grasps `held`. Later trials of the rig use the identified model.
/// Returns the identification.
pub fn calibrate(
    setting: &mut Setting<'_, '_>,
    rig: &mut GraspRig,
    held: &GraspedObject<'_>,
) -> Result<Identification, ScenarioError> {
    let (plan, plant) = rig.set_up(held)?;
    let model = rig.robot.model.clone();
    introduce(setting.controller, &model)?;
    let mut machine = SimulatedMachine {
        controller: &mut *setting.controller,
        plant,
        motion: &mut rig.motion,
        progress: setting.progress,
        duration: setting.duration,
    };
    machine.motion.note(held.label);
    machine.advance()?;
    home(machine.controller, &machine.plant)?;
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
            let fault = fault_error(setting.controller, &model, held.label, time);
            let is_known = matches!(&fault, ScenarioError::Fault { fault, .. } if !fault.is_empty());
            return Err(if is_known { fault } else { error.into() });
        }
        found => found?,
    };
    identified(&model, &found.fits).apply(&mut rig.robot.model)?;
    setting.controller.disable()?;
    Ok(found)
}
