use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::optional::Optional;
use crate::protocol::{LEASE, Refusal};

/// A command so many numbers back is not sent again.
const FORGOTTEN: u16 = 1 << 14;

/// Who commands, and which of their requests was the last.
///
/// A request that comes again, because its reply was lost, gets the reply that it had and is not carried out twice; one
/// that comes late, after a newer one, is refused. So a client may send again as often as it likes, and a link may
/// delay and duplicate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub(super) struct Lease {
    held: bool,
    /// The client that commands, or did last.
    client: Option<u32>,
    /// Its last command, and why that was refused.
    sequence: u16,
    refusal: Optional<Refusal>,
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
        Self { held: false, client: None, sequence: 0, refusal: Optional::None, seen: 0 }
    }

    /// The client that commands.
    pub const fn commander(&self) -> Option<u32> {
        if self.held { self.client } else { None }
    }

    /// A request of any kind came.
    pub fn notice(&mut self, client: u32, sequence: u16, now: u32) {
        if self.client != Some(client) {
            return;
        }
        self.seen = now;
        // Other requests use up numbers, too: without this the next command, after half of all of them, would look older
        // than the last one. The last one cannot come again any more, but this one may be a command.
        if (FORGOTTEN..1 << 15).contains(&sequence.wrapping_sub(self.sequence)) {
            (self.sequence, self.refusal) = (sequence.wrapping_sub(1), Optional::None);
        }
    }

    /// The client wants to command. `enabled`: the commander cannot be replaced.
    pub fn take(
        &mut self,
        client: u32,
        sequence: u16,
        by_force: bool,
        enabled: bool,
        now: u32,
    ) -> Result<(), Refusal> {
        if self.client == Some(client) && self.is_older(sequence) {
            return Err(Refusal::Stale { latest: self.sequence });
        }
        let expired = now.wrapping_sub(self.seen) > LEASE;
        if let Some(by) = self.commander()
            && by != client
            && (enabled || !(by_force || expired))
        {
            return Err(Refusal::Commanded { by });
        }
        *self = Self { held: true, client: Some(client), sequence, refusal: Optional::None, seen: now };
        Ok(())
    }

    /// A command came.
    pub fn admit(&self, client: u32, sequence: u16) -> Result<Admitted, Refusal> {
        if self.client == Some(client) && self.sequence == sequence {
            return Ok(Admitted::Repeated(self.refusal.get().map_or(Ok(()), Err)));
        }
        let by = self.commander().ok_or(Refusal::NotCommander)?;
        if by != client {
            return Err(Refusal::Commanded { by });
        }
        if self.is_older(sequence) {
            return Err(Refusal::Stale { latest: self.sequence });
        }
        Ok(Admitted::New)
    }

    /// The command was carried out, or refused.
    pub fn remember(&mut self, sequence: u16, result: Result<(), Refusal>) {
        (self.sequence, self.refusal) = (sequence, result.err().into());
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
    fn a_second_client_waits_for_silence_or_takes_by_force_but_never_from_an_enabled_one() {
        let mut lease = commanded_by(1);
        let refused = Err(Refusal::Commanded { by: 1 });
        assert_eq!(lease.take(2, 0, false, false, LEASE), refused);
        assert_eq!(lease.take(2, 0, true, true, 10 * LEASE), refused);
        lease.notice(1, 11, 50);
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
    fn a_commander_may_ask_other_things_as_often_as_it_likes() {
        #[expect(clippy::cast_possible_truncation, reason = "numbers wrap")]
        let number = |asked| (10 + asked) as u16;
        let mut lease = commanded_by(1);
        for asked in 1..200_000_u32 {
            lease.notice(1, number(asked), 0);
        }
        let next = number(200_000);
        lease.notice(1, next, 0);
        assert_eq!(lease.admit(1, next), Ok(Admitted::New));
        assert_eq!(lease.take(1, next, false, false, 0), Ok(()));
    }

    #[test]
    fn nobody_has_commanded_a_new_board() {
        assert_eq!(Lease::new().admit(0, 0), Err(Refusal::NotCommander));
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
