//! UARTs, and the queues between their interrupts and the RTIC tasks.
//!
//! The interrupt owns the UART; an RTIC task owns the other ends of two queues, and each pends the other. A
//! full queue drops further data and counts it. RTIC binds the interrupts of all UARTs that a board may use;
//! the board says which of them is the supervisor's ([`SupervisorLine`]), and unused ones stay off.

use core::sync::atomic::{AtomicU32, Ordering};

use cortex_m::peripheral::NVIC;
use heapless::spsc::{Consumer, Producer, Queue};
use serde::de::DeserializeOwned;
use tesaki::protocol::LinkStatistics;
use tesaki::protocol::codec::{Decoder, FrameError, MAX_FRAME, Outgoing};

use crate::board::SupervisorLine;
use crate::pac;
use pac::Interrupt;

/// Capacity plus one of the receive queue [bytes]: almost three of the longest frames.
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
    /// Creates empty queues.
    pub const fn new() -> Self {
        let counters = Counters { overflow: AtomicU32::new(0), errors: AtomicU32::new(0) };
        Self { receive: Queue::new(), send: Queue::new(), counters }
    }

    /// Returns the ends for the UART's interrupt and for an RTIC task; the interrupt pends `task` when a
    /// frame has ended.
    pub fn split<U: Uart>(&'static mut self, uart: U, task: Interrupt) -> (Line<U>, Endpoint) {
        let (received, incoming) = self.receive.split();
        let (outgoing, waiting) = self.send.split();
        let counters = &self.counters;
        let (interrupt, decoder) = (U::INTERRUPT, Decoder::new());
        let endpoint = Endpoint { interrupt, incoming, outgoing, counters, decoder, send_overflow: 0 };
        (Line(Some(UartIsr { uart, task, received, waiting, counters })), endpoint)
    }
}

/// The UARTs that have a handler.
#[allow(missing_docs, reason = "the names are those of the chip")]
pub struct Uarts {
    pub usart1: pac::USART1,
    pub usart2: pac::USART2,
    pub uart4: pac::UART4,
}

/// The interrupts' and the RTIC tasks' ends of the two lines.
#[allow(missing_docs, reason = "the names are those of the chip")]
pub struct Lines {
    pub usart1: Line<pac::USART1>,
    pub usart2: Line<pac::USART2>,
    pub uart4: Line<pac::UART4>,
    /// The line of the supervisor.
    pub supervisor: Endpoint,
    /// The plant link.
    pub plant: Endpoint,
}

impl Uarts {
    /// Gives each line its UART, its memory and the interrupt of its RTIC task.
    pub fn split(
        self,
        line: SupervisorLine,
        supervisor: (&'static mut Storage, Interrupt),
        plant: (&'static mut Storage, Interrupt),
    ) -> Lines {
        let Self { usart1, usart2, uart4 } = self;
        let (usart2, plant) = plant.0.split(usart2, plant.1);
        let (storage, task) = supervisor;
        match line {
            SupervisorLine::Usart1 => {
                let (usart1, supervisor) = storage.split(usart1, task);
                Lines { usart1, usart2, uart4: Line(None), supervisor, plant }
            }
            SupervisorLine::Uart4 => {
                let (uart4, supervisor) = storage.split(uart4, task);
                Lines { usart1: Line(None), usart2, uart4, supervisor, plant }
            }
        }
    }
}

/// The interrupt handler of a UART; it does nothing if the UART is unused.
pub struct Line<U>(Option<UartIsr<U>>);

impl<U: Uart> Line<U> {
    /// Receives a byte and sends queued ones.
    pub fn on_interrupt(&mut self) {
        if let Some(isr) = &mut self.0 {
            isr.on_interrupt();
        }
    }
}

/// Interface of the UARTs.
pub trait Uart {
    /// Its interrupt.
    const INTERRUPT: Interrupt;

    /// Configures it: 8 data bits, no parity, one stop bit, interrupt on each received byte. `clock` and
    /// `baud` in Hz. The divider is whole: at 921 600 baud the bytes of USART1 (84 MHz) are 0.16 % faster,
    /// those of USART2 and UART4 (42 MHz) 0.93 % slower. That is within what a receiver tolerates, some 3 %,
    /// but with the internal oscillator, which may be 1 % off at room temperature and 8 % in the cold, it may
    /// not be.
    fn start(&self, clock: u32, baud: u32);
    /// Reads a received byte, and whether bytes were lost: `(byte, lost)`.
    fn receive(&mut self) -> (Option<u8>, bool);
    /// Returns whether the next byte may be written.
    fn ready(&self) -> bool;
    /// Sends a byte.
    fn send(&mut self, byte: u8);
    /// Enables or disables the interrupt that signals a free transmit register.
    fn interrupt_when_ready(&mut self, enabled: bool);
}

macro_rules! uart {
    ($peripheral:ident) => {
        impl Uart for pac::$peripheral {
            const INTERRUPT: Interrupt = Interrupt::$peripheral;

            fn start(&self, clock: u32, baud: u32) {
                let divider = (clock + baud / 2) / baud;
                // SAFETY: mantissa and fraction of the divider, as the baud rate register takes them.
                self.brr().write(|w| unsafe { w.bits(divider as _) });
                self.cr1().write(|w| w.ue().set_bit().te().set_bit().re().set_bit().rxneie().set_bit());
            }

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
uart!(UART4);

/// The interrupt's half of a UART.
struct UartIsr<U> {
    uart: U,
    task: Interrupt,
    received: Producer<'static, u8>,
    waiting: Consumer<'static, u8>,
    counters: &'static Counters,
}

impl<U: Uart> UartIsr<U> {
    /// Receives a byte and sends queued bytes. Bounded: at most one byte in and one queue out; a real UART
    /// accepts two bytes at a time.
    fn on_interrupt(&mut self) {
        let (byte, lost) = self.uart.receive();
        if lost {
            self.counters.errors.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(byte) = byte
            && (!self.have_sizes() || self.received.enqueue(byte).is_err())
        {
            self.counters.overflow.fetch_add(1, Ordering::Relaxed);
        }
        for _ in 0..SEND_QUEUE {
            if !self.uart.ready() || !self.have_sizes() {
                break;
            }
            match self.waiting.dequeue() {
                Some(byte) => self.uart.send(byte),
                None => break,
            }
        }
        let unsent = self.waiting.ready();
        self.uart.interrupt_when_ready(unsent);
        if byte == Some(0) {
            NVIC::pend(self.task);
        }
    }

    /// Always true; tells the compiler that the sizes of the queues, by which they divide, are not zero.
    fn have_sizes(&self) -> bool {
        self.received.capacity() < RECEIVE_QUEUE && self.waiting.capacity() < SEND_QUEUE
    }
}

/// The RTIC task's half of a link: messages instead of bytes.
pub struct Endpoint {
    /// Interrupt of the UART.
    interrupt: Interrupt,
    incoming: Consumer<'static, u8>,
    outgoing: Producer<'static, u8>,
    counters: &'static Counters,
    decoder: Decoder,
    send_overflow: u32,
}

impl Endpoint {
    /// Returns the next received message, or its error; `None` without a complete frame.
    pub fn receive<T: DeserializeOwned>(&mut self) -> Option<Result<T, FrameError>> {
        while let Some(byte) = self.incoming.dequeue() {
            if let Some(result) = self.decoder.push(byte) {
                return Some(result);
            }
        }
        None
    }

    /// Queues a complete message, or drops it. [`Endpoint::flush`] sends what is queued.
    pub fn send(&mut self, message: &impl Outgoing) -> bool {
        let mut frame = [0; MAX_FRAME];
        let frame = match message.encode(&mut frame) {
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

    /// Lets the interrupt send what is queued.
    pub fn flush(&self) {
        NVIC::pend(self.interrupt);
    }

    /// Always true; tells the compiler that the size of the queue, by which it divides, is not zero.
    fn has_size(&self) -> bool {
        self.outgoing.capacity() < SEND_QUEUE
    }

    /// Returns the statistics of the link.
    pub fn statistics(&self) -> LinkStatistics {
        LinkStatistics {
            frames: self.decoder.counts(),
            receive_overflow: self.counters.overflow.load(Ordering::Relaxed),
            receive_errors: self.counters.errors.load(Ordering::Relaxed),
            send_overflow: self.send_overflow,
        }
    }
}
