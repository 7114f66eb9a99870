//! Another board as the source of the poses.

use std::io;
use std::time::{Duration, Instant};

use nalgebra::{UnitQuaternion, Vector3};
use tesaki::kinematics::Chain;
use tesaki::model::RobotModel;
use tesaki::protocol::{FromBoard, Mode, Stream, Telemetry};
use tesaki::task::impedance::{ArmAngle, ImpedanceSettings, Redundancy};
use tesaki_description::impedance;
use tesaki_supervisor::Board;
use tesaki_supervisor::port::Address;

use super::reflect::{Handle, Reflection};
use super::source::{Content, Sample};
use crate::args::{Follow, Options};
use crate::board_session::BoardSession;
use crate::failure::Failure;
use crate::feed::Inlet;
use crate::motion::Motion;

/// A master without telemetry for this time is asked again: it may have been reset.
const SILENCE: Duration = Duration::from_millis(300);

/// Another board, whose tip leads the arm.
pub struct Master {
    session: BoardSession,
    /// The master's end of the reflected force, if there is one.
    handle: Option<Handle>,
    model: RobotModel,
    chain: Chain,
    elbow: Elbow,
}

/// What of the master leads the elbow.
enum Elbow {
    Nothing,
    ArmAngle,
    /// Index of a joint.
    Joint(usize),
}

impl Master {
    pub fn open(
        options: &Options,
        address: &Address,
        args: &Follow,
        motion: &mut Motion<'_>,
        settings: &ImpedanceSettings,
    ) -> Result<(Self, Option<Reflection>), Failure> {
        let mut session = if args.reflect.is_some() {
            BoardSession::command_at(options, address)?
        } else {
            BoardSession::open_at(options, address)?
        };
        if session.port == motion.port() {
            return Err(Failure::Usage(
                "--from names the arm's own board: give another board there, and the arm's with --port"
                    .to_owned(),
            ));
        }
        let model = session.model()?;
        if model.chains.len() != 1 {
            return Err(Failure::Usage(format!(
                "{} has {} tips: only a robot with one tip can lead an arm",
                model.name,
                model.chains.len()
            )));
        }
        let node = session.board.status()?.node;
        session.require_no_fault(node.mode, Some(&model))?;
        let mut joints = (0..).zip(&model.joints);
        if let Some((_, joint)) = joints.find(|(index, _)| node.homed >> index & 1 == 0) {
            return Err(Failure::Usage(format!(
                "its joint {} is not homed, so its pose is unknown (`tesaki home …`)",
                joint.name
            )));
        }
        let elbow = match settings.redundancy {
            Redundancy::None => Elbow::Nothing,
            Redundancy::ArmAngle if model.joints.len() == tesaki::model::MAX_CHAIN_JOINTS => Elbow::ArmAngle,
            Redundancy::ArmAngle => Elbow::Nothing,
            Redundancy::DrivenJoint { joint } => {
                let name = motion.model.joint_name(joint.into());
                let found = model.joints.iter().position(|joint| joint.name == name);
                found.map_or(Elbow::Nothing, Elbow::Joint)
            }
        };
        let chain = Chain::of_model(&model, 0);
        let reflected = args.reflect.as_deref().map(|file| {
            let of_master = impedance::load(file, &model)?;
            let round_trip = match args.round_trip {
                Some(stated) => stated,
                None => session.round_trip()? + motion.round_trip()?,
            };
            super::reflect::link((&of_master, file), settings, args, round_trip)
        });
        let (handle, reflection) = reflected.transpose()?.unzip();
        session.board.set_rate(Stream::Telemetry, 1)?;
        Ok((Self { session, handle, model, chain, elbow }, reflection))
    }

    /// Puts in the pose of the tip after each tick of the board.
    pub fn lead(mut self, inlet: &Inlet<Content>) {
        loop {
            let event = self.session.board.next_event(Instant::now() + SILENCE).map_err(Failure::from);
            let content = match event {
                Ok(Some(FromBoard::Telemetry(telemetry))) => self.sample(&telemetry).map(Content::Sample),
                Ok(Some(FromBoard::Reply(frame))) => match Handle::check(&frame.reply) {
                    Ok(()) => continue,
                    Err(failure) => Err(failure.to_string()),
                },
                Ok(Some(_)) => continue,
                Ok(None) => match self.session.board.reconnect(&[(Stream::Telemetry, 1)]) {
                    Ok(_) => continue,
                    Err(failure) => Err(failure.to_string()),
                },
                Err(failure) => Err(failure.to_string()),
            };
            let goes_on =
                self.handle.as_mut().is_none_or(|handle| handle.obey(&mut self.session, &self.model));
            let ends = content.is_err() || !goes_on;
            if !inlet.send(content.map_err(io::Error::other)) || ends {
                break;
            }
        }
        if let Some(handle) = &mut self.handle {
            handle.end(&mut self.session);
        }
    }

    fn sample(&mut self, telemetry: &Telemetry) -> Result<Sample, String> {
        if telemetry.mode == Mode::Fault {
            return Err(format!("its board is in fault (`tesaki --port {} faults`)", self.session.port));
        }
        let angles: Vec<f32> = telemetry.joints.iter().map(|joint| joint.position).collect();
        if angles.len() != self.model.joints.len() {
            return Err("its board has lost its model: it was reset".to_owned());
        }
        let posture = self.chain.posture(&self.model.chain_angles(0, &angles));
        let tip = posture.tip();
        if let Some(handle) = &mut self.handle
            && let Some(request) = handle.tick(telemetry.tick, telemetry.mode, tip)?
        {
            self.session.board.post(request).map_err(|error| error.to_string())?;
        }
        let elbow = match self.elbow {
            Elbow::Nothing => None,
            Elbow::ArmAngle => {
                ArmAngle::of(&posture, &Vector3::from(self.model.gravity)).map(|elbow| elbow.angle)
            }
            Elbow::Joint(joint) => angles.get(joint).copied(),
        };
        Ok(Sample {
            time: f64::from(telemetry.tick) * f64::from(tesaki::TICK),
            position: tip.translation.vector.into(),
            rotation: UnitQuaternion::from_rotation_matrix(&tip.rotation).coords.into(),
            elbow,
            clutch: None,
        })
    }
}
