use postcard_schema::Schema;
use postcard_schema::schema::NamedType;
use serde::{Deserialize, Serialize};

/// Number of clients in a table.
pub(super) const CLIENTS: usize = 4;
/// A command whose sequence number is this far back is no longer repeated.
const MAX_REPETITION_AGE: u16 = 1 << 14;

/// Clients, the latest first, each with a sequence number: its requests up to this number are outdated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Clients(pub(super) [Option<(u32, u16)>; CLIENTS]);

/// The same as that of the array.
impl Schema for Clients {
    const SCHEMA: &'static NamedType = <[Option<(u32, u16)>; CLIENTS]>::SCHEMA;
}

impl Clients {
    /// No clients.
    pub const NONE: Self = Self([None; CLIENTS]);

    /// The sequence number of `client`; `None` if it is not in the table.
    pub fn latest(&self, client: u32) -> Option<u16> {
        self.0.iter().flatten().find(|(known, _)| *known == client).map(|(_, latest)| *latest)
    }

    /// Puts `entry` first, instead of the entry of `client`, of an empty one, or of the last one.
    pub fn replace(&mut self, client: u32, entry: Option<(u32, u16)>) {
        let is_own = |entry: &Option<(u32, u16)>| entry.is_some_and(|(known, _)| known == client);
        let place = self.0.iter().position(is_own).or_else(|| self.0.iter().position(Option::is_none));
        let mut moved = entry;
        for entry in self.0.iter_mut().take(place.unwrap_or(CLIENTS - 1) + 1) {
            core::mem::swap(entry, &mut moved);
        }
    }

    /// Registers a request: see [`keep_up`].
    pub fn register(&mut self, client: u32, sequence: u16) {
        if let Some(latest) = self.number(client) {
            keep_up(latest, sequence);
        }
    }

    /// The requests of `client` up to `sequence` are outdated.
    pub fn outdate(&mut self, client: u32, sequence: u16) {
        if let Some(latest) = self.number(client)
            && ahead(sequence, *latest) > 0
        {
            *latest = sequence;
        }
    }

    fn number(&mut self, client: u32) -> Option<&mut u16> {
        self.0.iter_mut().flatten().find(|(known, _)| *known == client).map(|(_, latest)| latest)
    }
}

/// By how much `sequence` is ahead of `latest`, with wrap-around; negative for an older request.
pub(super) const fn ahead(sequence: u16, latest: u16) -> i16 {
    sequence.wrapping_sub(latest).cast_signed()
}

/// Moves `latest` up to just before the request `sequence` if that is so far ahead that requests up to
/// `latest` are no longer repeated. Returns whether it did.
///
/// Every request has a number, but not every one changes `latest`: after half of the number range the next
/// request would appear older than `latest`.
pub(super) fn keep_up(latest: &mut u16, sequence: u16) -> bool {
    let is_far_ahead = (MAX_REPETITION_AGE..1 << 15).contains(&sequence.wrapping_sub(*latest));
    if is_far_ahead {
        *latest = sequence.wrapping_sub(1);
    }
    is_far_ahead
}
