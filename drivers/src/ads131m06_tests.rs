#![allow(clippy::unwrap_used, reason = "tests")]

use embedded_hal_mock::eh1::spi::{Mock, Transaction};

use super::*;

/// A frame of eight words with the checksum in the last.
type Frame = [u8; 24];

/// Half words at the beginnings of words: place and value. Checksums computed with Python:
/// `binascii.crc_hqx(words, 0xFFFF)`.
fn frame(halves: &[(usize, u16)]) -> Frame {
    let mut frame = [0; 24];
    for &(word, half) in halves {
        frame[3 * word..3 * word + 2].copy_from_slice(&half.to_be_bytes());
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

const GAINS: [u8; CHANNELS] = [128, 64, 32, 16, 1, 2];

/// Command, value and their checksum, which follows them.
type Sent = (u16, Option<u16>, u16);
/// First word, and the checksum of a frame whose values are zero.
type Said = (u16, u16);

/// Words sent and received at the start.
const START: [(Sent, Said); 11] = [
    ((0x0011, None, 0xFCDE), (0x0000, 0x37D9)),
    ((0xA000, None, 0x7100), (0xFF26, 0x34CF)),
    ((0x6100, Some(0x1110), 0x6388), (0x2683, 0xD23A)),
    ((0xA100, None, 0x4630), (0x4100, 0xF959)),
    ((0x6180, Some(0x3FD6), 0x606D), (0x1110, 0x07B1)),
    ((0xA180, None, 0x5DA8), (0x4180, 0x93A2)),
    ((0x6200, Some(0x4567), 0xBEA8), (0x3FD6, 0x7336)),
    ((0xA200, None, 0x1F60), (0x4200, 0x9762)),
    ((0x6280, Some(0x0010), 0xFBEB), (0x4567, 0x7D30)),
    ((0xA280, None, 0x04F8), (0x4280, 0xFD99)),
    ((0x0000, None, 0xCC9C), (0x0010, 0x5C8A)),
];

fn talk(frames: &[(Sent, Said)]) -> Vec<Transaction<u8>> {
    let sent = |(command, value, crc): Sent| match value {
        Some(value) => frame(&[(0, command), (1, value), (2, crc)]),
        None => frame(&[(0, command), (1, crc)]),
    };
    let said = |(first, crc): Said| frame(&[(0, first), (7, crc)]);
    frames.iter().flat_map(|&(to, from)| exchanged(sent(to), said(from))).collect()
}

/// Reads from a converter that has started and then sends `frames`, each with its status, its values and its
/// checksum.
fn read<const N: usize>(
    frames: [(u16, [i32; 6], u16); N],
) -> [Result<[i32; 6], ReadError<embedded_hal::spi::ErrorKind>>; N] {
    let mut expected = talk(&START);
    for (status, values, crc) in frames {
        let mut said = frame(&[(0, status), (7, crc)]);
        for (word, value) in said[3..21].chunks_mut(3).zip(values) {
            word.copy_from_slice(&value.to_be_bytes()[1..]);
        }
        expected.extend(exchanged(frame(&[(1, 0xCC9C)]), said));
    }
    let mut spi = Mock::new(&expected);
    let mut converter = Ads131m06::new(&mut spi);
    converter.configure(&GAINS);
    for step in 0..START.len() {
        assert_eq!(converter.start(), Ok(step == START.len() - 1));
    }
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

/// All channels move but the second. The fault is reported for as long as it lasts: the count of repeats
/// saturates at 255.
#[test]
fn a_channel_that_stands_still_is_a_fault() {
    let other = [2, -1, 0x12_3457, -0x12_3457, 0x7F_FFFD, -0x7F_FFFE];
    let frames: [_; 300] =
        core::array::from_fn(
            |index| {
                if index % 2 == 0 { (0x013F, VALUES, 0xADAD) } else { (0x013F, other, 0x5998) }
            },
        );
    let read = read(frames);
    assert!(read[..7].iter().all(Result::is_ok), "{read:?}");
    assert!(read[7..].iter().all(|read| *read == Err(ReadError::Stuck(1))), "{read:?}");
}

#[test]
fn it_tells_why_it_did_not_start() {
    let started = |frames: &[(Sent, Said)]| {
        let mut spi = Mock::new(&talk(frames));
        let mut converter = Ads131m06::new(&mut spi);
        converter.configure(&GAINS);
        let result = frames.iter().map(|_| converter.start()).find(|result| *result != Ok(false));
        spi.done();
        result.unwrap()
    };
    // Nobody drives the line: no answer at all.
    let mut silent = START;
    silent[1].1 = (0xFFFF, 0xFFFF);
    assert_eq!(started(&silent[..2]), Err(StartError::Absent(0)));
    // Another one of the family, with four channels; and one that was not reset.
    let mut other = START;
    other[2].1 = (0x2483, 0x69F7);
    assert_eq!(started(&other[..3]), Err(StartError::Absent(0x2483)));
    let mut not_reset = START;
    not_reset[1].1 = (0x0011, 0x6939);
    assert_eq!(started(&not_reset[..2]), Err(StartError::Absent(0x0011)));
    // A cable with a bad contact: CLOCK holds its value after a reset.
    let mut not_kept = START;
    not_kept[6].1 = (0x3F0E, 0x724A);
    let expected = StartError::NotKept { register: 3, value: 0x3F0E };
    assert_eq!(started(&not_kept[..7]), Err(expected));
    // The command to write the register was not understood.
    let mut not_written = START;
    not_written[5].1 = (0x0500, 0x8594);
    let expected = StartError::NotKept { register: 3, value: 0x0500 };
    assert_eq!(started(&not_written[..6]), Err(expected));
}

/// The next call begins with the reset.
#[test]
fn a_start_that_failed_begins_anew() {
    let mut absent = START;
    absent[1].1 = (0xFFFF, 0xFFFF);
    let mut spi = Mock::new(&[talk(&absent[..2]), talk(&START)].concat());
    let mut converter = Ads131m06::new(&mut spi);
    assert_eq!(converter.start(), Err(StartError::NoGains));
    converter.configure(&GAINS);
    assert_eq!([converter.start(), converter.start()], [Ok(false), Err(StartError::Absent(0))]);
    assert_eq!((0..11).map(|_| converter.start()).last(), Some(Ok(true)));
    spi.done();
}
