//! A `board-odrive` with two joints, and its acceptance test in one run. Each part fails with a message.

use tesaki::fault::FaultCause;
use tesaki::model::RobotModel;
use tesaki::protocol::Mode;
use tesaki_chip::SECOND;
use tesaki_chip::bench::{Bench, Motor};
use tesaki_chip::mistake::Mistake;
use tesaki_chip::odrive::Odrive;

use super::acceptance::{
    counts_no_disturbance, demand, expect_fault, is_watched, moves, starts, survives_a_low_supply,
    survives_the_crystal, tells_currents,
};
use super::{MOTOR, Rig, model};

/// A gear motor for some amperes: the shunts are small.
pub const LARGE: Motor = Motor { resistance: 1.0, inductance: 0.5e-3, constant: 0.1, ..MOTOR };
/// Time after an edge within which all gates are off [s].
pub const TRIP_TIME: f64 = 5e-6;

/// Returns the first two joints of [`model`], with such motors.
pub fn two_joints() -> RobotModel {
    let mut model = model();
    model.joints.truncate(2);
    model.chains[0].joints = 2;
    for joint in &mut model.joints {
        joint.motor.torque_constant = 0.1;
        joint.motor.current_limit = 7.0;
        joint.motor.resistance = Some(1.0);
        joint.motor.inductance = Some(0.5e-3);
    }
    model
}

impl Rig {
    /// Returns an ODrive that has just started.
    pub fn odrive(mistakes: &[Mistake]) -> Self {
        Self::odrive_on(Bench::with_odrive([LARGE; 2], 1), mistakes)
    }

    pub fn odrive_on(bench: Bench, mistakes: &[Mistake]) -> Self {
        Self::boot_image("odrive", bench, mistakes, two_joints(), 0.1)
    }

    pub fn stages(&mut self) -> &mut Odrive {
        self.machine.chip.bench.odrive.as_mut().unwrap()
    }
}

/// Runs the whole acceptance test.
pub fn accept(rig: &mut Rig) -> Result<(), String> {
    starts(rig)?;
    is_off_until_enabled(rig)?;
    rig.enable()?;
    moves(rig)?;
    tells_currents(rig)?;
    counts_no_disturbance(rig)?;
    trips(rig)?;
    survives_the_crystal(rig)?;
    survives_a_low_supply(rig)?;
    is_watched(rig)?;
    rig.machine.chip.violation().map_or(Ok(()), Err)
}

/// Checks that the gate drivers wake once there is a model, and that their gates stay off.
fn is_off_until_enabled(rig: &mut Rig) -> Result<(), String> {
    demand!(!rig.machine.chip.bench.is_awake(), "awake without a model");
    let model = rig.model.clone();
    rig.client.push(&mut rig.machine, &model)?;
    rig.try_run(rig.wake)?;
    demand!(rig.machine.chip.bench.is_awake(), "the gate drivers sleep");
    demand!(!rig.stages().is_any_gate_on(), "a gate is on before the outputs were enabled");
    Ok(())
}

/// Description, failure, time by which all gates must be off [s], fault, and repair.
type Trip = (&'static str, fn(&mut Bench), f64, FaultCause, fn(&mut Bench));

fn stages(bench: &mut Bench) -> &mut Odrive {
    bench.odrive.as_mut().unwrap()
}

const TRIPS: [Trip; 8] = [
    ("emergency stop", |b| b.stop = true, TRIP_TIME, FaultCause::EmergencyStop, |b| b.stop = false),
    ("nFAULT of M0", |b| stages(b).drivers[0].overload(3), TRIP_TIME, FaultCause::PowerStage, |_| {}),
    ("nFAULT of M1", |b| stages(b).drivers[1].overload(0), TRIP_TIME, FaultCause::PowerStage, |_| {}),
    ("current of M0", |b| b.leak[0] = 9.0, 100e-6, FaultCause::PowerStage, |b| b.leak[0] = 0.0),
    ("current of M1", |b| b.leak[1] = -9.0, 100e-6, FaultCause::PowerStage, |b| b.leak[1] = 0.0),
    (
        "a dead amplifier",
        |b| {
            stages(b).dead[1][1] = true;
            b.leak[1] = 4.0;
        },
        100e-6,
        FaultCause::PowerStage,
        |b| {
            stages(b).dead[1][1] = false;
            b.leak[1] = 0.0;
        },
    ),
    ("a high supply", |b| b.supply += 10.0, 250e-6, FaultCause::SupplyHigh, |b| b.supply -= 10.0),
    // Two periods: the next check may just have passed.
    ("forgotten settings of M1", |b| stages(b).drivers[1].forget(), 21e-3, FaultCause::PowerStage, |_| {}),
];

/// Checks that each failure switches the gates off in time, is named, and leaves them off until the next
/// enable.
fn trips(rig: &mut Rig) -> Result<(), String> {
    for (name, fail, limit, cause, mend) in TRIPS {
        demand!(rig.stages().is_any_gate_on(), "{name}: not on before");
        fail(&mut rig.machine.chip.bench);
        rig.try_run(limit)?;
        demand!(!rig.stages().is_any_gate_on(), "{name}: a gate is on after {limit} s");
        let off = rig.machine.now();
        rig.try_run(0.03)?;
        expect_fault(rig, cause).map_err(|error| format!("{name}: {error}"))?;
        mend(&mut rig.machine.chip.bench);
        rig.try_run(rig.wake + 0.1)?;
        let driven = rig.machine.chip.bench.last_driven;
        demand!(
            driven <= off,
            "{name}: on again by itself, {} s later",
            (driven - off) as f64 / SECOND as f64
        );
        let mode = rig.client.status(&mut rig.machine)?.node.mode;
        demand!(mode == Mode::Fault, "{name}: {mode:?}");
        rig.recover().map_err(|error| format!("{name}: {error}"))?;
    }
    Ok(())
}
