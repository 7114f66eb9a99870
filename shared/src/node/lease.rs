use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::protocol::{LEASE, Refusal};

/// Who commands, and which of their requests was the last.
///
/// A request that comes again, because its reply was lost, gets the reply that it had and is not carried out twice; one
/// that comes late, after a newer one, is refused. So a client may send again as often as it likes, and a link may
/// delay and duplicate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub(super) struct Lease {
    held: bool,
    /// The client that commands, or did last.
    client: u32,
    /// Its last command, and why that was refused.
    sequence: u16,
    refusal: Option<Refusal>,
    /// The tick of its last request.
    seen: u32,
}

/// What to do with a command.
#[derive(Debug, PartialEq)]
pub(super) enum Admitted {
    /// Carry it out.
    New,
    /// It was carried out, with this result.
    Repeated(Result<(), Refusal>),
}

impl Lease {
    /// Nobody commands.
    pub const fn new() -> Self {
        Self { held: false, client: 0, sequence: 0, refusal: None, seen: 0 }
    }

    /// The client that commands.
    pub const fn commander(&self) -> Option<u32> {
        if self.held { Some(self.client) } else { None }
    }

    /// A request of any kind came.
    pub fn notice(&mut self, client: u32, now: u32) {
        if self.held && self.client == client {
            self.seen = now;
        }
    }

    /// The client wants to command. `armed`: the commander cannot be replaced.
    pub fn take(
        &mut self,
        client: u32,
        sequence: u16,
        by_force: bool,
        armed: bool,
        now: u32,
    ) -> Result<(), Refusal> {
        if self.client == client && self.is_older(sequence) {
            return Err(Refusal::Stale { latest: self.sequence });
        }
        let expired = now.wrapping_sub(self.seen) > LEASE;
        if self.held && self.client != client && (armed || !(by_force || expired)) {
            return Err(Refusal::Commanded { by: self.client });
        }
        *self = Self { held: true, client, sequence, refusal: None, seen: now };
        Ok(())
    }

    /// A command came.
    pub fn admit(&self, client: u32, sequence: u16) -> Result<Admitted, Refusal> {
        if self.client == client && self.sequence == sequence {
            return Ok(Admitted::Repeated(self.refusal.map_or(Ok(()), Err)));
        }
        if !self.held {
            return Err(Refusal::NotCommander);
        }
        if self.client != client {
            return Err(Refusal::Commanded { by: self.client });
        }
        if self.is_older(sequence) {
            return Err(Refusal::Stale { latest: self.sequence });
        }
        Ok(Admitted::New)
    }

    /// The command was carried out, or refused.
    pub fn remember(&mut self, sequence: u16, result: Result<(), Refusal>) {
        (self.sequence, self.refusal) = (sequence, result.err());
    }

    /// Nobody commands from now on.
    pub fn release(&mut self) {
        self.held = false;
    }

    /// Numbers wrap: what lies up to half of them behind the last one is older.
    fn is_older(&self, sequence: u16) -> bool {
        sequence.wrapping_sub(self.sequence).cast_signed() < 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn commanded_by(client: u32) -> Lease {
        let mut lease = Lease::new();
        assert_eq!(lease.take(client, 10, false, false, 0), Ok(()));
        lease
    }

    #[test]
    fn a_second_client_waits_for_silence_or_takes_by_force_but_never_from_an_armed_one() {
        let mut lease = commanded_by(1);
        let refused = Err(Refusal::Commanded { by: 1 });
        assert_eq!(lease.take(2, 0, false, false, LEASE), refused);
        assert_eq!(lease.take(2, 0, true, true, 10 * LEASE), refused);
        lease.notice(1, 50);
        assert_eq!(lease.take(2, 0, false, false, LEASE + 50), refused);
        assert_eq!(lease.clone().take(2, 0, true, false, 51), Ok(()));
        assert_eq!(lease.take(2, 0, false, false, LEASE + 51), Ok(()));
        assert_eq!(lease.admit(1, 11), Err(Refusal::Commanded { by: 2 }));
        lease.release();
        assert_eq!(lease.admit(1, 11), Err(Refusal::NotCommander));
    }

    #[test]
    fn a_command_is_carried_out_once_however_often_it_comes() {
        let mut lease = commanded_by(1);
        assert_eq!(lease.admit(1, 11), Ok(Admitted::New));
        lease.remember(11, Err(Refusal::NoModel));
        assert_eq!(lease.admit(1, 11), Ok(Admitted::Repeated(Err(Refusal::NoModel))));
        assert_eq!(lease.admit(1, 10), Err(Refusal::Stale { latest: 11 }));
        assert_eq!(lease.admit(1, 12), Ok(Admitted::New));
    }

    #[test]
    fn numbers_wrap() {
        let mut lease = commanded_by(1);
        lease.remember(65_535, Ok(()));
        assert_eq!(lease.admit(1, 0), Ok(Admitted::New));
        lease.remember(0, Ok(()));
        assert_eq!(lease.admit(1, 65_535), Err(Refusal::Stale { latest: 0 }));
    }

    #[test]
    fn a_released_command_is_not_taken_back_by_an_old_request() {
        let mut lease = commanded_by(1);
        lease.remember(11, Ok(()));
        lease.release();
        assert_eq!(lease.take(1, 10, false, false, 5), Err(Refusal::Stale { latest: 11 }));
        assert_eq!(lease.take(1, 12, false, false, 5), Ok(()));
    }
}
