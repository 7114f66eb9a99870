#![allow(clippy::unwrap_used, reason = "tests")]

use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::spi::{Mock, Transaction};

use super::*;

/// A frame of eight words with the checksum in the last.
type Frame = [u8; 24];

/// With a checksum that Python has computed: `binascii.crc_hqx(frame[:21], 0xFFFF)`.
fn frame(first: u16, second: u16, crc: u16) -> Frame {
    let mut frame = [0; 24];
    for (place, half) in [(0, first), (3, second), (21, crc)] {
        frame[place..place + 2].copy_from_slice(&half.to_be_bytes());
    }
    frame
}

fn exchanged(sent: Frame, received: Frame) -> [Transaction<u8>; 3] {
    let (sent, received) = (sent.to_vec(), received.to_vec());
    [
        Transaction::transaction_start(),
        Transaction::transfer_in_place(sent, received),
        Transaction::transaction_end(),
    ]
}

const SETTINGS: Settings =
    Settings { gains: [128, 64, 32, 16, 1, 2], oversampling: 1024, external_reference: true };

/// What it is told and says at the start: command, value, checksum of both directions.
const START: [(Sent, Said); 15] = [
    ((0x0011, 0, 0x6939), (0, 0, 0x37D9)),
    ((0x0000, 0, 0x37D9), (0xFF26, 0, 0x34CF)),
    ((0xA000, 0, 0x0C8E), (0, 0, 0x37D9)),
    ((0x0000, 0, 0x37D9), (0x2683, 0, 0xD23A)),
    ((0x6100, 0x1110, 0xE82D), (0, 0, 0x37D9)),
    ((0x0000, 0, 0x37D9), (0x4100, 0, 0xF959)),
    ((0xA100, 0, 0xD978), (0, 0, 0x37D9)),
    ((0x0000, 0, 0x37D9), (0x1110, 0, 0x07B1)),
    ((0x6180, 0x3F4E, 0x05DB), (0, 0, 0x37D9)),
    ((0x0000, 0, 0x37D9), (0x4180, 0, 0x93A2)),
    ((0xA180, 0, 0xB383), (0, 0, 0x37D9)),
    ((0x0000, 0, 0x37D9), (0x3F4E, 0, 0xCF27)),
    ((0x6200, 0x4567, 0x5778), (0, 0, 0x37D9)),
    ((0x0000, 0, 0x37D9), (0x4200, 0, 0x9762)),
    ((0xA200, 0, 0xB743), (0, 0, 0x37D9)),
];
/// Its end.
const STARTED: [(Sent, Said); 5] = [
    ((0x0000, 0, 0x37D9), (0x4567, 0, 0x7D30)),
    ((0x6280, 0x0010, 0xEE23), (0, 0, 0x37D9)),
    ((0x0000, 0, 0x37D9), (0x4280, 0, 0xFD99)),
    ((0xA280, 0, 0xDDB8), (0, 0, 0x37D9)),
    ((0x0000, 0, 0x37D9), (0x0010, 0, 0x5C8A)),
];
type Sent = (u16, u16, u16);
type Said = (u16, u16, u16);

fn talk(frames: &[(Sent, Said)]) -> Vec<Transaction<u8>> {
    let of = |(first, second, crc)| frame(first, second, crc);
    frames.iter().flat_map(|&(sent, said)| exchanged(of(sent), of(said))).collect()
}

/// A converter that has started and then says `frames`, each with its status, its values and its checksum.
fn read<const N: usize>(
    frames: [(u16, [i32; 6], u16); N],
) -> [Result<[i32; 6], ReadError<embedded_hal::spi::ErrorKind>>; N] {
    let mut expected = [talk(&START), talk(&STARTED)].concat();
    for (status, values, crc) in frames {
        let mut said = frame(status, 0, crc);
        for (word, value) in said[3..21].chunks_mut(3).zip(values) {
            word.copy_from_slice(&value.to_be_bytes()[1..]);
        }
        expected.extend(exchanged(frame(0, 0, 0x37D9), said));
    }
    let mut spi = Mock::new(&expected);
    let mut converter = Ads131m06::start(&mut spi, &mut NoopDelay::new(), &SETTINGS).unwrap();
    let values = frames.map(|_| converter.read());
    spi.done();
    values
}

const VALUES: [i32; 6] = [1, -1, 0x12_3456, -0x12_3456, 0x7F_FFFE, -0x7F_FFFF];

#[test]
fn values_have_signs() {
    assert_eq!(read([(0x013F, VALUES, 0xADAD)]), [Ok(VALUES)]);
}

#[test]
fn what_cannot_be_trusted_is_no_value() {
    let at_the_top = [1, -1, 0x12_3456, 0x7F_FFFF, 0, 0];
    let at_the_bottom = [1, -1, 0x12_3456, 0, 0, -0x80_0000];
    for (name, status, values, crc, expected) in [
        (
            "a bit of the values",
            0x013F,
            [3, -1, 0x12_3456, -0x12_3456, 0x7F_FFFE, -0x7F_FFFF],
            0xADAD,
            ReadError::Checksum,
        ),
        ("a bit of the status", 0x012F, VALUES, 0xADAD, ReadError::Checksum),
        ("the line is low", 0, [0; 6], 0, ReadError::Checksum),
        ("the line is high", 0xFFFF, [-1; 6], 0xFFFF, ReadError::Checksum),
        ("the command was damaged", 0x113F, VALUES, 0x2360, ReadError::Checksum),
        ("a restart", 0x053F, VALUES, 0xCA16, ReadError::Restarted),
        ("channel 3 is late", 0x0137, VALUES, 0x1014, ReadError::NotReady),
        ("the top", 0x013F, at_the_top, 0x915B, ReadError::Saturated(3)),
        ("the bottom", 0x013F, at_the_bottom, 0xA8B0, ReadError::Saturated(5)),
    ] {
        assert_eq!(read([(status, values, crc)]), [Err(expected)], "{name}");
    }
}

/// All channels move but the second.
#[test]
fn a_channel_that_stands_still_is_a_fault() {
    let other = [2, -1, 0x12_3457, -0x12_3457, 0x7F_FFFD, -0x7F_FFFE];
    let frames: [_; 9] =
        core::array::from_fn(
            |index| {
                if index % 2 == 0 { (0x013F, VALUES, 0xADAD) } else { (0x013F, other, 0x5998) }
            },
        );
    let read = read(frames);
    assert!(read[..7].iter().all(Result::is_ok), "{read:?}");
    assert_eq!(read[7..], [Err(ReadError::Stuck(1)); 2]);
}

#[test]
fn it_tells_why_it_did_not_start() {
    let started = |frames: &[(Sent, Said)], settings: &Settings| {
        let mut spi = Mock::new(&talk(frames));
        let result = Ads131m06::start(&mut spi, &mut NoopDelay::new(), settings).map(drop);
        spi.done();
        result
    };
    let settings = Settings { gains: [1, 1, 3, 1, 1, 1], ..SETTINGS };
    assert_eq!(started(&[], &settings), Err(StartError::Gain { channel: 2, gain: 3 }));
    for oversampling in [0, 64, 1000, 32_768] {
        let settings = Settings { oversampling, ..SETTINGS };
        assert_eq!(started(&[], &settings), Err(StartError::Oversampling(oversampling)));
    }
    // Nobody drives the line: no answer at all.
    let mut silent = START;
    silent[1].1 = (0xFFFF, 0xFFFF, 0xFFFF);
    assert_eq!(started(&silent[..2], &SETTINGS), Err(StartError::Absent(0)));
    // A cable with a bad contact: CLOCK holds its value after a reset.
    let mut not_kept = START;
    not_kept[11].1 = (0x3F0E, 0, 0x724A);
    let expected = StartError::NotKept { register: 3, value: 0x3F0E };
    assert_eq!(started(&not_kept[..12], &SETTINGS), Err(expected));
}
