#![allow(clippy::unwrap_used, reason = "tests")]

use std::cell::RefCell;
use std::convert::Infallible;

use embedded_hal::spi::{ErrorType, Operation};

use super::*;

/// The included file describes its contents at its top.
type Sensor = ([[f32; 6]; 6], [f32; 2], &'static [([i32; 6], [f64; 6])], f64);
const SENSORS: &[Sensor] = include!("../../tests/oracles/data/gauges.in");

fn sensor((calibration_matrix, [force_resolution, torque_resolution], ..): Sensor) -> (ForceSensor, Gauges) {
    let sensor = ForceSensor {
        force_resolution,
        torque_resolution,
        saturation: 100_000,
        force_limit: 10.0,
        mass: 0.0,
        center_of_mass: [0.0; 3],
    };
    (sensor, Gauges { chain: 0, calibration_matrix, gains: [128, 128, 64, 64, 32, 32] })
}

fn calibration(of: Sensor) -> Calibration {
    let (sensor, gauges) = sensor(of);
    Calibration::new(&sensor, &gauges)
}

#[test]
fn wrenches_are_those_of_numpy() {
    for of in SENSORS {
        let calibration = calibration(*of);
        for (gauges, expected) in of.2 {
            for (got, expected) in calibration.wrench(gauges).into_iter().zip(expected) {
                // Rounded to a count, and six products of single precision.
                let tolerance = 0.5 + 1e-6 * expected.abs().max(1e4);
                assert!((f64::from(got) - expected).abs() < tolerance, "{got} {expected}");
            }
        }
    }
}

/// A wrench beyond the range of the frame saturates; it does not wrap.
#[test]
fn counts_saturate() {
    let mut wild = sensor(SENSORS[0]);
    wild.1.calibration_matrix[0][0] = 1e6;
    let wrench = Calibration::new(&wild.0, &wild.1).wrench(&[0x7F_FFFF, 0, 0, 0, 0, 0]);
    assert_eq!(wrench[0], i32::MAX);
}

/// A model of the converter: registers, next answer, and defects.
#[derive(Default)]
struct Converter {
    registers: [u16; 6],
    answer: Option<u16>,
    has_restarted: bool,
    is_damaged: bool,
    is_late: bool,
    values: [i32; 6],
    frames: u32,
}

struct Bus<'a>(&'a RefCell<Converter>);

impl ErrorType for Bus<'_> {
    type Error = Infallible;
}

impl SpiDevice for Bus<'_> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let [Operation::TransferInPlace(frame)] = operations else { panic!() };
        let mut converter = self.0.borrow_mut();
        converter.frames += 1;
        let half = |word: usize| u16::from_be_bytes([frame[3 * word], frame[3 * word + 1]]);
        let (command, value) = (half(0), half(1));
        let register = usize::from(command >> 7 & 31);
        let status = u16::from(converter.has_restarted) << 10 | if converter.is_late { 0 } else { 0x3F };
        let first = converter.answer.take().unwrap_or(status);
        match command {
            0x11 => {
                converter.registers = [0; 6];
                converter.has_restarted = true;
                converter.answer = Some(0xFF26);
            }
            0 => {}
            _ if command >> 13 == 5 => {
                let id = if register == 0 { 0x2600 } else { converter.registers[register] };
                converter.answer = Some(id);
            }
            _ => {
                converter.registers[register] = value;
                // The flag of the restart is a bit of MODE.
                converter.has_restarted &= register != 2;
                converter.answer = Some(0x4000 | command & 0xF80);
            }
        }
        frame.fill(0);
        frame[..2].copy_from_slice(&first.to_be_bytes());
        for (word, value) in frame[3..21].chunks_mut(3).zip(converter.values) {
            word.copy_from_slice(&value.to_be_bytes()[1..]);
        }
        let mut crc = 0xFFFF_u16;
        for byte in &frame[..21] {
            crc ^= u16::from(*byte) << 8;
            (0..8).for_each(|_| crc = crc << 1 ^ if crc >> 15 == 1 { 0x1021 } else { 0 });
        }
        frame[21..23].copy_from_slice(&crc.to_be_bytes());
        frame[4] ^= u8::from(converter.is_damaged);
        Ok(())
    }
}

/// Runs a control period with this many conversions, before each of which `change` is called with its number.
fn period(
    gauges: &mut ForceGauges<Bus<'_>>,
    converter: &RefCell<Converter>,
    conversions: i32,
    mut change: impl FnMut(&mut Converter, i32),
) -> Option<Reading> {
    for number in 0..conversions {
        {
            let mut converter = converter.borrow_mut();
            converter.values = [1, 2, 3, 4, 5, 6].map(|gauge| 1000 * gauge + number);
            change(&mut converter, number);
        }
        gauges.on_ready();
    }
    gauges.update()
}

fn started(converter: &RefCell<Converter>) -> ForceGauges<Bus<'_>> {
    let mut gauges = ForceGauges::new(Bus(converter));
    let (sensor, of_sensor) = sensor(SENSORS[0]);
    gauges.configure(Some((&sensor, &of_sensor)));
    for _ in 0..11 {
        let reading = period(&mut gauges, converter, 40, |_, _| {}).unwrap();
        assert_eq!(reading.fault, Some(ForceSensorFault::Silent));
    }
    gauges
}

#[test]
fn a_period_gives_the_wrench_of_its_last_conversion() {
    let converter = RefCell::default();
    let mut gauges = started(&converter);
    assert_eq!(converter.borrow().registers[3..], [0x3FD6, 0x6677, 0x0055]);
    let reading = period(&mut gauges, &converter, 10, |_, _| {}).unwrap();
    let expected = calibration(SENSORS[0]).wrench(&[1009, 2009, 3009, 4009, 5009, 6009]);
    assert_eq!(reading, Reading { wrench: expected, fault: None });
    assert_ne!(expected, [0; 6]);
}

#[test]
fn without_a_sensor_nothing_is_exchanged() {
    let converter = RefCell::default();
    let mut gauges = started(&converter);
    gauges.configure(None);
    let frames = converter.borrow().frames;
    assert_eq!(period(&mut gauges, &converter, 10, |_, _| {}), None);
    assert_eq!(converter.borrow().frames, frames);
}

#[test]
fn some_damaged_or_late_values_are_left_out_and_many_are_a_fault() {
    for (bad, fault) in [(5, None), (6, Some(()))] {
        let converter = RefCell::default();
        let mut gauges = started(&converter);
        let damaged = period(&mut gauges, &converter, 10, |converter, n| converter.is_damaged = n < bad);
        assert_eq!(damaged.unwrap().fault, fault.map(|()| ForceSensorFault::Damaged));
        let late = period(&mut gauges, &converter, 10, |converter, n| converter.is_late = n < bad);
        assert_eq!(late.unwrap().fault, fault.map(|()| ForceSensorFault::Silent));
        let few = period(&mut gauges, &converter, 10 - bad, |_, _| {});
        assert_eq!(few.unwrap().fault, fault.map(|()| ForceSensorFault::Silent));
        let none = period(&mut gauges, &converter, 0, |_, _| {});
        assert_eq!(none.unwrap().fault, Some(ForceSensorFault::Silent));
        assert_eq!(period(&mut gauges, &converter, 10, |_, _| {}).unwrap().fault, None);
    }
}

#[test]
fn a_gauge_that_stands_or_is_at_its_end_is_a_fault_at_once() {
    let converter = RefCell::default();
    let mut gauges = started(&converter);
    let end = |converter: &mut Converter, n: i32| {
        if n == 2 {
            converter.values[4] = 0x7F_FFFF;
        }
        converter.is_damaged = n == 3;
    };
    let fault = period(&mut gauges, &converter, 10, end).unwrap().fault;
    assert_eq!(fault, Some(ForceSensorFault::Saturated(4)));
    let stands = period(&mut gauges, &converter, 10, |converter, _| converter.values[1] = 77);
    assert_eq!(stands.unwrap().fault, Some(ForceSensorFault::Stuck(1)));
    assert_eq!(period(&mut gauges, &converter, 10, |_, _| {}).unwrap().fault, None);
}

#[test]
fn a_restart_is_told_and_the_converter_set_up_again() {
    let converter = RefCell::default();
    let mut gauges = started(&converter);
    let restart = |converter: &mut Converter, n: i32| {
        if n == 7 {
            (converter.has_restarted, converter.registers) = (true, [0; 6]);
        }
    };
    let fault = |reading: Option<Reading>| reading.unwrap().fault;
    assert_eq!(fault(period(&mut gauges, &converter, 10, restart)), Some(ForceSensorFault::Restarted));
    for _ in 0..10 {
        let silent = period(&mut gauges, &converter, 10, |_, _| {});
        assert_eq!(fault(silent), Some(ForceSensorFault::Silent));
    }
    assert_eq!(fault(period(&mut gauges, &converter, 10, |_, _| {})), None);
    assert_eq!(converter.borrow().registers[3..], [0x3FD6, 0x6677, 0x0055]);
}

/// After the first conversion, and after one that was missed, the converter has an old one before the new.
#[test]
fn what_may_be_an_old_conversion_is_read_and_dropped() {
    let converter = RefCell::default();
    let mut gauges = started(&converter);
    let mut frames = |conversions: i32| {
        let before = converter.borrow().frames;
        period(&mut gauges, &converter, conversions, |_, _| {});
        converter.borrow().frames - before
    };
    assert_eq!(
        [frames(10), frames(10), frames(8), frames(10), frames(9), frames(10)],
        [11, 10, 8, 11, 9, 11]
    );
}

#[test]
fn values_of_before_a_push_are_not_believed() {
    let converter = RefCell::default();
    let mut gauges = started(&converter);
    assert_eq!(period(&mut gauges, &converter, 10, |_, _| {}).unwrap().fault, None);
    (0..7).for_each(|_| assert!(gauges.on_ready()));
    let (sensor, of_sensor) = sensor(SENSORS[0]);
    gauges.configure(Some((&sensor, &of_sensor)));
    assert_eq!(gauges.update().unwrap().fault, Some(ForceSensorFault::Silent));
}

#[test]
fn noise_on_the_line_costs_few_frames() {
    let converter = RefCell::default();
    let mut gauges = started(&converter);
    period(&mut gauges, &converter, 10, |_, _| {});
    let before = converter.borrow().frames;
    let more: Vec<bool> = (0..100).map(|_| gauges.on_ready()).collect();
    assert_eq!(more.iter().filter(|more| **more).count(), 15);
    assert_eq!(converter.borrow().frames - before, 15);
}
