//! A UART: a byte in the data register, one in the shift register, overrun, interrupts.

use std::collections::VecDeque;

use crate::SECOND;

#[derive(Default)]
pub struct Usart {
    cr: [u32; 3],
    brr: u32,
    received: Option<u8>,
    overrun: bool,
    /// The byte in the data register, and the one in the shift register with its end.
    waiting: Option<u8>,
    shifting: Option<(u8, u64)>,
    /// Incoming bytes that are not complete yet, and when the byte on the wire is complete.
    pub incoming: VecDeque<u8>,
    arriving: Option<u64>,
    /// The bytes that were sent.
    pub outgoing: Vec<u8>,
    /// Received bytes that were lost.
    pub lost: u64,
    /// Whether the pins belong to it: transmit, receive. Set by the chip.
    pub pins: (bool, bool),
}

impl Usart {
    /// Resets the UART; external state stays.
    pub fn reset(&mut self) {
        let (outgoing, lost) = (std::mem::take(&mut self.outgoing), self.lost);
        *self = Self { outgoing, lost, ..Self::default() };
    }

    fn byte_time(&self, clock: u64) -> u64 {
        10 * u64::from(self.brr.max(16)) * SECOND / clock
    }

    fn status(&self) -> u32 {
        let idle = self.shifting.is_none() && self.waiting.is_none();
        u32::from(self.overrun) << 3
            | u32::from(self.received.is_some()) << 5
            | u32::from(idle) << 6
            | u32::from(self.waiting.is_none()) << 7
    }

    /// Returns whether it requests its interrupt.
    pub fn line(&self) -> bool {
        let on = |enable: u32, flag: u32| self.cr[0] >> enable & (self.status() >> flag) & 1 == 1;
        self.cr[0] & 1 << 13 != 0 && (on(5, 5) || on(5, 3) || on(6, 6) || on(7, 7))
    }

    pub fn next(&self) -> u64 {
        let sent = self.shifting.map_or(u64::MAX, |(_, end)| end);
        sent.min(self.arriving.unwrap_or(u64::MAX))
    }

    pub fn advance(&mut self, now: u64, clock: u64) {
        if let Some((byte, end)) = self.shifting
            && end <= now
        {
            if self.pins.0 && self.cr[0] & 1 << 3 != 0 {
                self.outgoing.push(byte);
            }
            self.shifting = self.waiting.take().map(|byte| (byte, end + self.byte_time(clock)));
        }
        // Without UE, RE and the pin, bytes are not received.
        if self.cr[0] & (1 << 13 | 1 << 2) != 1 << 13 | 1 << 2 || !self.pins.1 {
            self.incoming.clear();
            self.arriving = None;
        }
        if let Some(end) = self.arriving
            && end <= now
        {
            self.arriving = None;
            let byte = self.incoming.pop_front().unwrap_or(0);
            if self.received.is_some() {
                self.overrun = true;
                self.lost += 1;
            } else {
                self.received = Some(byte);
            }
        }
        if self.arriving.is_none() && !self.incoming.is_empty() {
            self.arriving = Some(now + self.byte_time(clock));
        }
    }

    pub fn read(&mut self, offset: u32) -> Option<u32> {
        Some(match offset {
            0x00 => self.status(),
            0x04 => {
                self.overrun = false;
                self.received.take().unwrap_or(0).into()
            }
            0x08 => self.brr,
            0x0C | 0x10 | 0x14 => self.cr[(offset as usize - 0x0C) / 4],
            _ => return None,
        })
    }

    pub fn write(&mut self, offset: u32, value: u32, now: u64, clock: u64) -> Option<()> {
        match offset {
            0x00 => {}
            0x04 if self.shifting.is_none() => {
                self.shifting = Some((value as u8, now + self.byte_time(clock)))
            }
            0x04 => self.waiting = Some(value as u8),
            0x08 => self.brr = value,
            0x0C | 0x10 | 0x14 => self.cr[(offset as usize - 0x0C) / 4] = value,
            _ => return None,
        }
        Some(())
    }
}
