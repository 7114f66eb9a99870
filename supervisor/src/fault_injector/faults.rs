use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// A pause of the line, and its probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pause {
    /// Its duration.
    pub duration: Duration,
    /// Probability per chunk: per call that sends, or per piece that arrives.
    pub probability: f64,
}

/// Faults of a line: probabilities from 0 (never) to 1 (always).
///
/// ```
/// # use tesaki_supervisor::fault_injector::LinkFaults;
/// let faults: LinkFaults = "seed=3,flip=1e-3,delay=20ms@1e-2".parse()?;
/// assert_eq!(faults.flip, 0.001);
/// assert_eq!(faults.drop, 0.0);
/// # Ok::<(), tesaki_supervisor::fault_injector::FaultsError>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct LinkFaults {
    /// Seed of the random numbers.
    pub seed: u64,
    /// Per byte: it is lost.
    pub drop: f64,
    /// Per byte: one of its bits flips.
    pub flip: f64,
    /// Per frame: its tail, its closing zero and the head of the next are lost, as when a receiver's buffer
    /// overruns.
    pub splice: f64,
    /// Per frame: it arrives twice.
    pub duplicate: f64,
    /// A chunk arrives up to this much later; chunks do not overtake each other.
    pub delay: Pause,
    /// Stall: nothing arrives for this time, then everything at once.
    pub stall: Pause,
}

impl Default for LinkFaults {
    /// A perfect line.
    fn default() -> Self {
        Self {
            seed: 0,
            drop: 0.0,
            flip: 0.0,
            splice: 0.0,
            duplicate: 0.0,
            delay: Pause { duration: Duration::from_millis(20), probability: 0.0 },
            stall: Pause { duration: Duration::from_millis(200), probability: 0.0 },
        }
    }
}

impl LinkFaults {
    /// Creates a line with every kind of fault, each with the same probability.
    pub fn all(probability: f64) -> Self {
        let mut faults = Self::default();
        faults.set_all(probability);
        faults
    }

    fn set_all(&mut self, probability: f64) {
        for rate in [&mut self.drop, &mut self.flip, &mut self.splice, &mut self.duplicate] {
            *rate = probability;
        }
        self.delay.probability = probability;
        self.stall.probability = probability;
    }
}

/// Reasons why a text is not a [`LinkFaults`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultsError {
    /// Not of the form `name=value`.
    #[error("\"{0}\" is not of the form name=value: write faults like {EXAMPLE}")]
    NotAPair(String),
    /// No such fault.
    #[error(
        "there is no fault \"{0}\": there are drop, flip, splice, duplicate, delay, stall, all of them as all, and seed"
    )]
    Unknown(String),
    /// Not a number from 0 to 1.
    #[error("{name}={value}: the probability must be a number from 0 to 1, like 0.001 or 1e-3")]
    Probability {
        /// Name of the fault.
        name: String,
        /// The given value.
        value: String,
    },
    /// Not a duration.
    #[error("{name}={value}: the duration must be whole milliseconds up to {MAX_DURATION}, like 20ms")]
    Duration {
        /// Name of the fault.
        name: String,
        /// The given value.
        value: String,
    },
    /// Not a whole number.
    #[error("seed={0}: the seed must be a whole number from 0 to 18446744073709551615")]
    Seed(String),
}

const EXAMPLE: &str =
    "seed=3,flip=1e-3,drop=1e-3,splice=1e-3,duplicate=1e-3,delay=20ms@1e-2,stall=200ms@1e-3";
/// Maximum duration [ms].
const MAX_DURATION: u64 = 60_000;

fn probability(name: &str, value: &str) -> Result<f64, FaultsError> {
    let number: Option<f64> = value.trim().parse().ok();
    // A NaN is not in the range.
    number
        .filter(|number| (0.0..=1.0).contains(number))
        .ok_or_else(|| FaultsError::Probability { name: name.to_owned(), value: value.to_owned() })
}

/// Parses `20ms@1e-2`, or `1e-2` alone to keep the duration.
fn pause(name: &str, value: &str, usual: Pause) -> Result<Pause, FaultsError> {
    let Some((duration, rate)) = value.split_once('@') else {
        return Ok(Pause { probability: probability(name, value)?, ..usual });
    };
    let milliseconds: Option<u64> = duration.trim().strip_suffix("ms").and_then(|text| text.parse().ok());
    let milliseconds = milliseconds
        .filter(|&milliseconds| milliseconds <= MAX_DURATION)
        .ok_or_else(|| FaultsError::Duration { name: name.to_owned(), value: value.to_owned() })?;
    let duration = Duration::from_millis(milliseconds);
    Ok(Pause { duration, probability: probability(name, rate)? })
}

impl FromStr for LinkFaults {
    type Err = FaultsError;

    /// Parses faults separated by commas. A later one replaces an earlier, so `all=1e-3,stall=0` is all but
    /// stalls.
    fn from_str(text: &str) -> Result<Self, FaultsError> {
        let mut faults = Self::default();
        for pair in text.split(',').map(str::trim).filter(|pair| !pair.is_empty()) {
            let (name, value) = pair.split_once('=').ok_or_else(|| FaultsError::NotAPair(pair.to_owned()))?;
            let (name, value) = (name.trim(), value.trim());
            match name {
                "seed" => {
                    faults.seed = value.parse().map_err(|_| FaultsError::Seed(value.to_owned()))?;
                }
                "drop" => faults.drop = probability(name, value)?,
                "flip" => faults.flip = probability(name, value)?,
                "splice" => faults.splice = probability(name, value)?,
                "duplicate" => faults.duplicate = probability(name, value)?,
                "delay" => faults.delay = pause(name, value, faults.delay)?,
                "stall" => faults.stall = pause(name, value, faults.stall)?,
                "all" => faults.set_all(probability(name, value)?),
                _ => return Err(FaultsError::Unknown(name.to_owned())),
            }
        }
        Ok(faults)
    }
}

impl fmt::Display for LinkFaults {
    /// Formats the faults as they are parsed, so that a failed test can be repeated from its log.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seed, drop, flip, splice, duplicate, delay, stall } = self;
        write!(f, "seed={seed},drop={drop:e},flip={flip:e},splice={splice:e},duplicate={duplicate:e}")?;
        for (name, pause) in [("delay", delay), ("stall", stall)] {
            write!(f, ",{name}={}ms@{:e}", pause.duration.as_millis(), pause.probability)?;
        }
        Ok(())
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read_and_written_alike() {
        let faults: LinkFaults = EXAMPLE.parse().unwrap();
        let pause =
            |milliseconds, probability| Pause { duration: Duration::from_millis(milliseconds), probability };
        let expected = LinkFaults {
            seed: 3,
            drop: 1e-3,
            flip: 1e-3,
            splice: 1e-3,
            duplicate: 1e-3,
            delay: pause(20, 1e-2),
            stall: pause(200, 1e-3),
        };
        assert_eq!(faults, expected);
        assert_eq!(faults.to_string().parse(), Ok(faults));
        assert_eq!("all=1e-2".parse(), Ok(LinkFaults::all(1e-2)));
        assert_eq!("".parse(), Ok(LinkFaults::default()));
        let quick: LinkFaults = "all=0.5, stall=5ms@0".parse().unwrap();
        assert_eq!(quick, LinkFaults { stall: pause(5, 0.0), ..LinkFaults::all(0.5) });
    }

    #[test]
    fn slips_are_named() {
        let error = |text: &str| text.parse::<LinkFaults>().unwrap_err().to_string();
        assert!(error("flip").starts_with("\"flip\" is not of the form name=value"));
        assert!(error("flop=1").starts_with("there is no fault \"flop\""));
        for value in ["2", "-1", "NaN", "", "often"] {
            assert!(error(&format!("flip={value}")).contains("from 0 to 1"), "{value}");
        }
        for value in ["20@1", "20s@1", "-1ms@1", "60001ms@1", "@1"] {
            assert!(error(&format!("stall={value}")).contains("whole milliseconds up to 60000"), "{value}");
        }
        assert!(error("delay=20ms@2").contains("from 0 to 1"));
        assert!(error("seed=-1").starts_with("seed=-1: the seed must be a whole number"));
    }
}
