use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::clients::{Clients, ahead, keep_up};
use super::optional::Optional;
use crate::protocol::{LEASE, Refusal};

/// The lease of the commander, and its last command.
///
/// Commands are idempotent: a repeated command, whose reply was lost, gets the same reply and is not executed
/// again; a command that arrives after a newer one is refused. Clients may therefore repeat requests, and
/// links may delay and duplicate them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub(super) struct Lease {
    pub(super) held: bool,
    /// Whether the last hello of the client had another schema key than ours.
    pub(super) mismatched: bool,
    /// The commander, or the last one.
    pub(super) client: Option<u32>,
    /// Sequence number of its last command, and the refusal of that command.
    pub(super) sequence: u16,
    pub(super) refusal: Optional<Refusal>,
    /// The tick of its last request.
    pub(super) last_request: u32,
    /// The former commanders, each with the sequence number of its last command: late ones are recognised.
    pub(super) former: Clients,
}

/// Whether to execute a command.
#[derive(Debug, PartialEq)]
pub(super) enum Admitted {
    /// Execute it.
    New,
    /// It was executed before, with this result.
    Repeated(Result<(), Refusal>),
}

impl Lease {
    /// No commander.
    pub const fn new() -> Self {
        Self {
            held: false,
            mismatched: false,
            client: None,
            sequence: 0,
            refusal: Optional::None,
            last_request: 0,
            former: Clients::NONE,
        }
    }

    /// The commander.
    pub const fn commander(&self) -> Option<u32> {
        if self.held { self.client } else { None }
    }

    /// Registers a hello.
    pub fn greet(&mut self, client: u32, accepted: bool) {
        if self.client == Some(client) {
            self.mismatched = !accepted;
        }
    }

    /// Registers a request of any kind.
    pub fn register(&mut self, client: u32, sequence: u16, now: u32) {
        self.former.register(client, sequence);
        if self.client != Some(client) {
            return;
        }
        self.last_request = now;
        // A late command with the number that was moved up was not executed, so it is refused.
        if keep_up(&mut self.sequence, sequence) {
            self.refusal = Optional::Some(Refusal::Stale { latest: self.sequence });
        }
    }

    /// Gives the lease to `client`. While `enabled` the commander cannot be replaced.
    pub fn take(
        &mut self,
        client: u32,
        sequence: u16,
        by_force: bool,
        enabled: bool,
        now: u32,
    ) -> Result<(), Refusal> {
        let own = Some(self.sequence).filter(|_| self.client == Some(client));
        if let Some(latest) = own.or_else(|| self.former.latest(client)) {
            let ahead = ahead(sequence, latest);
            // A late duplicate from a time when this client commanded.
            let again = ahead == 0 && self.commander() != Some(client);
            if ahead < 0 || again {
                return Err(Refusal::Stale { latest });
            }
        }
        let expired = now.wrapping_sub(self.last_request) > LEASE;
        if let Some(by) = self.commander()
            && by != client
            && (enabled || !(by_force || expired))
        {
            return Err(Refusal::Commanded { by });
        }
        if let Some(former) = self.client.filter(|former| *former != client) {
            self.former.replace(client, Some((former, self.sequence)));
        }
        (self.held, self.mismatched, self.client, self.last_request) = (true, false, Some(client), now);
        (self.sequence, self.refusal) = (sequence, Optional::None);
        Ok(())
    }

    /// Registers a request that any client may send at any time. Commands that the client sent before it but
    /// that arrive later must not be executed: after a stop they would switch the outputs on again.
    pub fn overrule(&mut self, client: u32, sequence: u16) {
        self.former.outdate(client, sequence);
        if self.client == Some(client) && ahead(sequence, self.sequence) >= 0 {
            (self.sequence, self.refusal) = (sequence, Optional::None);
        }
    }

    /// Decides whether to execute a command.
    pub fn admit(&self, client: u32, sequence: u16) -> Result<Admitted, Refusal> {
        if self.client == Some(client) && self.sequence == sequence {
            return Ok(Admitted::Repeated(self.refusal.get().map_or(Ok(()), Err)));
        }
        let by = self.commander().ok_or(Refusal::NotCommander)?;
        if by != client {
            return Err(Refusal::Commanded { by });
        }
        if ahead(sequence, self.sequence) < 0 {
            return Err(Refusal::Stale { latest: self.sequence });
        }
        Ok(Admitted::New)
    }

    /// Stores the result of a command.
    pub fn remember(&mut self, sequence: u16, result: Result<(), Refusal>) {
        (self.sequence, self.refusal) = (sequence, result.err().into());
    }

    /// Ends the lease.
    pub fn release(&mut self) {
        self.held = false;
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
    fn a_second_client_gets_the_lease_after_expiry_or_by_force_but_not_while_enabled() {
        let mut lease = commanded_by(1);
        let refused = Err(Refusal::Commanded { by: 1 });
        assert_eq!(lease.take(2, 0, false, false, LEASE), refused);
        assert_eq!(lease.take(2, 0, true, true, 10 * LEASE), refused);
        lease.register(1, 11, 50);
        assert_eq!(lease.take(2, 0, false, false, LEASE + 50), refused);
        assert_eq!(lease.clone().take(2, 0, true, false, 51), Ok(()));
        assert_eq!(lease.take(2, 0, false, false, LEASE + 51), Ok(()));
        assert_eq!(lease.admit(1, 11), Err(Refusal::Commanded { by: 2 }));
        lease.release();
        assert_eq!(lease.admit(1, 11), Err(Refusal::NotCommander));
    }

    #[test]
    fn a_repeated_command_is_executed_once() {
        let mut lease = commanded_by(1);
        assert_eq!(lease.admit(1, 11), Ok(Admitted::New));
        lease.remember(11, Err(Refusal::NoModel));
        assert_eq!(lease.admit(1, 11), Ok(Admitted::Repeated(Err(Refusal::NoModel))));
        assert_eq!(lease.admit(1, 10), Err(Refusal::Stale { latest: 11 }));
        assert_eq!(lease.admit(1, 12), Ok(Admitted::New));
    }

    #[test]
    fn sequence_numbers_wrap_around() {
        let mut lease = commanded_by(1);
        lease.remember(65_535, Ok(()));
        assert_eq!(lease.admit(1, 0), Ok(Admitted::New));
        lease.remember(0, Ok(()));
        assert_eq!(lease.admit(1, 65_535), Err(Refusal::Stale { latest: 0 }));
    }

    #[test]
    fn other_requests_do_not_make_the_next_command_stale() {
        #[expect(clippy::cast_possible_truncation, reason = "numbers wrap")]
        let number = |asked| (10 + asked) as u16;
        let mut lease = commanded_by(1);
        for asked in 1..200_000_u32 {
            lease.register(1, number(asked), 0);
        }
        let next = number(200_000);
        lease.register(1, next, 0);
        assert_eq!(lease.admit(1, next), Ok(Admitted::New));
        assert_eq!(lease.take(1, next, false, false, 0), Ok(()));
    }

    #[test]
    fn a_late_duplicate_of_a_former_commander_takes_nothing() {
        let mut lease = commanded_by(1);
        lease.remember(12, Ok(()));
        assert_eq!(lease.take(2, 500, true, false, 5), Ok(()));
        for late in [10, 12] {
            assert_eq!(lease.take(1, late, true, false, 6), Err(Refusal::Stale { latest: 12 }));
        }
        assert_eq!(lease.commander(), Some(2));
        assert_eq!(lease.take(1, 13, true, false, 7), Ok(()), "a new request");
        assert_eq!(lease.take(2, 500, true, false, 8), Err(Refusal::Stale { latest: 500 }));
        // A `Disable` overtook a `TakeCommand` of the same client.
        lease.overrule(2, 503);
        assert_eq!(lease.take(2, 502, true, false, 9), Err(Refusal::Stale { latest: 503 }));
    }

    #[test]
    fn a_former_commander_that_goes_on_reading_may_take_command_again() {
        #[expect(clippy::cast_possible_truncation, reason = "numbers wrap")]
        let number = |asked| (10 + asked) as u16;
        let mut lease = commanded_by(1);
        assert_eq!(lease.take(2, 0, true, false, 0), Ok(()));
        for asked in 1..200_000_u32 {
            lease.register(1, number(asked), 0);
        }
        lease.register(1, number(200_000), 0);
        assert_eq!(lease.take(1, number(200_000), true, false, 0), Ok(()));
    }

    #[test]
    fn a_new_node_has_no_commander() {
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
