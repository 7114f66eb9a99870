#![allow(clippy::unwrap_used, reason = "tests")]

use embedded_hal_mock::eh1::spi::{Mock, Transaction};

use super::*;

const SETTINGS: Settings =
    Settings { gate_current: GateCurrent::Medium, overcurrent: 12, gain: Gain::Eighty };

/// Words to the chip and from it, by hand from the tables of the data sheet. CONTROL_1 is address 2: 0.7 A is
/// 1, latched shutdown 1 << 4, row 12 is 12 << 6. CONTROL_2 is address 3: gain 80 is 3 << 2. A write is
/// answered with what the register contained before.
const SET_UP: [(u16, u16); 6] = [
    (0x1311, 0x0000),
    (0x1311, 0x1000),
    (0x1311, 0x1311),
    (0x1311, 0x1311),
    (0x1311, 0x1311),
    (0x180C, 0x1311),
];
/// Queries of status 1 and 2, control 1 and 2, and the last one again. Status 2 holds the device number, 1.
const CHECK: [(u16, u16); 5] =
    [(0x8000, 0x1800), (0x8800, 0x0000), (0x9000, 0x0801), (0x9800, 0x1311), (0x9800, 0x180C)];

/// Runs `call` on a chip that answers each word with the one beside it.
fn talk<T>(words: &[(u16, u16)], call: impl FnOnce(&mut Drv8301<Mock<u8>>) -> T) -> T {
    let exchanged = |&(sent, said): &(u16, u16)| {
        let (sent, said) = (sent.to_be_bytes().to_vec(), said.to_be_bytes().to_vec());
        [
            Transaction::transaction_start(),
            Transaction::transfer_in_place(sent, said),
            Transaction::transaction_end(),
        ]
    };
    let expected: Vec<_> = words.iter().flat_map(exchanged).collect();
    let mut spi = Mock::new(&expected);
    let result = call(&mut Drv8301::new(spi.clone(), SETTINGS));
    spi.done();
    result
}

#[test]
fn it_is_set_up_and_read_back() {
    assert_eq!(talk(&[&SET_UP[..], &CHECK].concat(), Drv8301::set_up), Ok(()));
}

#[test]
fn a_check_changes_nothing() {
    assert_eq!(talk(&CHECK, Drv8301::check), Ok(()));
}

/// Name, index of the word of [`CHECK`] that is replaced, the new word, how many words are exchanged, and the
/// error.
type Wrong = (&'static str, usize, u16, usize, Error<embedded_hal::spi::ErrorKind>);

#[test]
fn whatever_is_wrong_is_an_error() {
    let wrong: [Wrong; 9] = [
        // The line is low: the first answer looks like a valid one without faults.
        ("asleep", 2, 0x0000, 3, Error::NoAnswer { register: 1, word: 0 }),
        ("nobody drives the line", 1, 0xFFFF, 2, Error::NoAnswer { register: 0, word: 0xFFFF }),
        ("a word was too short", 1, 0x8000, 2, Error::NoAnswer { register: 0, word: 0x8000 }),
        ("the answer is to another question", 3, 0x180C, 4, Error::NoAnswer { register: 2, word: 0x180C }),
        ("the gain is 10 again", 4, 0x1800, 5, Error::NotKept { register: 3, value: 0 }),
        ("overcurrent is at its lowest again", 3, 0x1000, 4, Error::NotKept { register: 2, value: 0 }),
        ("the low side of C had too much current", 1, 0x0401, 3, Error::Fault([0x401, 1])),
        ("the supply is low", 1, 0x0500, 3, Error::Fault([0x500, 1])),
        ("the gates have too much voltage", 2, 0x0881, 3, Error::Fault([0, 0x81])),
    ];
    for (name, place, word, words, expected) in wrong {
        let mut said = CHECK;
        said[place].1 = word;
        let once = &said[..words];
        if let Error::Fault(_) | Error::NoAnswer { register: STATUS_1 | STATUS_2, .. } = expected {
            assert_eq!(talk(once, Drv8301::check), Err(expected), "{name}");
        } else {
            assert_eq!(talk(&[once, once].concat(), Drv8301::check), Err(expected), "{name}");
            assert_eq!(talk(&[once, &CHECK].concat(), Drv8301::check), Ok(()), "{name}, once");
        }
    }
    // A temperature warning is no fault.
    let mut warm = CHECK;
    warm[1].1 = 0x0040;
    assert_eq!(talk(&warm, Drv8301::check), Ok(()));
}

/// By hand: 80 · 0.5 mΩ are 40 mV/A; 1.35 V are 33.75 A, and a count of 0.8059 mV is 20.15 mA.
#[test]
fn shunt_and_gain_set_range_and_resolution() {
    let sense = ShuntSense { shunt: 0.5e-3, gain: Gain::Eighty, reference: 3.3, counts: 4095 };
    assert!((sense.range() - 33.75).abs() < 1e-3);
    assert!((sense.resolution() - 20.147e-3).abs() < 1e-6);
}

/// By hand: 98 % of 1.35 V are 1641.7 counts of 0.8059 mV.
#[test]
fn what_an_amplifier_may_not_reach_is_not_linear() {
    let sense = ShuntSense { shunt: 0.5e-3, gain: Gain::Eighty, reference: 3.3, counts: 4095 };
    let linear = [406, 407, 2048, 3689, 3690].map(|counts| sense.is_linear(counts));
    assert_eq!(linear, [false, true, true, true, false]);
}
