use std::net::Shutdown;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use tesaki_rng::Rng;

use super::*;

/// Starts a client that performs its handshake; returns the other end of its connection.
fn client(key: [u8; 32]) -> (File, JoinHandle<Result<Channel, Failed>>) {
    let (near, far) = UnixStream::pair().unwrap();
    near.set_nonblocking(true).unwrap();
    far.set_nonblocking(true).unwrap();
    let near = File::from(OwnedFd::from(near));
    let connect = move || Channel::connect(&near, &Key(key), Instant::now() + Duration::from_millis(500));
    (OwnedFd::from(far).into(), thread::spawn(connect))
}

fn read(file: &File, length: usize) -> Vec<u8> {
    let mut bytes = vec![0; length];
    stream::read_exact_until(file, &mut bytes, Instant::now() + Duration::from_secs(1)).unwrap();
    bytes
}

fn send(file: &File, mut bytes: &[u8]) {
    stream::write_until(file, &mut bytes, Instant::now() + Duration::from_secs(1)).unwrap();
}

/// Returns both ends after the handshake, and the bytes that the client sent in it.
fn agreed() -> (Channel, Channel, [Vec<u8>; 2]) {
    let (file, client) = client([7; 32]);
    let mut listening = Channel::listening(Key([7; 32]));
    let (mut answer, mut content) = (VecDeque::new(), VecDeque::new());
    send(&file, GREETING);
    let hello = read(&file, GREETING.len() + HANDSHAKE);
    listening.open(&hello, &mut answer, &mut content).unwrap();
    assert!(!listening.is_open(), "before the confirmation");
    listening.seal(&[1], &mut VecDeque::new()).unwrap_err();
    send(&file, answer.make_contiguous());
    let confirmation = read(&file, 2 + TAG);
    listening.open(&confirmation, &mut answer, &mut content).unwrap();
    assert!(listening.is_open() && content.is_empty());
    (listening, client.join().unwrap().unwrap(), [hello, confirmation])
}

/// Decrypts these bytes with `to`.
fn opened(to: &mut Channel, bytes: &[u8]) -> io::Result<Vec<u8>> {
    let mut content = VecDeque::new();
    to.open(bytes, &mut VecDeque::new(), &mut content).map(|()| content.into())
}

fn sealed(from: &mut Channel, bytes: &[u8]) -> Vec<u8> {
    let mut out = VecDeque::new();
    from.seal(bytes, &mut out).unwrap();
    out.into()
}

#[test]
fn bytes_pass_both_ways_in_pieces_of_any_size_and_are_not_readable() {
    let (mut one, mut other, _) = agreed();
    let text: Vec<u8> = (0..10_000_u32).map(|number| number.to_be_bytes()[3]).collect();
    for _ in 0..2 {
        let secret = sealed(&mut one, &text);
        assert!(!secret.windows(16).any(|window| window == &text[..16]));
        for size in [1, 999, usize::MAX] {
            let mut got = Vec::new();
            let secret = if size == 1 { secret.clone() } else { sealed(&mut one, &text) };
            for piece in secret.chunks(size) {
                got.extend(opened(&mut other, piece).unwrap());
            }
            assert!(got == text, "in pieces of {size}");
        }
        std::mem::swap(&mut one, &mut other);
    }
}

#[test]
fn damaged_repeated_missing_and_reordered_messages_end_it() {
    type Spoil = fn(Vec<u8>, Vec<u8>) -> Vec<u8>;
    let spoil: [Spoil; 6] = [
        |first, _| [first.clone(), first].concat(),
        |first, second| [second, first].concat(),
        |_, second| second,
        |mut first, _| {
            first[5] ^= 1;
            first
        },
        // Truncated: the following message is taken for the rest.
        |first, second| [&first[..first.len() - 1], &second].concat(),
        |mut first, _| {
            first[0] = 0xff;
            first
        },
    ];
    for (index, spoil) in spoil.into_iter().enumerate() {
        let (mut one, mut other, _) = agreed();
        let [first, second] = [b"first", b"other"].map(|text| sealed(&mut one, text));
        let error = opened(&mut other, &spoil(first, second)).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidData, "{index}");
        assert!(error.to_string().contains("does not decrypt"), "{index}: {error}");
    }
    // A part of a message yields nothing.
    let (mut one, mut other, _) = agreed();
    let message = sealed(&mut one, b"first");
    assert_eq!(opened(&mut other, &message[..message.len() - 1]).unwrap(), b"");
}

#[test]
fn a_recorded_client_is_not_let_in() {
    let (_, _, [hello, confirmation]) = agreed();
    let mut listening = Channel::listening(Key([7; 32]));
    opened(&mut listening, &hello).unwrap();
    assert!(!listening.is_open());
    opened(&mut listening, &confirmation).unwrap_err();
    assert!(!listening.is_open());
}

#[test]
fn another_key_no_key_and_garbage_are_told_apart() {
    let (file, other) = client([8; 32]);
    send(&file, GREETING);
    let hello = read(&file, GREETING.len() + HANDSHAKE);
    let error = opened(&mut Channel::listening(Key([7; 32])), &hello).unwrap_err();
    assert!(error.to_string().contains("another key"), "{error}");
    UnixStream::from(OwnedFd::from(file)).shutdown(Shutdown::Both).unwrap();
    assert!(matches!(other.join().unwrap(), Err(Failed::Refused)));

    // A frame of a client without a key is recognised by its first byte.
    let error = opened(&mut Channel::listening(Key([7; 32])), &[5]).unwrap_err();
    assert!(error.to_string().contains("has no key"), "{error}");

    let mut rng = Rng::new(1, 0);
    for round in 0..2000 {
        let mut listening = Channel::listening(Key([7; 32]));
        // Half of them begin with a valid greeting.
        let mut bytes = if round % 2 == 0 { GREETING.to_vec() } else { Vec::new() };
        bytes.extend((0..rng.below(200)).map(|_| rng.next_u64().to_be_bytes()[0]));
        let _ = opened(&mut listening, &bytes);
        assert!(!listening.is_open());
    }
}

#[test]
fn a_client_with_a_key_is_told_of_silence_and_of_what_is_no_greeting() {
    let (file, silent) = client([7; 32]);
    assert!(matches!(silent.join().unwrap(), Err(Failed::NoGreeting)));
    drop(file);
    let (file, plain) = client([7; 32]);
    send(&file, &[9; 100]);
    assert!(matches!(plain.join().unwrap(), Err(Failed::NoGreeting)));
    // A wrong answer to the handshake.
    let (file, fooled) = client([7; 32]);
    send(&file, GREETING);
    send(&file, &[9; HANDSHAKE]);
    assert!(matches!(fooled.join().unwrap(), Err(Failed::Refused)));
}
