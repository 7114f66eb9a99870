//! UARTs, and the queues between their interrupts and the RTIC tasks.
//!
//! The interrupt owns the UART; an RTIC task owns the other ends of two queues and pends the interrupt with
//! `rtic::pend`. A full queue drops further data and counts it.

use core::sync::atomic::{AtomicU32, Ordering};

use heapless::spsc::{Consumer, Producer, Queue};
use serde::Serialize;
use serde::de::DeserializeOwned;
use tesaki::protocol::LinkStatistics;
use tesaki::protocol::codec::{Decoder, FrameError, MAX_FRAME, encode};

use crate::pac;

/// Capacity plus one of the receive queue [bytes]: three of the longest frames.
pub const RECEIVE_QUEUE: usize = 1024;
/// Capacity plus one of the send queue [bytes].
pub const SEND_QUEUE: usize = 1024;

/// The memory of a link.
pub struct Storage {
    receive: Queue<u8, RECEIVE_QUEUE>,
    send: Queue<u8, SEND_QUEUE>,
    counters: Counters,
}

/// Error counters of an interrupt.
#[derive(Default)]
struct Counters {
    overflow: AtomicU32,
    errors: AtomicU32,
}

impl Default for Storage {
    fn default() -> Self {
        Self::new()
    }
}

impl Storage {
    /// Empty queues.
    pub const fn new() -> Self {
        let counters = Counters { overflow: AtomicU32::new(0), errors: AtomicU32::new(0) };
        Self { receive: Queue::new(), send: Queue::new(), counters }
    }

    /// The ends of the interrupt and of the RTIC task.
    pub fn split<U: Uart>(&'static mut self, uart: U) -> (UartIsr<U>, Endpoint) {
        let (received, incoming) = self.receive.split();
        let (outgoing, waiting) = self.send.split();
        let counters = &self.counters;
        let endpoint = Endpoint { incoming, outgoing, counters, decoder: Decoder::new(), send_overflow: 0 };
        (UartIsr { uart, received, waiting, counters }, endpoint)
    }
}

/// Interface of the UARTs.
pub trait Uart {
    /// Reads a received byte, and whether bytes were lost: `(byte, lost)`.
    fn receive(&mut self) -> (Option<u8>, bool);
    /// Whether the next byte may be written.
    fn ready(&self) -> bool;
    /// Sends a byte.
    fn send(&mut self, byte: u8);
    /// Enables the interrupt for a free transmit register.
    fn interrupt_when_ready(&mut self, enabled: bool);
}

macro_rules! uart {
    ($peripheral:ident) => {
        impl Uart for pac::$peripheral {
            fn receive(&mut self) -> (Option<u8>, bool) {
                let status = self.sr().read();
                let lost = status.ore().bit_is_set() || status.nf().bit_is_set() || status.fe().bit_is_set();
                // Reading the data register also clears the errors.
                let waiting = status.rxne().bit_is_set() || lost;
                let byte = waiting.then(|| self.dr().read().bits() as u8);
                (byte.filter(|_| status.rxne().bit_is_set()), lost)
            }

            fn ready(&self) -> bool {
                self.sr().read().txe().bit_is_set()
            }

            fn send(&mut self, byte: u8) {
                // SAFETY: any byte may be written to the data register.
                self.dr().write(|w| unsafe { w.bits(byte.into()) });
            }

            fn interrupt_when_ready(&mut self, enabled: bool) {
                self.cr1().modify(|_, w| w.txeie().bit(enabled));
            }
        }
    };
}

uart!(USART1);
uart!(USART2);

/// Configures a UART: 8 data bits, no parity, one stop bit, interrupt on each received byte.
#[macro_export]
macro_rules! start_uart {
    ($uart:expr, $clock:expr, $baud:expr) => {{
        let divider = ($clock + $baud / 2) / $baud;
        // SAFETY: mantissa and fraction of the divider, as the baud rate register takes them.
        $uart.brr().write(|w| unsafe { w.bits(divider as _) });
        $uart.cr1().write(|w| w.ue().set_bit().te().set_bit().re().set_bit().rxneie().set_bit());
    }};
}

/// The interrupt's half of a UART.
pub struct UartIsr<U> {
    uart: U,
    received: Producer<'static, u8>,
    waiting: Consumer<'static, u8>,
    counters: &'static Counters,
}

impl<U: Uart> UartIsr<U> {
    /// Receives a byte and sends queued bytes. Returns whether a frame ended. Bounded: at most one byte in
    /// and one queue out; a real UART accepts two bytes at a time.
    pub fn on_interrupt(&mut self) -> bool {
        let (byte, lost) = self.uart.receive();
        if lost {
            self.counters.errors.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(byte) = byte
            && self.received.enqueue(byte).is_err()
        {
            self.counters.overflow.fetch_add(1, Ordering::Relaxed);
        }
        for _ in 0..SEND_QUEUE {
            if !self.uart.ready() {
                break;
            }
            match self.waiting.dequeue() {
                Some(byte) => self.uart.send(byte),
                None => break,
            }
        }
        let unsent = self.waiting.ready();
        self.uart.interrupt_when_ready(unsent);
        byte == Some(0)
    }
}

/// The RTIC task's half of a link: messages instead of bytes.
pub struct Endpoint {
    incoming: Consumer<'static, u8>,
    outgoing: Producer<'static, u8>,
    counters: &'static Counters,
    decoder: Decoder,
    send_overflow: u32,
}

impl Endpoint {
    /// The next received message, or its error; `None` without a complete frame.
    pub fn receive<T: DeserializeOwned>(&mut self) -> Option<Result<T, FrameError>> {
        while let Some(byte) = self.incoming.dequeue() {
            if let Some(result) = self.decoder.push(byte) {
                return Some(result);
            }
        }
        None
    }

    /// Queues a complete message, or drops it. The caller then pends the interrupt.
    pub fn send<T: Serialize>(&mut self, message: &T) -> bool {
        let mut frame = [0; MAX_FRAME];
        let frame = match encode(message, &mut frame) {
            Ok(length) => frame.get(..length).unwrap_or_default(),
            Err(_) => &[],
        };
        let is_free = self.has_size() && self.outgoing.capacity() - self.outgoing.len() >= frame.len();
        if frame.is_empty() || !is_free {
            self.send_overflow = self.send_overflow.wrapping_add(1);
            return false;
        }
        for &byte in frame {
            // Cannot fail: the space was checked, and this is the only producer.
            if !self.has_size() || self.outgoing.enqueue(byte).is_err() {
                break;
            }
        }
        true
    }

    /// Always: tells the compiler that the queue, which divides by its size, has one.
    fn has_size(&self) -> bool {
        self.outgoing.capacity() < SEND_QUEUE
    }

    /// Statistics of the link.
    pub fn statistics(&self) -> LinkStatistics {
        LinkStatistics {
            frames: self.decoder.counts(),
            receive_overflow: self.counters.overflow.load(Ordering::Relaxed),
            receive_errors: self.counters.errors.load(Ordering::Relaxed),
            send_overflow: self.send_overflow,
        }
    }
}
