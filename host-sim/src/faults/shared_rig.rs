//! The rig as the board of a scenario, and as an intervention on its plant.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tesaki::model::RobotModel;
use tesaki::protocol::{ActuatorFrame, Reply, Request, SensorFrame};
use tesaki_supervisor::hand::{FingerBoard, News};
use tesaki_supervisor::{Board, BoardError};

use super::oracle::Oracle;
use super::rig::{Rig, over};
use super::sample::Machine;
use super::schedule::Schedule;
use crate::controller::Controller;
use crate::digest::FramesDigest;
use crate::plant::{Intervention, Plant, SharedIntervention};
use crate::virtual_board::VirtualBoard;

/// Noise of a contact force [N].
const FORCE_NOISE: [(&str, f64); 2] = [("arm7", 2.0), ("hand3", 0.5)];

/// A rig that board and plant share.
#[derive(Clone)]
pub struct SharedRig(Arc<Mutex<Rig>>);

impl SharedRig {
    /// A rig for a robot with this model.
    pub fn new(schedule: &Schedule, model: &RobotModel) -> Self {
        Self(Arc::new(Mutex::new(Rig::new(schedule, model))))
    }

    /// The rig as an intervention on the plant.
    pub fn intervention(&self) -> SharedIntervention {
        Arc::new(Mutex::new(self.clone()))
    }

    pub fn lock(&self) -> MutexGuard<'_, Rig> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Intervention for SharedRig {
    fn attach(&mut self, plant: &mut Plant) {
        let mut rig = self.lock();
        rig.trials += 1;
        if rig.trials > rig.schedule.trial + 1 {
            return;
        }
        rig.tick = 0;
        if !rig.runs() {
            return;
        }
        rig.board = VirtualBoard::default();
        (rig.report, rig.digest) = (None, FramesDigest::default());
        let noise = FORCE_NOISE.iter().find(|(name, _)| *name == rig.schedule.robot);
        let machine = Machine {
            model: rig.model.clone(),
            stops: plant.stops(),
            coulomb: plant.coulomb_frictions(),
            mass: plant.mass(),
            force_noise: noise.map_or(1.0, |(_, noise)| *noise),
        };
        rig.oracle = Some(Oracle::new(machine));
    }

    fn before(&mut self, plant: &mut Plant, frame: &mut ActuatorFrame) -> bool {
        let mut rig = self.lock();
        if !rig.runs() {
            rig.tick += 1;
            return false;
        }
        rig.disturb_plant(plant);
        frame.clone_from(&rig.driven);
        true
    }

    fn after(&mut self, plant: &Plant) {
        let mut rig = self.lock();
        let sample = rig.sample(plant);
        let mut line = rig.trace.is_some().then(|| sample.to_string());
        if let Some(oracle) = &mut rig.oracle {
            oracle.tick(sample);
            if let (Some(line), Some([work, allowance])) = (&mut line, oracle.work()) {
                line.push_str(&format!("  work {work:.3} of {allowance:.3} J"));
            }
        }
        if let (Some(trace), Some(line)) = (&mut rig.trace, line) {
            trace.push(line);
        }
        rig.tick += 1;
        rig.is_over |= rig.tick >= rig.schedule.end || rig.panicked;
    }
}

impl Board for SharedRig {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        self.lock().request(request)
    }
}

impl Controller for SharedRig {
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError> {
        let mut rig = self.lock();
        if rig.is_over || rig.trials > rig.schedule.trial + 1 {
            rig.is_over = true;
            return Err(over());
        }
        rig.tick(sensors);
        // The scenario sees enabled outputs until the run ends. The plant gets the torques that the drives
        // apply.
        let mut seen = rig.driven.clone();
        seen.enabled = true;
        Ok(seen)
    }
}

impl FingerBoard for SharedRig {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        self.request(request).map(|_| ())
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        let rig = self.lock();
        let node = rig.board.node();
        Ok(News { telemetry: Some(node.telemetry()), tips: Some(node.tips()), refusal: None })
    }
}
