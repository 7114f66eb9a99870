//! The microcontroller's own supply: what a reset by it tells, and a chip as it is delivered.

use tesaki::fault::FaultCause;
use tesaki::protocol::{ClockSource, Request, ResetCause, SCHEMA_KEY};

use crate::rig::Rig;

/// Flags in RCC_CSR: brown-out, and power-on, with which the first one comes, too.
const BROWN_OUT: u32 = 1 << 25;
const POWER_ON: u32 = 1 << 27 | BROWN_OUT;

/// Resets the chip, and returns the cause that it tells, and the faults: cause and value.
fn reset(rig: &mut Rig, flag: u32) -> (ResetCause, Vec<(FaultCause, f32)>) {
    rig.machine.reset(flag, "by the test");
    rig.run(0.7);
    rig.client.demand(&mut rig.machine, Request::Hello { schema: SCHEMA_KEY }).unwrap();
    let reset = rig.status().board.reset;
    (reset, rig.faults().iter().map(|fault| (fault.cause, fault.value)).collect())
}

#[test]
fn a_brown_out_is_told_and_keeps_the_faults_that_a_power_on_clears() {
    let mut rig = Rig::enabled();
    rig.machine.chip.bench.stop = true;
    rig.run(0.03);
    rig.machine.chip.bench.stop = false;
    let stopped = (FaultCause::EmergencyStop, 1.0);
    // The button.
    assert_eq!(reset(&mut rig, 0), (ResetCause::PowerOn, vec![stopped]));
    let brown_out = (FaultCause::ChipSupplyLow, 2.0);
    assert_eq!(reset(&mut rig, BROWN_OUT), (ResetCause::BrownOut, vec![stopped, brown_out]));
    // The memory of the model keeps everything; a chip's may.
    assert_eq!(reset(&mut rig, POWER_ON), (ResetCause::PowerOn, vec![]));
}

#[test]
fn a_chip_as_delivered_is_told_once() {
    let mut rig = Rig::boot();
    for (level, told) in [(0, vec![(FaultCause::BrownOutResetOff, 0.0)]), (3, vec![])] {
        rig.machine.chip.supply.brown_out_level = level;
        for flag in [POWER_ON, 0] {
            assert_eq!(reset(&mut rig, flag), (ResetCause::PowerOn, told.clone()), "{level}");
        }
    }
}

/// The voltage for 168 MHz does not come within half a second: the clock stays slow enough for every voltage.
#[test]
fn a_low_supply_at_boot_leaves_the_clock_slow() {
    let mut rig = Rig::boot();
    rig.machine.chip.supply.volts = 2.5;
    let (_, faults) = reset(&mut rig, POWER_ON);
    let slow = (FaultCause::ClockFallback, 2.0);
    assert_eq!(faults, [(FaultCause::ChipSupplyLow, 3.0), slow]);
    assert_eq!(rig.status().board.clock, ClockSource::Internal);
    assert_eq!(rig.machine.chip.violation(), None);
    // Once it is there, the next start is a normal one.
    rig.machine.chip.supply.volts = 3.3;
    assert_eq!(reset(&mut rig, POWER_ON), (ResetCause::PowerOn, vec![]));
    assert_eq!(rig.status().board.clock, ClockSource::Crystal);
}
