//! A link with delay, jitter and loss.

use tesaki_rng::Rng;

use crate::purpose::Purpose;

/// Parameters of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkValues {
    /// Minimum time from sending to arrival [s].
    pub delay: f64,
    /// Additional delay of each message, uniform from 0 to this [s]. Later messages may overtake earlier
    /// ones.
    pub jitter: f64,
    /// Fraction of the messages that are lost.
    pub loss: f64,
    /// Mean length of the bursts of lost messages (Gilbert's model); 1 or less for independent losses.
    pub burst: f64,
}

/// A message in transit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Packet<T> {
    /// Sequence number, from 0.
    pub sequence: u32,
    /// Time of sending [s].
    pub time: f64,
    /// Its content.
    pub message: T,
}

/// A link in one direction.
#[derive(Clone, Debug)]
pub struct Link<T> {
    values: LinkValues,
    rng: Rng,
    sequence: u32,
    /// Whether the last message was lost.
    losing: bool,
    /// Messages with their times of arrival, in order of arrival.
    in_transit: Vec<(f64, Packet<T>)>,
}

impl<T> Link<T> {
    /// Creates an idle link. Several links need different seeds.
    pub fn new(values: LinkValues, seed: u64) -> Self {
        let rng = Purpose::Link.rng(seed);
        Self { values, rng, sequence: 0, losing: false, in_transit: Vec::new() }
    }

    /// Sends a message at a time [s].
    pub fn send(&mut self, time: f64, message: T) {
        let packet = Packet { sequence: self.sequence, time, message };
        self.sequence = self.sequence.wrapping_add(1);
        let LinkValues { delay, jitter, loss, burst } = self.values;
        // Both numbers are drawn for every message, so that the parameters do not affect later draws.
        let [late, lost] = [(); 2].map(|()| 0.5 + 0.5 * self.rng.symmetric());
        // A burst ends with probability 1/burst, and begins with the probability that yields the given
        // fraction of losses.
        let probability = match self.losing {
            _ if burst <= 1.0 => loss,
            true => 1.0 - 1.0 / burst,
            false => loss / ((1.0 - loss) * burst),
        };
        self.losing = lost < probability;
        if !self.losing {
            let arrival = time + delay + jitter * late;
            let place = self.in_transit.partition_point(|(other, _)| *other <= arrival);
            self.in_transit.insert(place, (arrival, packet));
        }
    }

    /// Returns the messages that have arrived by a time [s] since the last call, in order of arrival.
    pub fn receive(&mut self, time: f64) -> impl Iterator<Item = Packet<T>> {
        let arrived = self.in_transit.partition_point(|(arrival, _)| *arrival <= time);
        self.in_transit.drain(..arrived).map(|(_, packet)| packet)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(values: LinkValues, seed: u64) -> Vec<(f64, Packet<u32>)> {
        let mut link = Link::new(values, seed);
        let mut got = Vec::new();
        // A message is sent every 4 ms; the receiver polls every 0.1 ms.
        for now in 0..400_000_u32 {
            let time = f64::from(now) * 1e-4;
            if now % 40 == 0 && now < 390_000 {
                link.send(time, now / 40);
            }
            got.extend(link.receive(time).map(|packet| (time, packet)));
        }
        got
    }

    #[test]
    fn delay_jitter_and_loss_have_their_sizes() {
        let values = LinkValues { delay: 0.02, jitter: 0.01, loss: 0.1, burst: 0.0 };
        let got = run(values, 3);
        assert!((got.len() as f64 / 9750.0 - 0.9).abs() < 0.01, "{}", got.len());
        let late: Vec<f64> = got.iter().map(|(time, packet)| time - packet.time - 0.02).collect();
        let mean = late.iter().sum::<f64>() / late.len() as f64;
        let deviation = (late.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / late.len() as f64).sqrt();
        assert!(late.iter().all(|&late| (-1e-9..0.0102).contains(&late)));
        // Uniform over 10 ms, plus up to 0.1 ms of polling delay.
        assert!(
            (mean - 0.00505).abs() < 1e-4 && (deviation - 0.01 / 12_f64.sqrt()).abs() < 1e-4,
            "{mean} {deviation}"
        );
        assert!(got.iter().all(|(_, packet)| packet.sequence == packet.message));
        let overtaken = got.windows(2).filter(|two| two[1].1.sequence < two[0].1.sequence).count();
        assert!(overtaken > 1000, "{overtaken}");
        assert_eq!(got, run(values, 3));
    }

    #[test]
    fn bursts_have_their_length_and_the_loss_its_fraction() {
        let got = run(LinkValues { delay: 0.02, loss: 0.2, burst: 6.0, ..LinkValues::default() }, 3);
        let gaps: Vec<u32> = got.windows(2).map(|two| two[1].1.sequence - two[0].1.sequence - 1).collect();
        let (lost, bursts) = (gaps.iter().sum::<u32>(), gaps.iter().filter(|&&gap| gap > 0).count());
        assert!((f64::from(lost) / 9750.0 - 0.2).abs() < 0.03, "{lost}");
        assert!((f64::from(lost) / bursts as f64 - 6.0).abs() < 0.7, "{lost} {bursts}");
    }

    #[test]
    fn a_good_link_is_in_order_and_complete() {
        let got = run(LinkValues { delay: 0.05, ..LinkValues::default() }, 0);
        assert!(
            got.len() == 9750 && got.iter().zip(0..).all(|((_, packet), number)| packet.sequence == number)
        );
        assert!(got.iter().all(|(time, packet)| (time - packet.time - 0.05).abs() < 1.01e-4));
    }
}
