//! Arbitrary bytes into the codec.

use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::protocol::codec::{Decoder, MAX_FRAME, checksum, encode};
use tesaki::protocol::{ActuatorFrame, FromBoard, LogRecord, RequestFrame, SensorFrame};

use super::random::Random;
use super::requests::any_request;
use super::{fuzz, model};

/// Whatever is accepted is a message: encoded again and decoded again, it is the same.
fn accepts<T: DeserializeOwned + Serialize>(bytes: &[u8], pieces: usize, seed: u64) -> u32 {
    let mut by_byte = Decoder::new();
    let mut one = Vec::new();
    for &byte in bytes {
        if let Some(result) = by_byte.push::<T>(byte) {
            one.push(result.map(|message| postcard::to_stdvec(&message).unwrap()));
        }
    }
    let mut decoder = Decoder::new();
    let mut other = Vec::new();
    for mut piece in bytes.chunks(pieces) {
        while decoder.take(&mut piece) {
            other.push(decoder.message::<T>().map(|message| postcard::to_stdvec(&message).unwrap()));
        }
    }
    assert_eq!((&one, by_byte.counts()), (&other, decoder.counts()), "seed {seed}");
    let mut fresh = Decoder::new();
    for message in one.iter().flatten() {
        let decoded: T = postcard::from_bytes(message).unwrap();
        let mut frame = [0; MAX_FRAME];
        let length = encode(&decoded, &mut frame).unwrap();
        let again = frame[..length].iter().find_map(|&byte| fresh.push::<T>(byte));
        assert_eq!(postcard::to_stdvec(&again.unwrap().unwrap()).unwrap(), *message, "seed {seed}");
    }
    decoder.counts().good
}

#[test]
fn the_codec_takes_any_bytes() {
    let model = model();
    fuzz("codec", 100_000, |seed| {
        let mut random = Random(seed);
        let mut bytes = Vec::new();
        for _ in 0..random.below(6) {
            let mut frame = [0; MAX_FRAME];
            let request = any_request(&mut random, &model, &[]);
            let length = encode(&RequestFrame { client: 1, sequence: 2, request }, &mut frame).unwrap();
            bytes.extend_from_slice(&frame[..length]);
            if random.one_in(3) {
                // A valid checksum over any bytes: what a hostile sender would do.
                let mut payload: Vec<u8> = (0..random.below(200)).map(|_| random.next() as u8).collect();
                if let Some(first) = payload.first_mut() {
                    *first %= 22;
                }
                payload.extend_from_slice(&checksum(&payload).to_le_bytes());
                bytes.extend(cobs::encode_vec(&payload));
                bytes.push(0);
            }
            if random.one_in(2) {
                let noise = random.below(400);
                bytes.extend((0..noise).map(|_| random.next() as u8));
                bytes.push(0);
            }
        }
        for _ in 0..random.below(3) {
            let at = random.below(bytes.len().max(1));
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << random.below(8);
            }
        }
        let pieces = 1 + random.below(300);
        accepts::<RequestFrame>(&bytes, pieces, seed);
        accepts::<FromBoard>(&bytes, pieces, seed);
        accepts::<SensorFrame>(&bytes, pieces, seed);
        accepts::<ActuatorFrame>(&bytes, pieces, seed);
        accepts::<LogRecord>(&bytes, pieces, seed);
    });
}
