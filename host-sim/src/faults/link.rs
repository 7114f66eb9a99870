//! The link between commander and board, frame by frame.

use tesaki::protocol::RequestFrame;
use tesaki::protocol::codec::{MAX_FRAME, encode};
use tesaki_rng::Rng;
use tesaki_supervisor::fault_injector::{Damage, LinkFaults};

use super::schedule::Kind;

/// Largest delay of a frame that others overtake, or that arrives twice [ticks].
const MAX_LATENESS: u32 = 5;

/// Requests on their way.
pub struct Link {
    rng: Rng,
    damage: Option<Damage>,
    /// Arrival tick of each, its place in the order of sending, and its bytes.
    frames: Vec<(u32, u64, Vec<u8>)>,
    sent: u64,
}

/// Encodes a request frame as bytes.
pub fn frame(request: &RequestFrame) -> Vec<u8> {
    let mut frame = [0; MAX_FRAME];
    // Every request fits.
    let length = encode(request, &mut frame).unwrap_or(0);
    frame[..length].to_vec()
}

impl Link {
    pub const fn new(rng: Rng) -> Self {
        Self { rng, damage: None, frames: Vec::new(), sent: 0 }
    }

    /// Sends bytes in `tick`, under the active faults.
    pub fn send<'a>(&mut self, mut bytes: Vec<u8>, tick: u32, acting: impl Iterator<Item = &'a Kind>) {
        let (mut delay, mut copies, mut order) = (0, 1, self.sent);
        self.sent += 1;
        for kind in acting {
            match *kind {
                Kind::Cut => copies = 0,
                Kind::Loss { probability } if self.rng.chance(probability) => copies = 0,
                Kind::Delay { late } => delay += late,
                Kind::Reorder { probability } if self.rng.chance(probability) => {
                    delay += 1 + self.rng.below(MAX_LATENESS);
                    order += 1000;
                }
                Kind::Duplicate { probability } if self.rng.chance(probability) => copies += copies.min(1),
                Kind::Damage { probability } => bytes = self.damage(probability, &bytes),
                _ => {}
            }
        }
        for copy in 0..copies {
            let late = if copy == 0 { 0 } else { self.rng.below(MAX_LATENESS + 1) };
            self.frames.push((tick + delay + late, order, bytes.clone()));
        }
    }

    fn damage(&mut self, probability: f64, bytes: &[u8]) -> Vec<u8> {
        let rng = &mut self.rng;
        let damage = self.damage.get_or_insert_with(|| {
            let faults = LinkFaults { seed: rng.next_u64(), ..LinkFaults::all(probability) };
            Damage::new(&faults, 0)
        });
        let mut damaged = Vec::new();
        damage.pass(bytes, &mut damaged);
        damaged
    }

    /// Returns the frames that have arrived by `tick`, in order of arrival.
    pub fn receive(&mut self, tick: u32) -> Vec<Vec<u8>> {
        let (mut arrived, waiting): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.frames).into_iter().partition(|(due, ..)| *due <= tick);
        self.frames = waiting;
        arrived.sort_by_key(|&(due, order, _)| (due, order));
        arrived.into_iter().map(|(.., bytes)| bytes).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrivals(kinds: &[Kind]) -> Vec<(u32, u8)> {
        let mut link = Link::new(Rng::new(1, 0));
        let mut arrived = Vec::new();
        for tick in 0..40_u8 {
            if tick < 20 {
                link.send(vec![tick], tick.into(), kinds.iter());
            }
            arrived.extend(link.receive(tick.into()).iter().map(|bytes| (u32::from(tick), bytes[0])));
        }
        arrived
    }

    #[test]
    fn each_fault_does_what_it_says() {
        let sent: Vec<(u32, u8)> = (0..20).map(|tick| (tick.into(), tick)).collect();
        assert_eq!(arrivals(&[]), sent);
        assert_eq!(arrivals(&[Kind::Cut]), []);
        assert!((5..15).contains(&arrivals(&[Kind::Loss { probability: 0.5 }]).len()));
        let late: Vec<(u32, u8)> = sent.iter().map(|(tick, byte)| (tick + 3, *byte)).collect();
        assert_eq!(arrivals(&[Kind::Delay { late: 3 }]), late);
        let mixed = arrivals(&[Kind::Reorder { probability: 0.5 }]);
        assert!(mixed.len() == 20 && mixed.windows(2).any(|pair| pair[0].1 > pair[1].1));
        assert!((25..=36).contains(&arrivals(&[Kind::Duplicate { probability: 0.5 }]).len()));
    }
}
