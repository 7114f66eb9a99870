//! The acceptance test of a board, in one run. Each part fails with a message.

use tesaki::fault::FaultCause;
use tesaki::protocol::{ClockSource, Mode, Reply, Request, ResetCause, Stream};
use tesaki_chip::SECOND;
use tesaki_chip::bench::Bench;
use tesaki_chip::tim1::Level;

use super::Rig;

/// Returns an error unless the condition is true.
macro_rules! demand {
    ($condition:expr, $($message:tt)*) => {
        let holds: bool = $condition;
        if !holds {
            return Err(format!($($message)*));
        }
    };
}

pub(crate) use demand;

/// Runs the whole acceptance test.
pub fn accept(rig: &mut Rig) -> Result<(), String> {
    starts(rig)?;
    rig.enable()?;
    moves(rig)?;
    tells_currents(rig)?;
    counts_no_disturbance(rig)?;
    stops_by_hardware(rig)?;
    reports_power_stages(rig)?;
    trips_at_high_currents(rig)?;
    survives_the_crystal(rig)?;
    survives_a_low_supply(rig)?;
    is_watched(rig)
}

/// A part of it, for a board that is enabled.
pub type Part = fn(&mut Rig) -> Result<(), String>;

/// Runs the beginning, and one part.
pub fn accept_part(rig: &mut Rig, part: Part) -> Result<(), String> {
    starts(rig)?;
    rig.enable()?;
    part(rig)
}

fn bench(rig: &mut Rig) -> &mut Bench {
    &mut rig.machine.chip.bench
}

pub fn starts(rig: &mut Rig) -> Result<(), String> {
    demand!(!bench(rig).is_awake(), "power stages are awake after the boot");
    rig.client.demand(&mut rig.machine, Request::Hello { schema: tesaki::protocol::SCHEMA_KEY })?;
    let status = rig.client.status(&mut rig.machine)?;
    let (clock, reset) = (status.board.clock, status.board.reset);
    demand!(clock == ClockSource::Crystal && reset == ResetCause::PowerOn, "{clock:?} {reset:?}");
    let hclk = rig.machine.chip.rcc.hclk();
    demand!(hclk == 168_000_000, "runs at {hclk} Hz");
    if let Some(violation) = rig.machine.chip.violation() {
        return Err(violation);
    }
    demand!((status.node.supply - 24.0).abs() < 0.15, "supply {} V", status.node.supply);
    demand!(rig.machine.chip.unknown.is_empty(), "unknown registers {:?}", rig.machine.chip.unknown);
    Ok(())
}

/// Moves each joint on its own path, within 6 mrad of the reference.
pub fn moves(rig: &mut Rig) -> Result<(), String> {
    demand!(bench(rig).is_awake(), "power stages sleep");
    let goals = &[0.3_f32, 0.15, -0.3][..rig.model.joints.len()];
    rig.try_run(0.3)?;
    rig.client.send(&mut rig.machine, Rig::goal_request(goals));
    for tick in 1..=60 {
        rig.keep();
        rig.try_run(0.01)?;
        let time = f64::from(tick) * 0.01;
        let reference = 1.0 - (1.0 + time / 0.2) * (-time / 0.2).exp();
        for (joint, goal) in goals.iter().copied().enumerate() {
            let angle = bench(rig).states[joint].angle;
            let error = angle - f64::from(goal) * reference;
            demand!(error.abs() < 6e-3, "joint {joint} is {error:.4} rad beside its reference at {time} s");
        }
    }
    let mode = rig.client.status(&mut rig.machine)?.node.mode;
    demand!(mode == Rig::running(), "{mode:?} after moving");
    Ok(())
}

/// Checks that the board counts no edges that power stages couple into the encoders' cables.
pub fn counts_no_disturbance(rig: &mut Rig) -> Result<(), String> {
    rig.client.demand(&mut rig.machine, Request::SetRate { stream: Stream::Log, every: 1 })?;
    let encoders = |rig: &mut Rig| {
        rig.try_run(0.03)?;
        rig.client.sensors.as_ref().map(|sensors| sensors.encoders.clone()).ok_or_else(|| "no log".to_owned())
    };
    let (before, turned) = (encoders(rig)?, [0, 1, 2].map(|motor| bench(rig).counts(motor)));
    for _ in 0..50 {
        // Some 50 V over a few centimetres.
        rig.machine.chip.disturb_encoders(200_000);
    }
    let (after, now) = (encoders(rig)?, [0, 1, 2].map(|motor| bench(rig).counts(motor)));
    for (joint, (before, after)) in before.iter().zip(&after).enumerate() {
        let miscounted = i64::from(after - before) - (now[joint] - turned[joint]);
        demand!(miscounted.abs() < 100, "encoder {joint} counted {miscounted} disturbances");
    }
    rig.client.demand(&mut rig.machine, Request::SetRate { stream: Stream::Log, every: 0 })
}

/// Checks that the currents in the sensor frames are those of the motors.
pub fn tells_currents(rig: &mut Rig) -> Result<(), String> {
    rig.client.demand(&mut rig.machine, Request::SetRate { stream: Stream::Log, every: 1 })?;
    for (joint, load) in [0.05, -0.04, 0.04].into_iter().enumerate() {
        bench(rig).motors[joint].load = load;
    }
    for _ in 0..60 {
        rig.keep();
        rig.try_run(0.01)?;
    }
    let sensors = rig.client.sensors.clone().ok_or("no log")?;
    for (joint, told) in sensors.currents.iter().enumerate() {
        let current = bench(rig).states[joint].current;
        let told = f64::from(*told) * 1e-3;
        // Covers the ripple, and the larger counts of the shunts.
        let tolerance = if bench(rig).odrive.is_some() { 0.06 } else { 0.02 };
        demand!((told - current).abs() < tolerance, "joint {joint}: {told} A told, {current} A flow");
    }
    // The loads would keep turning motors that are off.
    bench(rig).motors.iter_mut().for_each(|motor| motor.load = 0.0);
    rig.try_run(0.2)?;
    rig.client.demand(&mut rig.machine, Request::SetRate { stream: Stream::Log, every: 0 })
}

/// Checks that the emergency stop works without instructions, and that the motors do not restart by
/// themselves.
pub fn stops_by_hardware(rig: &mut Rig) -> Result<(), String> {
    bench(rig).stop = true;
    rig.machine.pass(10);
    let clock = 168_000_000;
    let (chip, now) = (&rig.machine.chip, rig.machine.now());
    for channel in 0..3 {
        let level = chip.tim1.complementary(channel, now, clock);
        demand!(level == Level::Low, "channel {channel} is {level:?} after the emergency stop");
    }
    bench(rig).stop = false;
    let before = rig.machine.now();
    rig.machine.pass(SECOND / 1000);
    let driven = bench(rig).last_driven;
    demand!(driven <= before, "drives again by itself after the emergency stop");
    bench(rig).stop = true;
    rig.try_run(0.03)?;
    demand!(!bench(rig).is_awake(), "awake after the emergency stop");
    expect_fault(rig, FaultCause::EmergencyStop)?;
    bench(rig).stop = false;
    rig.try_run(0.03)?;
    demand!(!bench(rig).is_awake(), "awake when the emergency stop was released");
    rig.recover()
}

fn reports_power_stages(rig: &mut Rig) -> Result<(), String> {
    bench(rig).fault = true;
    rig.try_run(0.03)?;
    demand!(!bench(rig).is_awake(), "awake with a power stage's fault");
    expect_fault(rig, FaultCause::PowerStage)?;
    bench(rig).fault = false;
    rig.try_run(0.03)?;
    rig.recover()
}

/// Checks that each motor trips within 100 µs.
fn trips_at_high_currents(rig: &mut Rig) -> Result<(), String> {
    for motor in 0..3 {
        bench(rig).leak[motor] = 2.0;
        rig.try_run(100e-6)?;
        demand!(!bench(rig).is_awake(), "awake 100 µs after a high current in motor {motor}");
        bench(rig).leak[motor] = 0.0;
        rig.try_run(0.03)?;
        expect_fault(rig, FaultCause::PowerStage)?;
        rig.recover()?;
    }
    Ok(())
}

pub fn survives_the_crystal(rig: &mut Rig) -> Result<(), String> {
    rig.machine.chip.stop_crystal();
    rig.try_run(20e-6)?;
    demand!(!bench(rig).is_awake(), "awake 20 µs after the crystal stopped");
    rig.machine.chip.rcc.crystal = Some(8_000_000);
    rig.try_run(0.1)?;
    rig.client.demand(&mut rig.machine, Request::Hello { schema: tesaki::protocol::SCHEMA_KEY })?;
    let reset = rig.client.status(&mut rig.machine)?.board.reset;
    demand!(reset == ResetCause::CrystalStopped, "{reset:?} after the crystal stopped");
    rig.enable()
}

/// The microcontroller's supply falls by 10 mV a microsecond, to where it cannot read its flash memory at 168
/// MHz, and comes back.
pub fn survives_a_low_supply(rig: &mut Rig) -> Result<(), String> {
    for step in 1..=80 {
        rig.machine.chip.supply.volts = 3.3 - 0.01 * f64::from(step);
        rig.try_run(1e-6)?;
        let volts = rig.machine.chip.supply.volts;
        if let Some(violation) = rig.machine.chip.violation() {
            return Err(violation);
        }
        demand!(volts > 2.8 || !bench(rig).is_awake(), "awake at {volts:.2} V");
    }
    rig.try_run(0.1)?;
    rig.machine.chip.supply.volts = 3.3;
    rig.try_run(0.1)?;
    rig.client.demand(&mut rig.machine, Request::Hello { schema: tesaki::protocol::SCHEMA_KEY })?;
    let status = rig.client.status(&mut rig.machine)?.board;
    let (clock, reset) = (status.clock, status.reset);
    demand!(
        (clock, reset) == (ClockSource::Crystal, ResetCause::BrownOut),
        "{clock:?} {reset:?} after a dip"
    );
    rig.enable()
}

/// Checks that without control ticks there is no voltage after 20 ms, and a reset within 200 ms.
pub fn is_watched(rig: &mut Rig) -> Result<(), String> {
    bench(rig).motors[0].load = 0.05;
    for _ in 0..10 {
        rig.keep();
        rig.try_run(0.01)?;
    }
    let before = rig.machine.now();
    rig.stop_control();
    rig.try_run(0.06)?;
    let driven = (bench(rig).last_driven.saturating_sub(before)) as f64 / SECOND as f64;
    demand!(driven > 0.0 && driven < 0.0201, "drives for {driven} s without control ticks");
    rig.try_run(0.14)?;
    rig.client.demand(&mut rig.machine, Request::Hello { schema: tesaki::protocol::SCHEMA_KEY })?;
    let reset = rig.client.status(&mut rig.machine)?.board.reset;
    demand!(reset == ResetCause::Watchdog, "{reset:?} without control ticks");
    Ok(())
}

pub fn expect_fault(rig: &mut Rig, cause: FaultCause) -> Result<(), String> {
    let last = match rig.client.ask(&mut rig.machine, Request::ReadFaults)? {
        Reply::Faults(log) => log.faults.last().copied(),
        other => return Err(format!("{other:?}")),
    };
    demand!(last.is_some_and(|fault| fault.cause == cause), "{last:?} instead of {cause:?}");
    let mode = rig.client.status(&mut rig.machine)?.node.mode;
    demand!(mode == Mode::Fault, "{mode:?} instead of a fault");
    Ok(())
}
